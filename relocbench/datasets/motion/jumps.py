"""Jumps: single steps that nothing which carries a sensor can have made.

Visual odometry that loses its points, a scan that was registered wrongly, or GNSS after a tunnel puts one step off by
decimetres or metres.

A step is compared with the steps beside it: the median of their velocities is what the vehicle did, up to accelerations
that vehicles reach, and up to the noise that this odometry has there. A bump or a shake moves the vehicle there and
back within a few steps, so that the deviations of the steps beside make up for that of the step; a jump remains. One
pose that is off, or has a wrong time, comes back too, and is told from a bump by its size only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Indices, Mask, Times
from relocbench.geometry import invert, se3_log

_BESIDE = 2
"""steps before and after a step that tell what the vehicle did"""
LEAST = (0.1, np.radians(0.5))
"""smallest jump, metres and radians"""
_SHAKEN = (15.0, 8.0)
"""m/s^2 and rad/s^2 that vehicles do not exceed on bumps"""
_SWAY = (0.3, np.radians(5.0))
"""metres and radians that bumps do not move a vehicle by"""
_DRIVEN = (8.0, 2.0)
"""m/s^2 and rad/s^2 of steering, braking and accelerating"""
_JITTER_S = 0.01
"""error of times, which looks like a jump by as much as the vehicle moves in it"""
_NOISE = 8.0
"""a jump exceeds the median deviation of the steps around it so many times"""
_AROUND = 15
"""steps before and after a step that tell the noise of the odometry there"""
_SOON_S = 0.5
"""time in which a vehicle comes back from a bump"""
_COMES_BACK = 3.0
"""where the steps soon before and after make up for half of a deviation, a jump exceeds the limit so many times"""
_FAR = 4.0
"""steps so many times as far away in time as steps are long tell nothing"""


@dataclass(frozen=True)
class Jump:
    """A step that no vehicle can have driven."""

    index: int
    """of the pose after it"""
    time_ns: int
    metres: float
    """deviation from what the steps beside it tell"""
    degrees: float
    excess: float
    """how many times the deviation is the largest that is none"""


def find_jumps(times_ns: Times, T_world_rig: Array, measured: Mask | None = None) -> tuple[Jump, ...]:
    """The jumps of a drive, in order. Steps that fewer than two others are near to are not judged.

    Args:
        times_ns: (N,) strictly increasing.
        T_world_rig: (N, 4, 4)
        measured: (N - 1,) whether each step was measured; others, as those across gaps, are not judged. Default: all.
    """
    if len(times_ns) < 2:
        return ()
    twists, seconds, middle = _steps(times_ns, T_world_rig)
    steps = np.arange(len(seconds)) if measured is None else np.flatnonzero(measured)
    jumps: list[Jump] = []
    # The largest jumps are taken first: beside them, right steps look like jumps.
    while len(steps):
        deviation = _Deviations.of(twists[steps], seconds[steps], middle[steps])
        at = np.flatnonzero(deviation.excess > 1.0)
        if not len(at):
            break
        largest_beside = _around(deviation.excess, _BESIDE, 0.0).max(axis=0)
        worst = at[deviation.excess[at] >= largest_beside[at]]
        for k in worst:
            size, index = deviation.sizes[k], int(steps[k]) + 1
            degrees = float(np.degrees(size[1]))
            jumps.append(Jump(index, int(times_ns[index]), float(size[0]), degrees, float(deviation.excess[k])))
        steps = np.delete(steps, worst)
    return tuple(sorted(jumps, key=lambda jump: jump.index))


def steps_beside(times_ns: Times, T_world_rig: Array) -> Array:
    """(N - 1,) metres by which each step differs from what those beside it tell; 0 where fewer than two are near."""
    return _Deviations.of(*_steps(times_ns, T_world_rig)).sizes[:, 0]


def _steps(times_ns: Times, T_world_rig: Array) -> tuple[Array, Array, Array]:
    """(N - 1, 6) twists from pose to pose, their durations in seconds, and the seconds at the middle of each."""
    seconds = np.diff(times_ns) / 1e9
    middle = (times_ns[:-1] - times_ns[0]) / 1e9 + seconds / 2
    return se3_log(invert(T_world_rig[:-1]) @ T_world_rig[1:]), seconds, middle


@dataclass(frozen=True, eq=False)
class _Deviations:
    """How far each of N steps is from what those beside it tell."""

    sizes: Array
    """(N, 2) metres and radians; 0 where the step is not judged"""
    excess: Array
    """(N,) how many times the larger of them is the largest that is no jump"""

    @staticmethod
    def of(twists: Array, seconds: Array, middle: Array) -> _Deviations:
        """
        Args:
            twists: (N, 6) of the steps.
            seconds: (N,) durations of the steps.
            middle: (N,) seconds, increasing.
        """
        velocity = twists / seconds[:, None]
        around = _around(np.arange(len(twists)), _BESIDE, -1)
        apart = middle[around] - middle
        near = (around >= 0) & (np.abs(apart) <= _FAR * np.maximum(seconds, np.median(seconds)))
        judged = near.sum(axis=0) >= 2
        near[:, ~judged] = True  # their deviation is 0, whatever they are compared with
        usual = np.nanmedian(np.where(near[:, :, None], velocity[around], np.nan), axis=0)
        deviation = np.where(judged[:, None], velocity - usual, 0.0) * seconds[:, None]
        sizes = sizes_of(deviation)
        limit = np.maximum(_reached(seconds, apart, near), np.array(LEAST))
        limit = np.maximum(limit, _NOISE * _median(_around(sizes, _AROUND, np.nan)))
        limit = np.maximum(limit, _JITTER_S * sizes_of(usual))
        excess = sizes / limit
        rows = np.flatnonzero((excess > 1.0).any(axis=1))
        excess[rows] /= np.where(_come_back(rows, deviation[rows], twists, seconds, middle), _COMES_BACK, 1.0)
        return _Deviations(sizes, excess.max(axis=1))


def reach(seconds: Array) -> Array:
    """(N, 2) metres and radians by which steps of so many seconds (N,) may differ from the velocity at both ends."""
    squared = np.asarray(seconds)[:, None] ** 2
    driven = np.maximum(np.array(_SWAY), np.array(_DRIVEN) * squared)
    return np.asarray(np.maximum(np.array(LEAST), np.minimum(np.array(_SHAKEN) * squared, driven)))


def _reached(seconds: Array, apart: Array, near: Mask) -> Array:
    """(N, 2) deviations of steps that vehicles reach.

    Args:
        seconds: (N,) durations of the steps.
        apart: (2 _BESIDE, N) seconds from the steps to those beside them.
        near: (2 _BESIDE, N) whether these tell anything.
    """
    count = near.sum(axis=0)
    distance = np.where(near, np.abs(apart), 0.0).sum(axis=0) / count
    # Where the steps beside are all later or all earlier, a constant acceleration deviates as well.
    one_sided = np.abs(np.where(near, apart, 0.0).sum(axis=0)) / count
    squared = (seconds * np.maximum.reduce([seconds, distance / 1.5, one_sided]))[:, None]
    driven = np.maximum(np.array(_SWAY), np.array(_DRIVEN) * squared)
    return np.asarray(np.minimum(np.array(_SHAKEN) * squared, driven))


def _come_back(rows: Indices, deviation: Array, twists: Array, seconds: Array, middle: Array) -> Mask:
    """(M, 2) whether less than half of a deviation remains after the steps soon before and after.

    Args:
        rows: (M,) numbers of steps.
        deviation: (M, 6) of these.
        twists: (N, 6) of all steps.
        seconds: (N,) durations of all steps.
        middle: (N,) seconds.
    """
    beside = np.array([*range(-_AROUND, 0), *range(1, _AROUND + 1)])[:, None] + rows
    inside = (beside >= 0) & (beside < len(middle))
    beside = np.clip(beside, 0, len(middle) - 1)
    apart = middle[beside] - middle[rows]
    soon = (inside & (np.abs(apart) <= _SOON_S))[:, :, None]
    velocity = np.where(soon, twists[beside] / seconds[beside][:, :, None], np.nan)
    # The steps right beside may be of the same bump: what the vehicle did is taken from more of them, and it may
    # accelerate steadily all the while.
    before, after = slice(_AROUND - 1, None, -1), slice(_AROUND, None)
    slope = _median((velocity[after] - velocity[before]) / (apart[after] - apart[before] + 1e-9)[:, :, None])
    slope[:, 3:] = 0.0
    steady = slope * apart[:, :, None]
    usual = _median(velocity - steady)
    own = twists[rows] - usual * seconds[rows][:, None]
    others = np.where(soon, (velocity - steady - usual) * seconds[beside][:, :, None], 0.0).sum(axis=0)
    parts = (slice(0, 3), slice(3, 6))
    kept = [np.sum((own + others)[:, part] * deviation[:, part], axis=1) for part in parts]
    whole = [np.sum(deviation[:, part] ** 2, axis=1) for part in parts]
    known = soon.sum(axis=0) >= 2
    return np.asarray(known & (np.stack(kept, axis=1) < 0.5 * np.stack(whole, axis=1)))


def _median(values: Array) -> Array:
    """(N, ...) medians of the values (K, N, ...) that are not nan; 0 where all are."""
    values[0] = np.where(np.isnan(values).all(axis=0), 0.0, values[0])
    return np.asarray(np.nanmedian(values, axis=0))


def sizes_of(twists: Array) -> Array:
    """(N, 2) lengths of the translations and of the rotations of twists (N, 6)."""
    return np.stack([np.linalg.norm(twists[:, :3], axis=1), np.linalg.norm(twists[:, 3:], axis=1)], axis=1)


def _around(values: NDArray[Any], reach: int, beyond: float) -> NDArray[Any]:
    """(2 reach, N, ...) of each of N steps, the values (N, ...) of those beside it; ``beyond`` beyond the ends."""
    out = np.full((2 * reach, *values.shape), beyond, dtype=values.dtype)
    for row, by in enumerate((*range(-reach, 0), *range(1, reach + 1))):
        if abs(by) >= len(values):
            continue
        if by > 0:
            out[row, :-by] = values[by:]
        else:
            out[row, -by:] = values[:by]
    return out
