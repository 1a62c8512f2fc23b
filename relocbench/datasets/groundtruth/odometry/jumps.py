"""Jumps of odometry: single steps that no vehicle can have driven, where the odometry is interrupted.

Visual odometry that loses its points, or a scan that was registered wrongly, puts one step off by decimetres. Errors of
odometry are modelled as a random walk, which a jump is not: the registrations on both sides of it would contradict each
other, and neither could be trusted. Where the odometry is interrupted, both sides are registered on their own.

A step is compared with the steps beside it: the median of their velocities is what the vehicle did, up to accelerations
that vehicles reach, and up to the noise that this odometry has everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.geometry import invert, se3_log
from relocbench.progress import Reporter

_BESIDE = 2
"""steps before and after a step that tell what the vehicle did"""
_LEAST = (0.1, np.radians(0.5))
"""smallest jump, metres and radians"""
_ACCELERATION = (15.0, 8.0)
"""m/s^2 and rad/s^2 that vehicles do not exceed, bumps included"""
_JITTER_S = 0.01
"""error of times, which looks like a jump by as much as the vehicle moves in it"""
_NOISE = 8.0
"""a jump exceeds the median deviation of all steps so many times"""
_LARGEST_SHARE = 0.01
"""where more of the steps jump, it is the noise of this odometry, and nothing is interrupted"""
_ALWAYS = 3
"""so many jumps are never noise"""


@dataclass(frozen=True)
class Jump:
    """A step that no vehicle can have driven."""

    index: int
    """of the pose after it"""
    time_ns: int
    metres: float
    """deviation from what the steps beside it tell"""
    degrees: float


def find_jumps(odometry: Trajectory) -> tuple[Jump, ...]:
    """The jumps of odometry, in order. Steps across gaps and breaks are none."""
    count = len(odometry.times_ns)
    if count < 2 * _BESIDE + 2:
        return ()
    seconds = np.diff(odometry.times_ns) / 1e9
    step = invert(odometry.T_odom_rig[:-1]) @ odometry.T_odom_rig[1:]
    measured = seconds * 1e9 <= odometry.max_gap_ns
    measured[np.array(odometry.breaks, dtype=np.int64) - 1] = False
    velocity = np.where(measured[:, None], se3_log(step) / seconds[:, None], np.nan)
    usual = _beside(velocity)
    deviation = (velocity - usual) * seconds[:, None]
    off = _sizes(deviation)
    known = np.isfinite(off).all(axis=1)
    if not known.any():
        return ()
    # Neighbours further away in time tell less: the vehicle may have accelerated all the way.
    span = np.maximum(seconds, _spacing(seconds))
    limit = np.maximum(np.array(_LEAST), np.array(_ACCELERATION) * span[:, None] ** 2)
    limit = np.maximum(limit, _NOISE * np.median(off[known], axis=0))
    limit = np.maximum(limit, _JITTER_S * _sizes(usual))
    found = np.flatnonzero(known & (off > limit).any(axis=1))
    return tuple(
        Jump(int(k) + 1, int(odometry.times_ns[k + 1]), float(off[k, 0]), float(np.degrees(off[k, 1]))) for k in found
    )


def interrupted(recording: FieldRecording, reporter: Reporter) -> FieldRecording:
    """The recording, its odometry interrupted at its jumps, which are told; itself where there are none or too many."""
    odometry = recording.odometry
    jumps = find_jumps(odometry)
    if not jumps:
        return recording
    worst = max(jumps, key=lambda jump: jump.metres)
    told = f"{recording.name}: the odometry jumps in {len(jumps)} of its {len(odometry.times_ns) - 1} steps"
    if len(jumps) > max(_ALWAYS, _LARGEST_SHARE * len(odometry.times_ns)):
        reporter.note(f"{told}, too many to interrupt it there; poses are as good as it is")
        return recording
    most = f"most by {worst.metres:.2f} m and {worst.degrees:.1f} deg at {worst.time_ns} ns"
    reporter.note(f"{told}, {most}; it is interrupted there")
    breaks = tuple(sorted({*odometry.breaks, *(jump.index for jump in jumps)}))
    return replace(recording, odometry=replace(odometry, breaks=breaks))


def _sizes(twists: Array) -> Array:
    """(N, 2) lengths of the translations and of the rotations of twists (N, 6)."""
    return np.stack([np.linalg.norm(twists[:, :3], axis=1), np.linalg.norm(twists[:, 3:], axis=1)], axis=1)


def _around(values: Array) -> Array:
    """(2 _BESIDE, N, ...) of each of N steps, the values (N, ...) of those beside it; nan beyond the ends."""
    out = np.full((2 * _BESIDE, *values.shape), np.nan)
    for row, by in enumerate((*range(-_BESIDE, 0), *range(1, _BESIDE + 1))):
        if by > 0:
            out[row, :-by] = values[by:]
        else:
            out[row, -by:] = values[:by]
    return out


def _beside(velocity: Array) -> Array:
    """(N, 6) median velocity of the steps beside each step; nan where fewer than three are measured."""
    around = _around(velocity)
    enough = np.isfinite(around).sum(axis=0) >= 3
    around[:, ~enough] = 0.0
    return np.where(enough, np.nanmedian(around, axis=0), np.nan)


def _spacing(seconds: Array) -> Array:
    """(N,) mean duration of the steps beside each step."""
    return np.asarray(np.nanmean(_around(seconds), axis=0))
