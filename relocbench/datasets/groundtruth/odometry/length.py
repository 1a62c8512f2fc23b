"""The length of a drive by its odometry relative to that by GNSS: odometry whose scale is wrong fits no other drive's.

GNSS is metres off, but hardly differently at the two ends of a hundred metres. Chords between poses a window apart are
therefore compared: a chord does not depend on the direction in which the odometry drifts, and the median of many
does not depend on jumps of GNSS.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.datasets.sensors.recording import Trajectory

_STEP_M = 5.0
"""distance along the drive between the chords' beginnings"""
_CHORD_M = (60.0, 100.0, 150.0)
"""distances along the drive that the chords span"""
_END_TO_END = 1.9
"""so many chords must fit into the drive end to end: the noise of one is not known"""
_LEAST_SHARE = 0.5
"""a chord is at least this share of the way: in tighter bends its length depends on the heading's drift"""


@dataclass(frozen=True)
class LengthRatio:
    """How many times as long a drive is by its odometry as by its GNSS."""

    ratio: float
    sigma: float
    """its standard deviation"""


def length_ratio(odometry: Trajectory, prior: Trajectory, sigma_m: float = 1.0) -> LengthRatio | None:
    """The ratio of the lengths; None if odometry and GNSS have fewer than 114 m in common.

    Args:
        odometry: whose pieces are measured each on its own.
        prior: ``T_map_rig`` by GNSS; heights are not used.
        sigma_m: standard deviation of the change of GNSS's error over a chord.
    """
    times = odometry.times_ns[prior.covers(odometry.times_ns)]
    if len(times) < 2:
        return None
    piece = odometry.pieces(times)
    positions = odometry.at(times)[:, :3, 3]
    mapped = prior.at(times)[:, :2, 3]
    for chord_m in reversed(_CHORD_M):
        ratios, lengths, covered = [], [], 0.0
        for number in np.unique(piece):
            rows = np.flatnonzero(piece == number)
            way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions[rows], axis=0), axis=1))])
            starts = np.arange(0.0, way[-1] - chord_m, _STEP_M)
            a, b = (rows[np.searchsorted(way, starts + d)] for d in (0.0, chord_m))
            by_odometry = np.linalg.norm(positions[b] - positions[a], axis=1)
            by_gnss = np.linalg.norm(mapped[b] - mapped[a], axis=1)
            straight = by_odometry >= _LEAST_SHARE * chord_m
            straight &= by_gnss > 0
            ratios += (by_odometry / np.maximum(by_gnss, 1e-9))[straight].tolist()
            lengths += by_odometry[straight].tolist()
            covered += float(way[-1]) if straight.any() else 0.0
        if len(ratios) >= 3 and covered >= _END_TO_END * chord_m:
            # Chords that overlap share errors: only as many count as fit into the drive end to end.
            independent = max(1.0, covered / chord_m)
            spread = 1.4826 * float(np.median(np.abs(np.array(ratios) - np.median(ratios))))
            sigma = max(spread, sigma_m / float(np.median(lengths))) / np.sqrt(independent)
            return LengthRatio(float(np.median(ratios)), float(sigma))
    return None
