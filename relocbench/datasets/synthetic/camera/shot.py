"""The moment that an image is taken: how the camera moves then, and what has drifted since the drive began."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

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


_PERIODS_S = (7.0, 45.0)
_WAVES = 3


class Drifting(IntEnum):
    """What drifts; each has its own course."""

    EXPOSURE = 1
    WHITE_BALANCE = 2


def drift(seed: int, what: Drifting, time_s: float) -> float:
    """A value within [-1, 1] that depends smoothly on time: the mean of waves with drawn periods of 7 to 45 s.

    It changes by less than 0.9 in a second.
    """
    rng = np.random.default_rng([seed, 42, int(what)])
    period, phase = rng.uniform(*_PERIODS_S, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
    return float(np.sin(2 * np.pi * time_s / period + phase).mean())
