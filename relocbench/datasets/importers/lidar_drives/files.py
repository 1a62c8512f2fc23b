"""Scans and images of a folder whose names are times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.image_header import MOST_FILE_BYTES, read_header
from relocbench.datasets.sensors.image_files import ImageFiles
from relocbench.datasets.sensors.trajectories import timed_files
from relocbench.errors import DatasetError
from relocbench.files import read_bytes
from relocbench.geometry import Camera, CameraModel
from relocbench.progress import SILENT, Reporter


def files_by_time(
    folder: Path,
    suffixes: tuple[str, ...],
    own_ns: int = 1,
    reporter: Reporter = SILENT,
    *,
    dates_only: bool = False,
) -> tuple[tuple[Path, ...], Times]:
    """The files of a folder and their times (N,), as :func:`timed_files`.

    Raises:
        DatasetError: a name is not a time, two files have the same time, or a file is empty.
    """
    found = timed_files(folder, suffixes, own_ns, dates_only=dates_only, reporter=reporter)
    for path in found.values():
        check_file(path)
    return tuple(found.values()), np.array(list(found), dtype=np.int64)


def check_file(path: Path) -> None:
    """Raise DatasetError if a file of a listed folder is a dangling link or empty."""
    if not path.exists():
        raise DatasetError("is a link to a file that does not exist", path)
    if path.stat().st_size == 0:
        raise DatasetError("is empty", path)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image, by its header. Raises DatasetError with the file."""
    return read_header(read_bytes(path, "an image", DatasetError, MOST_FILE_BYTES), path).size


def pinhole_files(
    name: str,
    found: tuple[tuple[Path, ...], Times],
    intrinsics: tuple[float, float, float, float],
    T_rig_cam: Array,
    calibration: Path,
) -> ImageFiles:
    """The stream of a camera whose images are rectified, with the size of the first one.

    Args:
        found: files and times, by :func:`files_by_time`; at least one.
        intrinsics: fx, fy, cx, cy in pixels.
        calibration: the file that they are from.

    Raises:
        DatasetError: the intrinsics are impossible, or the first image is damaged.
    """
    files, times = found
    camera = camera_of("pinhole", image_size(files[0]), intrinsics, (), calibration)
    return ImageFiles(name, camera, T_rig_cam, files, times, f"the first image of {name}")


def camera_of(
    model: CameraModel,
    size: tuple[int, int],
    intrinsics: tuple[float, float, float, float],
    distortion: tuple[float, ...],
    calibration: Path,
) -> Camera:
    """A camera. Raises DatasetError with the calibration's file if it is impossible."""
    try:
        return Camera(model, *size, *intrinsics, distortion)
    except ValueError as bad:
        raise DatasetError(f"the camera is impossible ({bad})", calibration) from None
