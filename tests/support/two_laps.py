"""A car's poses on two laps of one loop, without any image: ``from two_laps import laps, tum_lines``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import make_transform, transform_to_tq

START_NS = 1_600_000_000_000_000_000
LAP = 60
"""poses of a lap, one a second"""
RADIUS_M = 40.0


def laps(count: int = 2, *, aside_m: float = 0.4, start_ns: int = START_NS) -> dict[int, Array]:
    """timestamp_ns -> (4, 4) ``T_world_rig`` of a car (x ahead, y left, z up), each lap ``aside_m`` further out.

    The car is turned a little against its way and pitches, so that no axis of a rotation stays zero.
    """
    out = {}
    for step in range(count * LAP):
        angle = 2 * np.pi * (step + 0.3 * (step // LAP)) / LAP
        radius = RADIUS_M + aside_m * (step // LAP)
        heading = angle + np.pi / 2 + 0.02 * np.sin(3 * angle)
        pitch = 0.03 * np.sin(2 * angle)
        c, s = np.cos(heading), np.sin(heading)
        yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        c, s = np.cos(pitch), np.sin(pitch)
        tilt = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        centre = [radius * np.cos(angle), radius * np.sin(angle), 0.5 * np.sin(angle)]
        out[start_ns + step * 10**9] = make_transform(yaw @ tilt, centre)
    return out


def tum_lines(poses: Mapping[int, Array], order: str = "xyzw", between: str = " ") -> str:
    """The poses as a TUM trajectory, quaternions in either order."""
    lines = []
    for time, pose in poses.items():
        t, (x, y, z, w) = transform_to_tq(pose)
        quaternion = (x, y, z, w) if order == "xyzw" else (w, x, y, z)
        seconds = f"{time // 10**9}.{time % 10**9:09d}"
        lines.append(between.join([seconds, *(repr(float(v)) for v in (*t, *quaternion))]))
    return "".join(line + "\n" for line in lines)


def matrix_lines(poses: Mapping[int, Array], *, timed: bool) -> str:
    """The upper three rows of each pose, a line each, with its time in nanoseconds before them if wanted."""
    rows = (
        [*([str(time)] if timed else []), *(repr(float(v)) for v in pose[:3].ravel())] for time, pose in poses.items()
    )
    return "".join(" ".join(row) + "\n" for row in rows)
