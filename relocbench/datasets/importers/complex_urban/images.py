"""The stereo cameras of the Complex Urban dataset: Bayer mosaics, not rectified, with calibration as ROS writes it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.lidar_drives.files import camera_of
from relocbench.datasets.importers.lidar_drives.texts import finite_numbers
from relocbench.errors import DatasetError
from relocbench.files import load_yaml_value
from relocbench.geometry import Camera, invert, is_rotation, make_transform, project_to_rotation


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A calibration file of ROS (``camera_calibration_parsers``)."""

    camera: Camera
    R_rect_cam: Array
    """(3, 3)"""
    projection: Array
    """(3, 4) of the rectified camera"""


def read_intrinsics(path: Path) -> Intrinsics:
    """Read ``left.yaml`` or ``right.yaml``.

    Raises:
        DatasetError: with the file: an entry is missing or wrong, or the model is not plumb_bob.
    """
    values = load_yaml_value(path, "a camera calibration of ROS", DatasetError)
    if not isinstance(values, dict):
        raise DatasetError("expected entries image_width, camera_matrix and the like", path)
    if values.get("distortion_model", "plumb_bob") != "plumb_bob":
        raise DatasetError(f"distortion_model is {str(values['distortion_model'])[:40]}, expected plumb_bob", path)

    def matrix(name: str, count: int) -> Array:
        return finite_numbers(values.get(name), name, count, path)

    size = (_whole(values, "image_width", path), _whole(values, "image_height", path))
    K = matrix("camera_matrix", 9).reshape(3, 3)
    distortion = tuple(matrix("distortion_coefficients", 5).tolist())
    R = matrix("rectification_matrix", 9).reshape(3, 3)
    if not is_rotation(R, 1e-3):
        raise DatasetError("rectification_matrix is not a rotation", path)
    P = matrix("projection_matrix", 12).reshape(3, 4)
    camera = camera_of("radtan", size, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), distortion, path)
    return Intrinsics(camera, project_to_rotation(R), P)


def T_left_right(left: Intrinsics, right: Intrinsics) -> Array:
    """(4, 4) from the right to the left camera: both rectified frames differ by the baseline in ``P = K [I | t]``."""
    apart = make_transform(np.eye(3), [-right.projection[0, 3] / right.projection[0, 0], 0.0, 0.0])
    T_rect_left, T_rect_right = (make_transform(each.R_rect_cam, np.zeros(3)) for each in (left, right))
    return np.asarray(invert(T_rect_left) @ apart @ T_rect_right)


def _whole(values: dict[str, Any], name: str, path: Path) -> int:
    value = values.get(name)
    if not isinstance(value, int) or isinstance(value, bool):
        raise DatasetError(f"{name} is missing or not a whole number", path)
    return value
