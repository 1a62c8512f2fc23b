"""Outlier poses and jumps: which poses of a drive cannot have been reached from the others.

Jumps (:mod:`.jumps`) cut a drive into pieces. Going through the pieces in order, each may be taken, across the jump
before it, or left out, if the piece after it fits to one before it: the way between them can have been driven, since it
differs from what the velocities at both cuts tell by no more than accelerations allow in that time. Of all ways through
the drive that of the least cost is chosen (dynamic programming): a jump costs as much as 5.5 poses, a pose that is left
out 1. So up to ten poses that lie beside the drive are outliers, and more of them stay as both sides of two jumps:
GNSS that shifts by metres after a tunnel, or a map that was corrected; nobody knows which side is right. Longer
stretches cost no more than ten poses if they are surely wrong: farther away than GNSS errs, the same to the last digit,
as systems write poses that have lost track, or over within a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices, Times
from relocbench.datasets.motion.jumps import Jump, find_jumps, reach, sizes_of
from relocbench.geometry import invert, rotation_angle, se3_exp, se3_log

CERTAIN = 2.0
"""jumps exceed what vehicles and hands do so many times. Steps of the truth of KITTI 00, which is as good as its GNSS,
exceed it 1.5 times; those of 4Seasons that exceed it 2 to 4 times are 0.8 to 1.1 m"""
FASTEST = (100.0, 340.0)
"""m/s: nothing on roads, rails or rotors is faster than the first, nothing that carries a camera than the second.
Between them, a step may be three times as fast as most of the drive"""
_NEAR_M = 10.0
"""steps up to this length are not judged by their speed: at 100 Hz, 100 m/s is 1 m"""
_JUMP = 5.5
"""cost of a jump whose both sides stay, in poses"""
_WRONG = 10.0
"""largest cost of a stretch of poses that are surely wrong"""
_AT_END = 1.8
"""cost of a pose at an end of the drive: only one side speaks against it, and so three of them go for one jump"""
_SURE = 4.0
"""what is left out lies beside a jump that exceeds what is possible so many times; smaller ones are told, and stay"""
_SOON_S = 1.0
"""GNSS that shifts stays there for longer"""
_FAR_M = 50.0
"""GNSS that is usable does not shift as far"""
_SHARE = 1 / 3
"""largest share of all poses that one outlier has"""
_BACK = 100
"""pieces that may be left out at once"""
_ALONG = 2
"""steps on either side of a cut that tell the velocity there"""


@dataclass(frozen=True)
class Outlier:
    """Poses beside the drive, from row ``first`` to row ``last``."""

    first: int
    last: int
    metres: float
    """largest distance of these poses from where the drive would be"""
    degrees: float
    """largest angle from the pose that the drive would have"""
    before: int | None
    """row of the pose of the drive before them; None at the start"""
    after: int | None
    """row of the pose of the drive after them; None at the end"""


def sort_out(times_ns: Times, T_world_rig: Array) -> tuple[tuple[Outlier, ...], tuple[Jump, ...]]:
    """The outliers of a drive, and the jumps whose both sides stay.

    Args:
        times_ns: (N,) strictly increasing, at least two.
        T_world_rig: (N, 4, 4)
    """
    jumps = certain_jumps(times_ns, T_world_rig)
    if not jumps:
        return (), ()
    pieces = _Pieces.cut(times_ns, T_world_rig, jumps)
    outliers = tuple(pieces.outliers())
    beside = {row for one in outliers for row in range(one.first, one.last + 1)}
    # A jump stays where neither of its poses is left out.
    return outliers, tuple(j for j in jumps if j.index not in beside and j.index - 1 not in beside)


def certain_jumps(times_ns: Times, T_world_rig: Array) -> tuple[Jump, ...]:
    """The jumps that no noise explains, and steps faster than anything on the ground, in order."""
    jumps = {jump.index: jump for jump in find_jumps(times_ns, T_world_rig) if jump.excess > CERTAIN}
    seconds = np.diff(times_ns) / 1e9
    lengths = np.linalg.norm(np.diff(T_world_rig[:, :3, 3], axis=0), axis=1)
    fastest = float(np.clip(3.0 * np.median(lengths / seconds), *FASTEST))
    excess = lengths / np.maximum(_NEAR_M, fastest * seconds)
    for k in np.flatnonzero(excess > 1.0).tolist():
        fast = Jump(k + 1, int(times_ns[k + 1]), float(lengths[k]), 0.0, float(CERTAIN * excess[k]))
        jumps.setdefault(k + 1, fast)
    return tuple(sorted(jumps.values(), key=lambda jump: jump.index))


@dataclass(frozen=True, eq=False)
class _Pieces:
    """A drive that is cut at its jumps."""

    times_ns: Times
    T: Array
    """(N, 4, 4)"""
    first: Indices
    """(P,) first row of each piece"""
    last: Indices
    """(P,) last row of each piece"""
    velocity: Array
    """(2, P, 6) twists a second at the beginning and the end of each piece; nan where it has one pose"""
    usual: Array
    """(2,) m/s and rad/s that most steps within pieces stay below"""
    jumps: Array
    """(2, P + 1) metres and excess of the jump before each piece, and after the last; at the ends of the drive infinite
    metres and no excess"""

    @staticmethod
    def cut(times_ns: Times, T: Array, jumps: Sequence[Jump]) -> _Pieces:
        at = [jump.index for jump in jumps]
        first, last = np.array([0, *at]), np.array([*at, len(T)]) - 1
        seconds = np.diff(times_ns) / 1e9
        twists = se3_log(invert(T[:-1]) @ T[1:]) / seconds[:, None]
        velocity = np.full((2, len(first), 6), np.nan)
        for k, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            if b > a:
                ends = twists[a : min(a + _ALONG, b)], twists[max(a, b - _ALONG) : b]
                velocity[:, k] = [np.median(end, axis=0) for end in ends]
        inside = np.delete(sizes_of(twists), np.array(at) - 1, axis=0)
        usual = np.quantile(inside, 0.9, axis=0) if len(inside) else np.zeros(2)
        sizes = np.array([[np.inf, 0.0], *([jump.metres, jump.excess] for jump in jumps), [np.inf, 0.0]]).T
        return _Pieces(times_ns, T, first, last, velocity, usual, sizes)

    def taken(self) -> list[int]:
        """The pieces that are taken on the way of the least cost."""
        count, each = len(self.first), self._costs()
        at_end = np.where(np.isfinite(each), _AT_END * self._poses(), np.inf)
        cost, before = np.array([at_end[:k].sum() for k in range(count)]), np.full(count, -1)
        for k in range(1, count):
            earlier = np.arange(max(0, k - _BACK), k)
            left_out = np.array([each[e + 1 : k].sum() for e in earlier])
            poses = self.first[k] - self.last[earlier] - 1
            fits = (poses <= max(1.0, _SHARE * len(self.T))) & self._fit(earlier, k)
            total = cost[earlier] + np.where(fits, left_out, np.where(poses == 0, _JUMP, np.inf))
            if total.min() < cost[k]:
                before[k], cost[k] = earlier[np.argmin(total)], total.min()
        after = np.array([at_end[k + 1 :].sum() for k in range(count)])
        k, taken = int(np.argmin(cost + after)), []
        while k >= 0:
            taken.append(k)
            k = int(before[k])
        return taken[::-1]

    def _poses(self) -> Indices:
        """(P,) number of poses of each piece."""
        return self.last - self.first + 1

    def _costs(self) -> Array:
        """(P,) cost of leaving out each piece."""
        far = np.minimum(self.jumps[0, :-1], self.jumps[0, 1:]) > _FAR_M
        sure = np.maximum(self.jumps[1, :-1], self.jumps[1, 1:]) >= _SURE
        soon = (self.times_ns[self.last] - self.times_ns[self.first]) / 1e9 <= _SOON_S
        ends = zip(self.first.tolist(), self.last.tolist(), strict=True)
        same = np.array([bool((self.T[a : b + 1] == self.T[a]).all()) for a, b in ends])
        costs = np.where(far | soon | same, np.minimum(self._poses(), _WRONG), self._poses())
        return np.where(sure, costs, np.inf)

    def _fit(self, earlier: Indices, later: int) -> Array:
        """Whether each of some pieces (M,) can be driven on from to a later one."""
        seconds = (self.times_ns[self.first[later]] - self.times_ns[self.last[earlier]]) / 1e9
        step = se3_log(invert(self.T[self.last[earlier]]) @ self.T[self.first[later]])
        ends = np.stack([self.velocity[1, earlier], np.broadcast_to(self.velocity[0, later], step.shape)])
        known = ~np.isnan(ends[:, :, 0])
        count = known.sum(axis=0)
        velocity = np.where(known[:, :, None], ends, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
        limit = CERTAIN * reach(seconds) + np.where(count == 0, 3.0, 0.5)[:, None] * self.usual * seconds[:, None]
        return np.asarray((sizes_of(step - velocity * seconds[:, None]) <= limit).all(axis=1))

    def outliers(self) -> list[Outlier]:
        """What lies between the pieces that are taken, before the first and after the last of them."""
        taken = self.taken()
        out = []
        for left, right in zip([None, *taken], [*taken, None], strict=True):
            first = 0 if left is None else int(self.last[left]) + 1
            last = len(self.T) - 1 if right is None else int(self.first[right]) - 1
            if first <= last:
                out.append(self._measured(first, last, left, right))
        return out

    def _measured(self, first: int, last: int, left: int | None, right: int | None) -> Outlier:
        """How far poses are from where the drive would be: between its poses before and after, or as it goes on."""
        before = None if left is None else int(self.last[left])
        after = None if right is None else int(self.first[right])
        if before is not None and after is not None:
            seconds = (self.times_ns[after] - self.times_ns[before]) / 1e9
            origin, velocity = before, se3_log(invert(self.T[before]) @ self.T[after]) / seconds
        elif after is not None:
            origin, velocity = after, np.nan_to_num(self.velocity[0, right])
        else:
            assert before is not None
            origin, velocity = before, np.nan_to_num(self.velocity[1, left])
        rows = np.arange(first, last + 1)
        would_be = self.T[origin] @ se3_exp(velocity * ((self.times_ns[rows] - self.times_ns[origin]) / 1e9)[:, None])
        apart = invert(would_be) @ self.T[rows]
        metres = float(np.linalg.norm(apart[:, :3, 3], axis=1).max())
        return Outlier(first, last, metres, float(np.degrees(rotation_angle(apart[:, :3, :3]).max())), before, after)
