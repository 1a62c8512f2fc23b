"""Images of the NCLT dataset's Ladybug 3: TIFF, undistorted by the published tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Floats, Image
from relocbench.datasets.core.image_header import MOST_FILE_BYTES
from relocbench.datasets.core.images import ExpectedSize
from relocbench.datasets.moved_views.exif import tiff_entries
from relocbench.datasets.sensors.image_files import ConvertedImages, remapped
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

_MOST_TABLE_BYTES = 2**28
_WIDTH, _HEIGHT = 256, 257


@dataclass(frozen=True, eq=False)
class LadybugImages(ConvertedImages):
    """The images of one camera."""

    table: Path
    """of the undistortion"""

    def read(self, index: int) -> Image:
        """Read an image, (H, W, 3) RGB, black outside the lens's view. Raises DatasetError with the file."""
        return remapped(read_tiff(self.files[index], self.size), self.table, read_table)


def read_tiff(path: Path, expected: ExpectedSize) -> Image:
    """An 8-bit colour image, (H, W, 3) RGB. Raises DatasetError if it is damaged or has another size."""
    data = read_bytes(path, "a TIFF image", DatasetError, MOST_FILE_BYTES)
    expected.check(tiff_size(data, path), path)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None or image.shape[1::-1] != expected.size or image.dtype != np.uint8:
        raise DatasetError("cannot be decoded; expected an 8-bit TIFF", path)
    return np.ascontiguousarray(np.asarray(image, dtype=np.uint8)[..., ::-1])


def tiff_size(data: bytes, path: Path) -> tuple[int, int]:
    """Width and height by the first directory of a TIFF. Raises DatasetError if it does not tell them."""
    tags, _ = tiff_entries(data)
    if _WIDTH not in tags or _HEIGHT not in tags:
        raise DatasetError("is damaged or not a TIFF image", path)
    return tags[_WIDTH], tags[_HEIGHT]


@lru_cache(maxsize=6)
def read_table(path: Path, width: int, height: int) -> tuple[Floats, Floats]:
    """u and v (H, W) in the recorded image of each pixel of the undistorted one.

    The file has a header, then for each pixel its row and column, and those in the recorded image.

    Raises:
        DatasetError: the file is missing, belongs to another image size, or holds something else than numbers.
    """
    data = read_bytes(path, "a table of undistortion (U2D)", DatasetError, _MOST_TABLE_BYTES)
    try:
        values = np.loadtxt(data.decode("ascii").splitlines()[1:], dtype=np.float64, ndmin=2)
    except (ValueError, UnicodeDecodeError):
        raise DatasetError("expected four numbers a line (row, column, recorded row, recorded column)", path) from None
    if values.shape != (width * height, 4) or not np.isfinite(values).all():
        raise DatasetError(f"is not a table for images of {width}x{height}: holds {len(values)} pixels", path)
    pixel = np.rint(values[:, 0] * width + values[:, 1])
    if not np.array_equal(np.sort(pixel), np.arange(width * height)):
        raise DatasetError(f"does not name each pixel of {width}x{height} once, by its row and column", path)
    v, u = values[np.argsort(pixel), 2:].T.reshape(2, height, width).astype(np.float32)
    return u, v
