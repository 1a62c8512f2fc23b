"""The length of a drive by its odometry relative to that by GNSS: odometry whose scale is wrong fits no other drive's.

Chords between poses, end to end along the drive, are compared, since a chord does not depend on the direction in which
the odometry drifts. How well their mean ratio is known is told by their spread. Where GNSS wanders slowly the spread
shows too little: the lengths can never be known better than the positions at both ends of the drive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats.mstats import trimmed_mean, trimmed_mean_ci

from relocbench.arrays import Array, Indices
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import path_lengths

LARGEST_STRETCH = 0.04
"""largest error of the odometry's scale: submaps that are stretched more do not fit those of other drives"""
_CHORDS_M = (20.0, 50.0, 100.0, 200.0)
"""distances along the drive that chords span; those that tell the ratio best are taken"""
_SIGMAS = 10.0
"""standard deviations of GNSS that a chord has at least: noise makes shorter ones longer"""
_FEWEST = 5
"""chords whose spread tells something"""
_LEAST_SHARE = 0.5
"""a chord is at least this share of the way: in tighter bends its length depends on the heading's drift"""
_TRIMMED = 0.2
"""share of the chords with the smallest and with the largest ratios that is left out: GNSS may jump there"""
_DOUBT = 0.002
"""probability that the true ratio is outside the margin"""
_ENDS = 3.0
"""errors of GNSS at the ends of the drive, in standard deviations, that are reckoned with"""


@dataclass(frozen=True)
class LengthRatio:
    """How many times as long a drive is by its odometry as by another measurement."""

    ratio: float
    margin: float
    """largest error of the ratio that is reckoned with"""

    def exceeds(self, stretch: float) -> bool:
        """Whether the lengths certainly differ by more than a share."""
        return abs(self.ratio - 1) - self.margin > stretch

    def words(self, digits: int) -> str:
        """How much the odometry is longer or shorter, such as ``8.2 % longer``."""
        return f"{100 * abs(self.ratio - 1):.{digits}f} % {'longer' if self.ratio > 1 else 'shorter'}"


def length_ratio(odometry: Trajectory, prior: Trajectory, sigma_m: float) -> LengthRatio | None:
    """The ratio of the lengths; None if odometry and GNSS have fewer than five chords in common.

    A chord is at least 20 m, and ten standard deviations of GNSS. GNSS may have heights or not: of the ratios with and
    without them, that nearer to 1 is returned.

    Args:
        odometry: whose pieces are measured each on its own.
        prior: ``T_map_rig`` by GNSS.
        sigma_m: standard deviation of the positions by GNSS.
    """
    times = odometry.times_ns[prior.covers(odometry.times_ns)]
    if len(times) < 2:
        return None
    piece = odometry.pieces(times)
    rows = [np.flatnonzero(piece == number) for number in np.unique(piece)]
    positions, mapped = odometry.at(times)[:, :3, 3], prior.at(times)[:, :3, 3]
    ratios = []
    for axes in (2, 3):
        by_chords = [
            one
            for chord_m in _CHORDS_M
            if chord_m >= _SIGMAS * sigma_m
            for one in [_by_chords(positions, mapped[:, :axes], rows, chord_m, sigma_m)]
            if one is not None
        ]
        ratios += [min(by_chords, key=lambda one: one.margin)] if by_chords else []
    return min(ratios, key=lambda one: abs(one.ratio - 1), default=None)


def _by_chords(
    positions: Array, mapped: Array, rows: list[Indices], chord_m: float, sigma_m: float
) -> LengthRatio | None:
    """The ratio by chords of one length; None if there are too few.

    Args:
        positions: (N, 3) by odometry.
        mapped: (N, 2) or (N, 3) by GNSS.
        rows: of each piece of the drive.
    """
    ends = [_ends_of_chords(positions, of_piece, chord_m) for of_piece in rows]
    first, last = (np.concatenate([pair[side] for pair in ends]) for side in (0, 1))
    by_odometry = np.linalg.norm(positions[last] - positions[first], axis=1)
    by_gnss = np.linalg.norm(mapped[last] - mapped[first], axis=1)
    usable = (by_odometry >= _LEAST_SHARE * chord_m) & (by_gnss > 0)
    if usable.sum() < _FEWEST:
        return None
    ratios, limits = by_odometry[usable] / by_gnss[usable], (_TRIMMED, _TRIMMED)
    low, high = trimmed_mean_ci(ratios, limits, alpha=_DOUBT)
    by_ends = _ENDS * np.sqrt(2) * sigma_m / float(by_gnss[usable].sum())
    return LengthRatio(float(trimmed_mean(ratios, limits)), max(by_ends, float(high - low) / 2))


def _ends_of_chords(positions: Array, rows: Indices, chord_m: float) -> tuple[Indices, Indices]:
    """(K,), (K,) the rows of positions (N, 3) at which chords begin and end, of rows (M,) of a piece."""
    way = path_lengths(positions[rows])
    places = np.searchsorted(way, np.arange(0.0, way[-1], chord_m))
    return rows[places[:-1]], rows[places[1:]]
