"""Which way is up where there are poses alone, of frames that may have the axes of a camera or those of a vehicle."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array

R_VEHICLE_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""axes of a camera that looks ahead, in those of a vehicle: x ahead, y to the left, z up"""


def R_frame_camera(T_world_frame: Array) -> Array:
    """(3, 3) axes of a camera that looks ahead (x right, y down, z ahead), in those of a frame with these poses.

    A frame that travels along its z has a camera's axes already; any other is taken to have z up.

    Args:
        T_world_frame: (N, 4, 4) along a drive; a frame that does not move is taken for a camera.
    """
    steps = np.diff(T_world_frame[:, :3, 3], axis=0)
    travel = np.abs(np.einsum("nji,nj->ni", T_world_frame[:-1, :3, :3], steps)).sum(axis=0)
    return np.eye(3) if not travel.any() or np.argmax(travel) == 2 else R_VEHICLE_CAMERA.copy()


def with_camera_axes(T_world_frame: Array) -> Array:
    """The poses (N, 4, 4) turned to the axes of a camera that looks ahead; see :func:`R_frame_camera`."""
    out = T_world_frame.copy()
    out[:, :3, :3] = T_world_frame[:, :3, :3] @ R_frame_camera(T_world_frame)
    return out
