"""Poses as the six numbers that the pose network predicts: three Euler angles and a translation.

The rotation is ``R = R_y(yaw) R_x(pitch) R_z(roll)`` in the axes of the query's camera (x right, y down, z forward).
Angles are unique for a pitch of less than 90 degrees.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import make_transform, so3_exp


def pose_of(numbers: Array) -> Array:
    """The transform (4, 4) of pitch, yaw and roll in radians and a translation in metres, (6,)."""
    pitch, yaw, roll = numbers[:3]
    rotation = so3_exp([0.0, yaw, 0.0]) @ so3_exp([pitch, 0.0, 0.0]) @ so3_exp([0.0, 0.0, roll])
    return make_transform(rotation, numbers[3:])


def numbers_of(transform: Array) -> Array:
    """The inverse of :func:`pose_of`: (6,) of a transform (4, 4)."""
    R = transform[:3, :3]
    pitch = np.arctan2(-R[1, 2], np.hypot(R[0, 2], R[2, 2]))
    yaw, roll = np.arctan2(R[0, 2], R[2, 2]), np.arctan2(R[1, 0], R[1, 1])
    return np.concatenate([[pitch, yaw, roll], transform[:3, 3]])
