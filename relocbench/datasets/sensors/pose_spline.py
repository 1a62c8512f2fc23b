"""A smooth motion through poses: cubic splines of the position and of the rotation."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices, Times
from relocbench.geometry import make_transform

_CLOSEST = 0.2
"""poses closer in time than this share of their usual spacing tell no velocity: their noise would make a bulge"""
_GRADED = 1 / 3
"""the same of the next interval, into which their velocity is drawn on"""
_WIDE = 1.5
"""an interval at an end that is so many times as long as usual is wide"""


class PoseSpline:
    """Poses between given ones, with continuous velocity and acceleration of position and rotation.

    Straight lines between the poses of a car that sways, 0.1 s apart, are off by an eighth of its acceleration times
    0.01 s^2, which for 0.4 rad/s^2 is 0.03 degrees.
    """

    def __init__(self, timestamps_ns: Times, transforms: ArrayLike) -> None:
        """
        Args:
            timestamps_ns: (N,) strictly increasing, at least two.
            transforms: (N, 4, 4) ``T_world_body``.
        """
        self._times_ns = timestamps_ns
        self._poses = np.asarray(transforms, dtype=np.float64)

    @property
    def last_ns(self) -> int:
        """The time of the last pose."""
        return int(self._times_ns[-1])

    @cached_property
    def _curves(self) -> tuple[Any, Any]:
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        rows = self._knots()
        seconds, poses = self._seconds(self._times_ns[rows]), self._poses[rows]
        return (
            CubicSpline(seconds, poses[:, :3, 3], bc_type=(_end(seconds), _end(seconds[::-1]))),
            RotationSpline(seconds, Rotation.from_matrix(poses[:, :3, :3])),
        )

    def _knots(self) -> Indices:
        """The poses that the curves go through: the first, the last, and those that are not too close to others."""
        spacing = np.diff(self._times_ns)
        closest = _CLOSEST * float(np.median(spacing))
        rows = _spread(self._times_ns, np.arange(len(self._times_ns)), closest)
        return _spread(-self._times_ns, rows[::-1], closest)[::-1]

    def _seconds(self, times_ns: Times) -> Array:
        # Differences are taken as integers: float64 cannot hold a present-day nanosecond count.
        return np.asarray((times_ns - self._times_ns[0]) / 1e9)

    def at(self, query_ns: Times) -> Array:
        """(M, 4, 4) ``T_world_body`` at times (M,) within the span; the given poses themselves at their times.

        The curves pass by poses that are much closer in time to another than poses usually are, or than the next
        interval is long.
        """
        if not len(query_ns):
            return np.zeros((0, 4, 4))
        position, rotation = self._curves
        seconds = self._seconds(query_ns)
        out = make_transform(rotation(seconds).as_matrix(), position(seconds))
        place = np.minimum(np.searchsorted(self._times_ns, query_ns), len(self._times_ns) - 1)
        exact = self._times_ns[place] == query_ns
        out[exact] = self._poses[place[exact]]
        return out


def _end(seconds: Array) -> Literal["natural", "not-a-knot"]:
    """How the curve begins: as the one beside its first interval; without curvature where that is wide.

    A curve that is drawn on from narrow intervals into a wide one enlarges the noise of their poses.
    """
    spacing = np.abs(np.diff(seconds))
    return "natural" if spacing[0] > _WIDE * np.median(spacing) else "not-a-knot"


def _spread(times_ns: Times, rows: Indices, closest: float) -> Indices:
    """The first and the last of the rows, and those between whose interval is no small part of the one before."""
    kept, before = [int(rows[0])], 0.0
    for row in rows[1:]:
        interval = float(times_ns[row] - times_ns[kept[-1]])
        if interval >= max(closest, _GRADED * before):
            kept.append(int(row))
            before = interval
    if kept[-1] != rows[-1]:
        kept = [*kept[: max(len(kept) - 1, 1)], int(rows[-1])]
    return np.array(kept)
