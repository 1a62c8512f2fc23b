"""Which way is up in a world of poses alone, whose frames may have the axes of a camera or those of a vehicle."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array

_R_VEHICLE_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""axes of a camera that looks ahead, in those of a vehicle: x ahead, y to the left, z up"""


def with_camera_axes(T_world_frame: Array) -> Array:
    """The poses (N, 4, 4) with a camera's axes: x right, y down, z ahead.

    A frame that travels along its z has a camera's axes already; any other is taken to have z up.
    """
    steps = np.diff(T_world_frame[:, :3, 3], axis=0)
    travel = np.abs(np.einsum("nji,nj->ni", T_world_frame[:-1, :3, :3], steps)).sum(axis=0)
    if not len(steps) or np.argmax(travel) == 2:
        return T_world_frame
    out = T_world_frame.copy()
    out[:, :3, :3] = T_world_frame[:, :3, :3] @ _R_VEHICLE_CAMERA
    return out
