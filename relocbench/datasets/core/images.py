"""Images, depth and keyframe points on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats, Image
from relocbench.datasets.core.image_header import (
    JPEG_START,
    MOST_FILE_BYTES,
    PNG_END,
    PNG_START,
    check_affordable,
    check_content,
    read_header,
)
from relocbench.errors import DatasetError
from relocbench.files import lines_of, parse_floats, read_bytes, read_text, write_bytes, write_table
from relocbench.tracking import KeyframePoints

DEPTH_SCALE = 256.0
"""a stored depth of 256 is one metre"""
DEPTH_STEP_M, MOST_DEPTH_M = 1 / DEPTH_SCALE, 65535 / DEPTH_SCALE
"""least difference of stored depths, and the greatest of them"""
_POINT_HEADER = "u,v,inverse_depth,sigma"


@dataclass(frozen=True)
class ExpectedSize:
    """The size that an image must have."""

    size: tuple[int, int]
    """(width, height) in pixels"""
    source: str
    """where the size comes from, for messages"""

    def check(self, size: tuple[int, int], path: Path) -> None:
        """Raise DatasetError if an image's size (width, height) is another one."""
        if size != self.size:
            actual, expected = ("x".join(map(str, s)) for s in (size, self.size))
            raise DatasetError(f"image is {actual}, expected {expected} ({self.source})", path)


def read_image(path: Path, expected: ExpectedSize | None = None) -> Image:
    """An 8-bit image, (H, W) grey or (H, W, 3) RGB, as stored: an orientation in its metadata is ignored.

    Args:
        expected: the size, which is checked before anything is decoded.

    Raises:
        DatasetError: the file is missing, neither PNG nor JPEG, damaged or too large
            (:mod:`relocbench.datasets.core.image_header` has the limits), or has another size.
    """
    return as_8_bit(decode_image(read_bytes(path, "an image", DatasetError, MOST_FILE_BYTES), path, expected), path)


def as_8_bit(image: NDArray[Any], path: Path) -> Image:
    """A decoded image of 8 or 16 bits as (H, W) grey or (H, W, 3) RGB of 8. Raises DatasetError for other pixels."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.dtype != np.uint8:
        raise DatasetError(f"pixels are {image.dtype}, expected an 8-bit image", path)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        return np.ascontiguousarray(image[..., 2::-1])
    if image.ndim == 3:
        return np.ascontiguousarray(image[..., 0])
    return image


def write_image(path: Path, image: Image) -> None:
    """Write (H, W) grey or (H, W, 3) RGB as an 8-bit PNG."""
    write_bytes(path, png_bytes(image))


def read_depth(path: Path, expected: ExpectedSize | None = None) -> Floats:
    """Depth along z in metres, (H, W), 0 where unknown. Raises DatasetError like :func:`read_image`."""
    return read_raw_depth(path, 1.0 / DEPTH_SCALE, expected)


def read_raw_depth(path: Path, metres_per_unit: float, expected: ExpectedSize | None = None) -> Floats:
    """The values of a 16-bit PNG times ``metres_per_unit``, (H, W). Raises DatasetError like :func:`read_image`."""
    stored = decode_image(read_bytes(path, "an image", DatasetError, MOST_FILE_BYTES), path, expected)
    if stored.dtype != np.uint16 or stored.ndim != 2:
        raise DatasetError(f"pixels are {stored.dtype} x {stored.ndim - 1}, expected a 16-bit depth PNG", path)
    return stored.astype(np.float32) * np.float32(metres_per_unit)


def write_depth(path: Path, depth: NDArray[np.floating]) -> None:
    """Write depth (H, W) in metres as a 16-bit PNG; what is not positive, not finite or beyond 256 m becomes 0."""
    stored = np.rint(np.asarray(depth, dtype=np.result_type(depth, np.float32)) * DEPTH_SCALE)
    stored[~((stored >= 1) & (stored <= 65535))] = 0
    write_bytes(path, png_bytes(stored.astype(np.uint16)))


def read_points(path: Path) -> KeyframePoints:
    """Read sparse keyframe points. Raises DatasetError with file and line."""
    lines = lines_of(read_text(path, f"keyframe points ({_POINT_HEADER})", DatasetError))
    if not lines or lines[0] != _POINT_HEADER:
        raise DatasetError(f"expected the header {_POINT_HEADER}", path, 1)
    names = _POINT_HEADER.replace(",", " ")
    rows = [parse_floats(s.split(","), path, n, names, DatasetError) for n, s in enumerate(lines[1:], start=2)]
    values = np.array(rows, dtype=np.float64).reshape(-1, 4)
    bad = np.nonzero((values[:, 2] <= 0) | (values[:, 3] < 0))[0]
    if bad.size:
        raise DatasetError("inverse_depth must be positive and sigma not negative", path, int(bad[0]) + 2)
    return KeyframePoints(values[:, :2].copy(), values[:, 2].copy(), values[:, 3].copy())


def write_points(path: Path, points: KeyframePoints) -> None:
    """Write sparse keyframe points, one per line, in the given order."""
    rows = np.column_stack([points.uv, points.inverse_depth, points.sigma]).tolist()
    write_table(path, _POINT_HEADER.split(","), rows)


def as_rgb(image: Image) -> Image:
    """(H, W, 3) of a grey (H, W) or RGB (H, W, 3) image."""
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def as_grey(image: Image) -> Image:
    """(H, W) of a grey (H, W) or RGB (H, W, 3) image."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def is_whole(path: Path) -> bool:
    """Whether a file of an image or of keyframe points exists and was written to its end. Nothing is decoded."""
    try:
        if not path.is_file():  # opening a pipe would wait for its writer
            return False
        with path.open("rb") as stream:
            if path.suffix == ".csv":
                text = stream.read()
                return text.startswith(f"{_POINT_HEADER}\n".encode()) and text.endswith(b"\n")
            start = stream.read(8)
            if start != PNG_START:
                return path.suffix.lower() != ".png" and len(start) == 8 and start.startswith(JPEG_START)
            stream.seek(-len(PNG_END), 2)
            return stream.read() == PNG_END
    except OSError:
        return False


def decode_image(data: bytes, path: Path, expected: ExpectedSize | None = None) -> NDArray[Any]:
    """The pixels of a PNG or JPEG as they are stored, colours as BGR. Raises DatasetError like :func:`read_image`."""
    header = read_header(data, path)
    if expected is not None:
        expected.check(header.size, path)
    check_affordable(header, path)
    check_content(data, header, path)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.shape[1::-1] != header.size:
        raise DatasetError("cannot be decoded; expected a PNG or JPEG", path)
    return np.asarray(image)


def jpeg_bytes(image: Image, quality: int = 85) -> bytes:
    """JPEG of (H, W) grey or (H, W, 3) RGB, with a quality of 1 to 100 and colour at half of the size."""
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., ::-1])
    half = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality, *half])
    if not done:
        raise ValueError(f"cannot encode an image of {image.dtype} {image.shape}")
    return bytes(data)


def through_jpeg(rgb: Image, quality: float) -> Image:
    """The image (H, W, 3) after a compression as JPEG, whose traces stay although it is then stored without loss.

    ``quality`` is 1 to 100, rounded; colour is kept at half of the size.
    """
    data = np.frombuffer(jpeg_bytes(rgb, round(quality)), dtype=np.uint8)
    back = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert back is not None
    return np.ascontiguousarray(back[..., ::-1], dtype=np.uint8)


def png_bytes(image: NDArray[Any]) -> bytes:
    """PNG of (H, W) grey or (H, W, 3) RGB, with settings that are small and fast for noisy images and smooth depth."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    choice = cv2.IMWRITE_PNG_FILTER_AVG if image.ndim == 3 else cv2.IMWRITE_PNG_FILTER_PAETH
    how = [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER, choice]
    done, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 1, *how])
    if not done:
        raise ValueError(f"cannot encode an image of {image.dtype} {image.shape}")
    return bytes(data)
