"""Odometry is interrupted at its jumps and at holes, and both sides are registered on their own.

Errors of odometry are modelled as a random walk, which a jump is not: the registrations on both sides of it would
contradict each other, and neither could be trusted.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relocbench.datasets.motion.holes import find_holes
from relocbench.datasets.motion.jumps import Jump, find_jumps
from relocbench.datasets.motion.words import hole_words
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.progress import Reporter

_LARGEST_SHARE = 0.01
"""where more of the steps jump, only the large jumps are none of the noise of this odometry"""
_ALWAYS = 3
"""so many jumps are never noise"""
_LARGE = 5.0
"""large jumps exceed the limit so many times"""


def _interrupted_at_holes(recording: FieldRecording, reporter: Reporter) -> FieldRecording:
    """The recording, its odometry from scans interrupted where there are none; importers judge poses that they read."""
    odometry = recording.odometry
    holes = [hole for hole in find_holes(odometry.times_ns, odometry.T_odom_rig) if hole.index not in odometry.breaks]
    for hole in holes:
        where = f"{recording.name}, {odometry.times_ns[hole.index]} ns"
        reporter.note(f"{where}: {hole_words(hole)}; nothing is interpolated there")
    breaks = tuple(sorted({*odometry.breaks, *(hole.index for hole in holes)}))
    return replace(recording, odometry=replace(odometry, breaks=breaks)) if holes else recording


def jumps_of(odometry: Trajectory) -> tuple[Jump, ...]:
    """The jumps of odometry, in order. Steps across gaps and breaks are none."""
    measured = np.diff(odometry.times_ns) <= odometry.max_gap_ns
    measured[np.array(odometry.breaks, dtype=np.int64) - 1] = False
    return find_jumps(odometry.times_ns, odometry.T_odom_rig, measured)


def interrupted(recording: FieldRecording, reporter: Reporter) -> FieldRecording:
    """The recording, its odometry interrupted at holes and jumps, which are told, unless there are too many jumps."""
    recording = _interrupted_at_holes(recording, reporter) if recording.odometry_lidar else recording
    odometry = recording.odometry
    jumps = jumps_of(odometry)
    if not jumps:
        return recording
    worst = max(jumps, key=lambda jump: jump.metres)
    message = f"{recording.name}: the odometry jumps in {len(jumps)} of its {len(odometry.times_ns) - 1} steps"
    most = max(_ALWAYS, _LARGEST_SHARE * len(odometry.times_ns))
    where = "there"
    if len(jumps) > most:
        count = len(jumps)
        jumps = tuple(jump for jump in jumps if jump.excess > _LARGE)
        if not jumps or len(jumps) > most:
            reporter.note(f"{message}, too many to interrupt it there; poses are as good as it is")
            return recording
        where = f"at the {len(jumps)} largest, since the other {count - len(jumps)} are its noise"
    size = f"most by {worst.metres:.2f} m and {worst.degrees:.1f} deg at {worst.time_ns} ns"
    reporter.note(f"{message}, {size}; it is interrupted {where}")
    breaks = tuple(sorted({*odometry.breaks, *(jump.index for jump in jumps)}))
    return replace(recording, odometry=replace(odometry, breaks=breaks))
