"""A smooth motion through poses: cubic splines of the position and of the rotation."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.geometry import make_transform

Array = NDArray[np.float64]

_CLOSEST = 0.2
"""poses closer in time than this share of their usual spacing tell no velocity: their noise would make a bulge"""


class PoseSpline:
    """Poses between given ones, with continuous velocity and acceleration of position and rotation.

    Straight lines between the poses of a car that sways, 0.1 s apart, are off by an eighth of its acceleration times
    0.01 s^2, which for 0.4 rad/s^2 is 0.03 degrees.
    """

    def __init__(self, timestamps_ns: NDArray[np.int64], transforms: ArrayLike) -> None:
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
        return CubicSpline(seconds, poses[:, :3, 3]), RotationSpline(seconds, Rotation.from_matrix(poses[:, :3, :3]))

    def _knots(self) -> NDArray[np.intp]:
        """The poses that the curves go through: the first, the last, and those that are not too close to others."""
        spacing = np.diff(self._times_ns)
        closest = _CLOSEST * float(np.median(spacing))
        if float(spacing.min()) >= closest:
            return np.arange(len(self._times_ns))
        rows = [0]
        for row in range(1, len(self._times_ns)):
            if self._times_ns[row] - self._times_ns[rows[-1]] >= closest:
                rows.append(row)
        last = len(self._times_ns) - 1
        if rows[-1] != last:
            rows = [*rows[:-1], last] if len(rows) > 1 else [0, last]
        return np.array(rows)

    def _seconds(self, times_ns: NDArray[np.int64]) -> Array:
        # Differences are taken as integers: float64 cannot hold a present-day nanosecond count.
        return np.asarray((times_ns - self._times_ns[0]) / 1e9)

    def at(self, query_ns: NDArray[np.int64]) -> Array:
        """(M, 4, 4) ``T_world_body`` at times (M,) within the span; the given poses themselves at their times.

        The curves pass by poses that are much closer in time to the one before than poses usually are.
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
