"""What is known of the moment that an image is taken, and how the camera moves then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.conditions.imaging import Imaging
from relocbench.geometry import invert, se3_log


@dataclass(frozen=True, eq=False)
class Shot:
    """One image of a drive, as far as its camera is concerned."""

    imaging: Imaging
    time_s: float
    """seconds since the drive began, on which drifts and drops depend"""
    twist: Array
    """(6,) velocity of the camera in its own axes: m/s, then rad/s"""
    lens: int = 0
    """number of the camera in the rig; each lens has its own dirt and drops"""


def camera_twists(T_world_cam: Array, step_s: float) -> Array:
    """Velocities (N, 6) of a camera at poses (N, 4, 4) that are ``step_s`` seconds apart.

    The motion from the pose before to the pose after, ``log(T_before_after)`` over their time; one-sided at the ends,
    and zero for a single pose. First the linear velocity in m/s, then the angular velocity in rad/s, in camera axes.
    """
    count = len(T_world_cam)
    if count < 2:
        return np.zeros((count, 6))
    before = np.maximum(np.arange(count) - 1, 0)
    after = np.minimum(np.arange(count) + 1, count - 1)
    moved = invert(T_world_cam[before]) @ T_world_cam[after]
    return np.asarray(se3_log(moved) / ((after - before) * step_s)[:, None])
