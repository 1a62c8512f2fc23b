"""Holes: steps between poses that take much longer than those of this drive do, and in which it moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.geometry import rotation_angle

_LONG = 5.0
"""a hole takes so many times as long as the usual step, of the whole drive and of those around it: rates may
change, and keyframes of a slow drive are up to 3 times as far apart in time as usual"""
_LONG_S = 0.1
"""and at least so many seconds: in these an acceleration of 8 m/s^2 bends the way by 1 cm"""
_MOVED = 2.0
"""in a hole the rig moves so many times as far, or turns as much, as in a usual step: standing still leaves none"""
_LEAST = (0.02, np.radians(2.0))
"""metres and radians that it moves or turns at least"""
_AROUND = 15
"""steps before and after a step that tell the rate there"""
_FEWEST = 4
"""steps that tell what is usual"""


@dataclass(frozen=True)
class Hole:
    """A step in which nobody knows the way."""

    index: int
    """row of the pose after it"""
    seconds: float
    metres: float
    usual_s: float
    """duration of most steps"""


def find_holes(times_ns: Times, T_world_rig: Array) -> tuple[Hole, ...]:
    """The holes of a drive with poses (N, 4, 4) at N times that strictly increase."""
    if len(times_ns) <= _FEWEST:
        return ()
    seconds = np.diff(times_ns) / 1e9
    usual = float(np.median(seconds))
    long = np.flatnonzero((seconds > _LONG * usual) & (seconds > _LONG_S))
    if not len(long):
        return ()
    turned = np.asarray(rotation_angle(np.swapaxes(T_world_rig[:-1, :3, :3], 1, 2) @ T_world_rig[1:, :3, :3]))
    moves = np.stack([np.linalg.norm(np.diff(T_world_rig[:, :3, 3], axis=0), axis=1), turned], axis=1)
    short = seconds <= _LONG * usual
    least = np.maximum(_MOVED * moves[short].mean(axis=0), _LEAST)
    holes = []
    for k in long.tolist():
        around = np.delete(seconds[max(0, k - _AROUND) : k + _AROUND + 1], min(k, _AROUND))
        if seconds[k] > _LONG * np.median(around) and (moves[k] > least).any():
            holes.append(Hole(k + 1, float(seconds[k]), float(moves[k, 0]), usual))
    return tuple(holes)
