"""Calibration files of 4Seasons and MLAD."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.matrices import as_transform
from relocbench.errors import DatasetError
from relocbench.files import parse_floats, read_rows
from relocbench.geometry import Camera

FOLDER_NAMES = ("Calibration", "calibration")
_PRINTED_ROTATION = 1e-4
"""tolerance for rotations that are printed with few digits"""


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """The rectified cameras of a recording, to which its undistorted images belong."""

    cam0: Camera
    cam1: Camera | None = None
    T_cam1_cam0: Array | None = None
    """(4, 4); its x translation is minus the baseline"""


def read_camera(path: Path) -> Camera:
    """Read ``calib_N.txt`` or ``undistorted_calib_N.txt``.

    The first line is ``Pinhole fx fy cx cy 0 0 0 0`` or ``Equidistant fx fy cx cy k1 k2 k3 k4``, the second the
    width and height of the image. The lines after that, about rectification, are not used.

    Raises:
        DatasetError: with file and line.
    """
    rows = list(read_rows(path, "a calibration (model fx fy cx cy ..., then width height)", DatasetError))
    if len(rows) < 2:
        raise DatasetError("expected a line of the model and a line of width and height", path)
    (line, (model, *fields)), (size_line, size) = rows[:2]
    numbers = parse_floats(fields, path, line, "fx fy cx cy d1 d2 d3 d4", DatasetError)
    width, height = parse_floats(size, path, size_line, "width height", DatasetError)
    (fx, fy, cx, cy), distortion = numbers[:4], tuple(numbers[4:])
    if model not in ("Pinhole", "Equidistant"):
        raise DatasetError(f"camera model '{model}' is neither Pinhole nor Equidistant", path, line)
    if model == "Pinhole" and any(distortion):
        raise DatasetError("a Pinhole camera has no distortion; expected 0 0 0 0", path, line)
    try:
        if model == "Pinhole":
            return Camera("pinhole", int(width), int(height), fx, fy, cx, cy)
        return Camera("equidistant", int(width), int(height), fx, fy, cx, cy, distortion)
    except ValueError as bad:
        raise DatasetError(str(bad), path, line) from None


def read_stereo(path: Path) -> Array:
    """Read ``calib_stereo.txt`` or ``undistorted_calib_stereo.txt``: (4, 4) ``T_cam1_cam0``.

    The data show this direction (t_x is minus the baseline), although the data set's documentation names it otherwise.

    Raises:
        DatasetError: with file and line.
    """
    rows = [parse_floats(f, path, n, "m0 m1 m2 m3", DatasetError) for n, f in read_rows(path, "a 4x4 matrix")]
    matrix = np.array(rows, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise DatasetError("expected a 4x4 matrix whose last row is 0 0 0 1", path)
    return as_transform(matrix, path, tolerance=_PRINTED_ROTATION)


def find_calibration(recording: Path) -> Path | None:
    """The calibration folder in a recording or beside it, if there is one."""
    candidates = [folder / name for folder in (recording, recording.resolve().parent) for name in FOLDER_NAMES]
    return next((c for c in candidates if c.is_dir()), None)


def read_calibration(folder: Path) -> StereoCalibration:
    """The rectified cameras of a calibration folder; the second camera only if the folder describes it.

    Raises:
        DatasetError: the first camera is missing, or a file cannot be parsed.
    """
    cam0 = read_camera(folder / "undistorted_calib_0.txt")
    if cam0.model != "pinhole":
        raise DatasetError("expected the Pinhole camera of undistorted images", folder / "undistorted_calib_0.txt")
    second, stereo = folder / "undistorted_calib_1.txt", folder / "undistorted_calib_stereo.txt"
    if not (second.exists() and stereo.exists()):
        return StereoCalibration(cam0)
    return StereoCalibration(cam0, read_camera(second), read_stereo(stereo))
