"""Consensus of registrations, before any graph is solved: runs that agree, and which runs to trust.

Two registrations and the odometry of both drives between them form a cycle. Registrations whose short cycles close form
a run. Wrong registrations are alone, or form runs of their own where a facade repeats itself; at its ends such a run
contradicts its neighbours, however consistent it is in itself. The longest runs that do not contradict each other win
if they are much longer than those that they contradict; otherwise none of these is trusted. After Mangelsen et al.,
Pairwise consistent measurement set maximization (2018), with runs in place of single measurements, of which a drive has
thousands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from relocbench.arrays import Indices, Mask
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, components
from relocbench.geometry import invert, rotation_angle


@dataclass(frozen=True)
class RunOptions:
    """Options that decide which cycles are tested, and by how much they may fail to close."""

    reach_m: float = 12.0
    """largest distance, along both drives, between registrations that are compared; larger where they are sparse"""
    reach_spacings: float = 3.0
    """the same in units of the median distance from one registration to the next; the larger of both holds"""
    closure_m: float = 0.25
    """error of position up to which a cycle closes, however short it is"""
    closure_per_m: float = 0.02
    """growth of that error for each metre of the cycle along one drive"""
    closure_deg: float = 1.0
    """error of rotation up to which a cycle closes"""
    dominance: float = 3.0
    """runs win against one that they contradict if together they are at least so many times as long"""


@dataclass(frozen=True, eq=False)
class Runs:
    """Which of E registrations are in runs that won."""

    won: Mask
    """(E,) whether its run won, so that it may be trusted"""
    doubtful: Mask
    """(E,) whether its run neither won nor lost against those that contradict it"""


def find_runs(edges: Edges, drives: BothDrives, options: RunOptions) -> Runs:
    """Find the runs of E registrations, and which of them win."""
    a, b = _near(edges, drives, options)
    closed = _closes(edges, drives, a, b, options)
    joined = closed & _supported(len(edges), a, b, closed)
    run = _merged(components(len(edges), a[joined], b[joined]), a, b, closed)
    lengths = {int(r): len(np.unique(edges.second[run == r])) for r in np.unique(run)}
    against: dict[int, set[int]] = {r: set() for r in lengths}
    for x, y, _ in _meetings(run, a, b, closed):  # runs that agree for the larger part have been joined
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
    return Runs(np.isin(run, list(won - doubtful)), np.isin(run, list(doubtful)))


def _near(edges: Edges, drives: BothDrives, options: RunOptions) -> tuple[Indices, Indices]:
    """Pairs of registrations that are near each other along both drives, in the same segments of odometry."""
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
    """Whether the cycle of each pair of registrations (a, b) closes."""
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
    """Whether at least half of the registrations near both ends of a cycle agree with both.

    This keeps a cycle that closes by chance from joining a wrong run to a right one.
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
    """Join runs of which at least half of the cycles between them close, until there are none."""
    while True:
        meet = [(x, y) for x, y, share in _meetings(run, a, b, closed) if share >= 0.5]
        if not meet:
            return run
        x, y = np.array(meet, dtype=np.int64).T
        run = components(len(run), x, y)[run]


def _meetings(run: Indices, a: Indices, b: Indices, closed: Mask) -> list[tuple[int, int, float]]:
    """Pairs of runs, in both orders, with the share of the cycles between them that close."""
    apart = run[a] != run[b]
    if not apart.any():
        return []
    ends = np.stack([run[a[apart]], run[b[apart]]], axis=1)
    ends, which = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0, return_inverse=True)
    share = np.bincount(which.ravel(), np.tile(closed[apart], 2)) / np.bincount(which.ravel())
    return [(int(x), int(y), float(s)) for (x, y), s in zip(ends, share, strict=True)]
