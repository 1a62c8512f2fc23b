"""The calibration of a vehicle: poses of sensors on its body, and intrinsics of cameras.

``NAME_body.yaml`` is a ``geometry_msgs/TransformStamped``, which the dataset's own tools publish as it is
(``ford_demo/scripts/extrinsics_broadcaster.py`` of github.com/Ford/AVData): the pose of ``child_frame_id`` in
``header.frame_id``. ``NAMEIntrinsics.yaml`` has the keys of ``sensor_msgs/CameraInfo``. Images are rectified
(avdata.ford.com, Data), so that P applies. Frames of cameras are optical: x right, y down, z forward.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, Field

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Strict
from relocbench.datasets.importers.lidar_drives.texts import finite_numbers
from relocbench.errors import DatasetError
from relocbench.files import load_yaml, load_yaml_values
from relocbench.geometry import invert, make_transform, transform_from_tq

BODY = "body"
T_RIG_BODY = make_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.0])
"""from x forward, y right, z down to x forward, y left, z up; origin in the middle of the rear axle"""
FULL_SIZE = (1656, 860)
"""of the images of the six cameras on the roof"""
_LEAST_UP = 0.5
_MOST_UPRIGHT = float(np.cos(np.radians(30)))


class _Read(Strict):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


class _Header(_Read):
    frame_id: str


class _Vector(_Read):
    x: float
    y: float
    z: float


class _Quaternion(_Vector):
    w: float


class _Rigid(_Read):
    translation: _Vector
    rotation: _Quaternion


class _Stamped(_Read):
    """The keys of a TransformStamped that are used."""

    header: _Header
    child_frame_id: str = Field(min_length=1)
    transform: _Rigid


def read_body_pose(path: Path) -> Array:
    """``T_rig_sensor`` (4, 4) by a ``NAME_body.yaml``. Raises DatasetError with file and line."""
    found = load_yaml(path, _Stamped, "the pose of a sensor on the body", DatasetError)
    t, q = found.transform.translation, found.transform.rotation
    values = np.array([q.x, q.y, q.z, q.w])
    norm = float(np.linalg.norm(values))
    if not abs(norm - 1.0) <= 1e-3:
        raise DatasetError(f"the quaternion in transform.rotation has norm {norm:.6g}, expected 1", path)
    T_parent_child = transform_from_tq([t.x, t.y, t.z], values / norm)
    parent, child = found.header.frame_id.removeprefix("/"), found.child_frame_id.removeprefix("/")
    if BODY not in (parent, child) or parent == child:
        raise DatasetError(f"is the pose of '{child}' in '{parent}'; expected one in '{BODY}'", path)
    return np.asarray(T_RIG_BODY @ (T_parent_child if parent == BODY else invert(T_parent_child)))


def read_lidar_pose(path: Path) -> Array:
    """``T_rig_lidar`` (4, 4). Raises DatasetError with file and line, also if the lidar would stand on its head."""
    T_rig_lidar = read_body_pose(path)
    if T_rig_lidar[2, 2] < _LEAST_UP:
        raise DatasetError(f"its z axis would not point up on '{BODY}' (x forward, y right, z down)", path)
    return T_rig_lidar


def read_camera_pose(path: Path) -> Array:
    """``T_rig_cam`` (4, 4). Raises DatasetError with file and line, also if the camera would look up or down."""
    T_rig_cam = read_body_pose(path)
    if abs(T_rig_cam[2, 2]) > _MOST_UPRIGHT:
        raise DatasetError("the camera would look up or down; expected axes x right, y down, z forward", path)
    return T_rig_cam


def read_intrinsics(path: Path) -> tuple[tuple[float, float, float, float], tuple[int, int] | None]:
    """fx, fy, cx, cy of rectified images by P, or else K, and the size of images if it is told.

    Raises:
        DatasetError: with the file: there is neither, or it has no focal lengths.
    """
    values, _ = load_yaml_values(path, "the intrinsics of a camera", DatasetError)
    for name, count in (("P", 12), ("K", 9)):
        found = values.get(name)
        if found is None:
            continue
        matrix = finite_numbers(found, name, count, path).reshape(3, -1)
        fx, fy, cx, cy = (float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
        if fx <= 0 or fy <= 0:
            raise DatasetError(f"{name} has the focal lengths {fx:g} and {fy:g}", path)
        return (fx, fy, cx, cy), _size(values)
    raise DatasetError("has neither P nor K; expected those of a camera (sensor_msgs/CameraInfo)", path)


def _size(values: dict[str, Any]) -> tuple[int, int] | None:
    size = values.get("width"), values.get("height")
    known = all(isinstance(v, int) and not isinstance(v, bool) and v > 0 for v in size)
    return (int(size[0]), int(size[1])) if known else None  # type: ignore[arg-type]
