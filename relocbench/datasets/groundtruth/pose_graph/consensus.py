"""Which registrations agree with each other, before any graph is solved: runs, and which runs can be right together.

Two registrations and the odometry of both drives between them form a cycle. Registrations whose short cycles close form
a run. Wrong ones stand alone, or form runs of their own where a facade repeats itself; at its ends such a run
contradicts its neighbours, however well it agrees with itself. The longest runs that do not contradict each other win,
if by far; else nobody can tell, and none of them is believed. After Mangelsen et al., Pairwise consistent measurement
set maximization (2018), with runs in place of single measurements: one drive has thousands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, components
from relocbench.errors import ConfigError
from relocbench.geometry import invert, rotation_angle

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class RunOptions:
    """Which cycles are looked at, and what they may miss."""

    reach_m: float = 12.0
    """at most, along both drives, between registrations that are compared; more where they are sparse"""
    reach_spacings: float = 3.0
    """as many times the usual way from one registration to the next, if that is more"""
    closure_m: float = 0.25
    """by which a cycle may fail to close however short it is"""
    closure_per_m: float = 0.02
    """by which more, for each metre of its way along one drive"""
    closure_deg: float = 1.0
    """in angle"""
    dominance: float = 3.0
    """runs win against one that contradicts them if together they are at least so many times as long"""

    def __post_init__(self) -> None:
        if min(self.reach_m, self.reach_spacings, self.closure_m, self.closure_deg) <= 0 or self.dominance < 1:
            raise ConfigError("runs of registrations need positive limits and a dominance of at least 1")


@dataclass(frozen=True, eq=False)
class Runs:
    """E registrations and what became of their runs."""

    run: Indices
    """(E,) number of its run"""
    won: Mask
    """(E,) whether it may be believed"""
    doubtful: Mask
    """(E,) whether neither it nor what contradicts it prevails"""


def find_runs(edges: Edges, drives: BothDrives, options: RunOptions) -> Runs:
    """Find runs and let them win or lose.

    Args:
        edges: E registrations.
    """
    a, b = _near(edges, drives, options)
    closed = _closes(edges, drives, a, b, options)
    joined = closed & _supported(len(edges), a, b, closed)
    run = _merged(components(len(edges), a[joined], b[joined]), a, b, closed)
    lengths = {int(r): len(np.unique(edges.second[run == r])) for r in np.unique(run)}
    against: dict[int, set[int]] = {r: set() for r in lengths}
    for x, y, _ in _meetings(run, a, b, closed):  # what agreed for the larger part has been joined
        against[x].add(y)
    won: set[int] = set()
    for r in sorted(lengths, key=lambda r: (-lengths[r], r)):
        if not against[r] & won:
            won.add(r)
    doubtful: set[int] = set()
    for r in lengths.keys() - won:
        opponents = against[r] & won
        if sum(lengths[o] for o in opponents) < options.dominance * lengths[r]:
            doubtful |= opponents | {r}
    return Runs(run, np.isin(run, list(won - doubtful)), np.isin(run, list(doubtful)))


def _near(edges: Edges, drives: BothDrives, options: RunOptions) -> tuple[Indices, Indices]:
    """Pairs of registrations that lie near each other along both drives, on the same pieces of odometry."""
    way_first, way_second = drives.travelled_m[edges.first], drives.travelled_m[edges.second]
    spacing = np.diff(np.unique(way_second))
    reach = max(options.reach_m, options.reach_spacings * float(np.median(spacing)) if len(spacing) else 0.0)
    order = np.argsort(way_second, kind="stable")
    ends = np.searchsorted(way_second[order], way_second[order] + reach, side="right")
    counts = ends - np.arange(len(order)) - 1
    left = np.repeat(np.arange(len(order)), counts)
    right = left + 1 + np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    a, b = order[left], order[right]
    kept = np.abs(way_first[a] - way_first[b]) <= reach
    for nodes in (edges.first, edges.second):
        kept &= drives.segment[nodes[a]] == drives.segment[nodes[b]]
    return a[kept], b[kept]


def _closes(edges: Edges, drives: BothDrives, a: Indices, b: Indices, options: RunOptions) -> Mask:
    """Whether what one registration says of the other's nodes is what the other says itself."""
    T = drives.T_odom_node
    T_first = invert(T[edges.first[b]]) @ T[edges.first[a]]
    T_second = invert(T[edges.second[a]]) @ T[edges.second[b]]
    offset = invert(edges.T_first_second[b]) @ T_first @ edges.T_first_second[a] @ T_second
    arc_length = np.maximum(
        drives.arc_length(edges.first[a], edges.first[b]), drives.arc_length(edges.second[a], edges.second[b])
    )
    closes = np.linalg.norm(offset[:, :3, 3], axis=1) <= options.closure_m + options.closure_per_m * arc_length
    return np.asarray(closes & (np.degrees(rotation_angle(offset[:, :3, :3])) <= options.closure_deg))


def _supported(count: int, a: Indices, b: Indices, closed: Mask) -> Mask:
    """Whether at least half of those near both registrations of a cycle agree with both.

    One cycle that closes by chance must not join a wrong run to a right one.
    """
    from scipy.sparse import coo_array

    def pairs(which: Mask) -> Any:
        half = coo_array((np.ones(which.sum()), (a[which], b[which])), shape=(count, count)).tocsr()
        return half + half.T

    if not len(a):
        return np.zeros(0, dtype=bool)
    near, agreeing = pairs(np.ones(len(a), dtype=bool)), pairs(closed)
    common = (near @ near).multiply(near).tocsr()
    support = (agreeing @ agreeing).multiply(near).tocsr()
    return np.asarray(support[a, b]).reshape(-1) >= 0.5 * np.asarray(common[a, b]).reshape(-1)


def _merged(run: Indices, a: Indices, b: Indices, closed: Mask) -> Indices:
    """Runs joined to those with which they agree for the larger part, until none is left."""
    while True:
        meet = [(x, y) for x, y, share in _meetings(run, a, b, closed) if share >= 0.5]
        if not meet:
            return run
        x, y = np.array(meet, dtype=np.int64).T
        run = components(len(run), x, y)[run]


def _meetings(run: Indices, a: Indices, b: Indices, closed: Mask) -> list[tuple[int, int, float]]:
    """Two runs, in both orders, and the share of the cycles between them that close."""
    apart = run[a] != run[b]
    if not apart.any():
        return []
    ends = np.stack([run[a[apart]], run[b[apart]]], axis=1)
    ends, which = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0, return_inverse=True)
    share = np.bincount(which.ravel(), np.tile(closed[apart], 2)) / np.bincount(which.ravel())
    return [(int(x), int(y), float(s)) for (x, y), s in zip(ends, share, strict=True)]
