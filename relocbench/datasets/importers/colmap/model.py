"""Read COLMAP's sparse models, text or binary: cameras, posed images with their keypoints, and points.

Schönberger and Frahm, Structure-from-Motion Revisited, CVPR 2016; the files are described in COLMAP's documentation,
"Output Format". Its poses are camera from world, and its pixel centres at 0.5, 1.5, ...; here they are at integers.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Indices
from relocbench.datasets.core.named_poses import pose_of_numbers
from relocbench.datasets.core.pairfile import missing
from relocbench.datasets.importers.photos.cameras import PARAMETERS, camera_of, parse_camera
from relocbench.datasets.importers.photos.points import ModelImage, SparseModel
from relocbench.errors import DatasetError, quoted
from relocbench.files import lines_of, parse_count, parse_floats, read_bytes, read_text
from relocbench.geometry import Camera
from relocbench.progress import SILENT, Reporter

MOST_BYTES = 8 << 30
"""of a file of a model; that of Aachen Day-Night has about one gigabyte"""
_FILES = ("cameras", "images", "points3D")
_OBSERVATION = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<i8")])


def read_model(folder: Path, reporter: Reporter = SILENT) -> SparseModel:
    """Read ``cameras``, ``images`` and ``points3D`` of a folder, all ``.bin`` or all ``.txt``.

    Of a folder with both, the binary files are read unless one of them is missing. Text may have commas between
    fields, as kapture writes it.

    Args:
        reporter: is told how many images have a pose that is not finite, and are left out.

    Raises:
        DatasetError: with file and line or byte: a file is missing, cut off, damaged or of an unknown camera model, or
            an image names a camera or a point that is not there.
    """
    suffix = form_of(folder)
    if suffix == ".bin":
        cameras = dict(_binary_cameras(_Bytes(folder / "cameras.bin", "COLMAP's cameras")))
        posed = dict(_binary_images(_Bytes(folder / "images.bin", "COLMAP's images")))
        points = list(_binary_points(_Bytes(folder / "points3D.bin", "COLMAP's points")))
    elif suffix == ".txt":
        cameras = dict(_text_cameras(folder / "cameras.txt"))
        posed = dict(_text_images(folder / "images.txt"))
        points = list(_text_points(folder / "points3D.txt"))
    else:
        raise DatasetError("holds no model of COLMAP; expected cameras.bin or cameras.txt", folder)
    images = {number: image for number, image in posed.items() if image is not None}
    if len(images) < len(posed):
        reporter.note(f"images{suffix}: {len(posed) - len(images)} of {len(posed)} images have no pose (NaN)")
    if not images:
        raise DatasetError("holds no image", folder / f"images{suffix}")
    points.sort(key=lambda point: point[0])
    ids = np.array([point[0] for point in points], dtype=np.int64)
    values = np.array([point[1] for point in points], dtype=np.float64).reshape(-1, 4)
    _check_references(folder / f"images{suffix}", cameras, images, ids)
    error = np.where(values[:, 3] >= 0, values[:, 3], np.nan)
    return SparseModel(cameras, images, ids, values[:, :3].copy(), error)


def form_of(folder: Path) -> str:
    """``.bin`` or ``.txt``: the form of the model in a folder, a complete one first; empty if there is none."""
    for names in (_FILES, _FILES[:1]):
        for suffix in (".bin", ".txt"):
            if all((folder / f"{name}{suffix}").exists() for name in names):
                return suffix
    return ""


def _check_references(
    path: Path, cameras: Mapping[int, Camera], images: Mapping[int, ModelImage], ids: Indices
) -> None:
    names: set[str] = set()
    for image in images.values():
        if image.camera not in cameras:
            raise DatasetError(f"image {quoted(image.name)} has camera {image.camera}, which is not there", path)
        unknown = np.setdiff1d(image.points, ids)
        if unknown.size:
            raise DatasetError(f"image {quoted(image.name)} observes point {unknown[0]}, which is not there", path)
        if image.name in names:
            raise DatasetError(f"a second image {quoted(image.name)}", path)
        names.add(image.name)


def _image(name: str, camera: int, numbers: list[float], points: Indices) -> ModelImage:
    """An image of its quaternion (w first), translation and points, -1 for keypoints without any. Raises ValueError."""
    return ModelImage(name, camera, pose_of_numbers(numbers), np.unique(points[points >= 0]))


# --- text ---


def _text_lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    """Line number and text of the lines that are not comments, empty ones among them."""
    for number, line in enumerate(lines_of(read_text(path, what, DatasetError, MOST_BYTES)), start=1):
        if not line.startswith("#"):
            yield number, line


def _fields(line: str, most: int = -1) -> list[str]:
    """The fields of a line, parted by spaces, commas or both; what follows the first ``most`` fields is one more."""
    parted = re.split(r",\s*", line.strip(), maxsplit=max(most, 0)) if not re.search(r"\s", line.strip()) else []
    if len(parted) > 1:
        return parted
    fields = line.split(maxsplit=most)
    names = fields[most:] if most >= 0 else []
    return [field.removesuffix(",") for field in fields[: len(fields) - len(names)]] + names


def _text_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    for number, line in _text_lines(path, "COLMAP's cameras"):
        fields = _fields(line)
        if not fields:
            continue
        if len(fields) < 5:
            raise DatasetError("expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS...", path, number)
        yield parse_count(fields[0], "CAMERA_ID", path, number, DatasetError), parse_camera(fields[1:], path, number)


def _text_images(path: Path) -> Iterator[tuple[int, ModelImage | None]]:
    """The images, None where the pose is not finite."""
    lines = _text_lines(path, "COLMAP's images")
    for number, line in lines:
        fields = _fields(line, 9)
        if not fields:
            continue
        if len(fields) != 10:
            raise DatasetError("expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", path, number)
        image_id = parse_count(fields[0], "IMAGE_ID", path, number, DatasetError)
        if missing(fields[1:8]):
            next(lines, None)
            yield image_id, None
            continue
        numbers = parse_floats(fields[1:8], path, number, "QW QX QY QZ TX TY TZ", DatasetError)
        camera = parse_count(fields[8], "CAMERA_ID", path, number, DatasetError)
        below, seen = next(lines, (number, ""))  # a file may end without the empty line of its last image
        try:
            image = _image(fields[9].strip(), camera, numbers, _text_observations(seen))
        except ValueError as bad:
            raise DatasetError(str(bad), path, below if "POINTS2D" in str(bad) else number) from None
        yield image_id, image


def _text_observations(line: str) -> Indices:
    """The points of the keypoints on a line ``X Y POINT3D_ID ...``. Raises ValueError."""
    fields = _fields(line)
    if len(fields) % 3:
        raise ValueError(f"expected POINTS2D as (X, Y, POINT3D_ID), found {len(fields)} numbers")
    try:
        return np.array(fields[2::3], dtype=np.int64)
    except (ValueError, OverflowError):
        raise ValueError("expected POINTS2D as (X, Y, POINT3D_ID); an identifier is not a whole number") from None


def _text_points(path: Path) -> Iterator[tuple[int, list[float]]]:
    for number, line in _text_lines(path, "COLMAP's points"):
        fields = _fields(line)
        if not fields:
            continue
        if len(fields) < 8:
            raise DatasetError("expected POINT3D_ID X Y Z R G B ERROR TRACK[]", path, number)
        values = parse_floats([*fields[1:4], fields[7]], path, number, "X Y Z ERROR", DatasetError)
        yield parse_count(fields[0], "POINT3D_ID", path, number, DatasetError), values


# --- binary ---


class _Bytes:
    """A little-endian binary file that is read from its start to its end."""

    def __init__(self, path: Path, what: str) -> None:
        self.path, self.what = path, what
        self.data = read_bytes(path, what, DatasetError, MOST_BYTES)
        self.at = 0

    def take(self, form: str) -> tuple[Any, ...]:
        return struct.unpack(f"<{form}", self._next(struct.calcsize(f"<{form}")))

    def records(self, kind: np.dtype[Any], count: int) -> NDArray[Any]:
        return np.frombuffer(self._next(kind.itemsize * count), dtype=kind)

    def text(self) -> str:
        """Text that ends with a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise self.fault("a name without an end")
        try:
            name = self.data[self.at : end].decode()
        except UnicodeDecodeError:
            raise self.fault("a name that is not UTF-8") from None
        self.at = end + 1
        return name

    def counted(self) -> Iterator[int]:
        """Index of each of the records that the file says that it has; at the end nothing may be left."""
        (count,) = self.take("Q")
        yield from range(count)
        if self.at != len(self.data):
            raise self.fault(f"{len(self.data) - self.at} bytes are left after the last record")

    def fault(self, what: str) -> DatasetError:
        return DatasetError(f"{what} (at byte {self.at}); expected {self.what}", self.path)

    def _next(self, count: int) -> bytes:
        if count > len(self.data) - self.at:
            raise self.fault("the file is cut off")
        self.at += count
        return self.data[self.at - count : self.at]


def _binary_cameras(file: _Bytes) -> Iterator[tuple[int, Camera]]:
    for _ in file.counted():
        camera, model, width, height = file.take("iiQQ")
        if not 0 <= model < len(PARAMETERS):
            raise file.fault(f"camera model {model} is unknown")
        name = list(PARAMETERS)[model]
        numbers = list(file.take(f"{PARAMETERS[name]}d"))
        try:
            yield camera, camera_of(name, width, height, numbers)
        except ValueError as bad:
            raise file.fault(str(bad)) from None


def _binary_images(file: _Bytes) -> Iterator[tuple[int, ModelImage | None]]:
    """The images, None where the pose is not finite."""
    for _ in file.counted():
        number, *pose, camera = file.take("i7di")
        name = file.text()
        (count,) = file.take("Q")
        points = file.records(_OBSERVATION, count)["point"].astype(np.int64)
        if not np.all(np.isfinite(pose)):
            yield number, None
            continue
        try:
            yield number, _image(name, camera, pose, points)
        except ValueError as bad:
            raise file.fault(str(bad)) from None


def _binary_points(file: _Bytes) -> Iterator[tuple[int, list[float]]]:
    for _ in file.counted():
        number, x, y, z, _, _, _, error, length = file.take("Q3d3BdQ")
        file.records(np.dtype("<i8"), length)  # the track, image and keypoint as 32 bits each, which images tell too
        if not np.all(np.isfinite([x, y, z])):
            raise file.fault(f"point {number} is not finite")
        yield number, [x, y, z, error]
