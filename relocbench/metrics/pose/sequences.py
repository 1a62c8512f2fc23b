"""Right and wrong along a drive: stretches on which a method is lost, and short runs of queries.

The queries of a pair set are taken in the order of their times. A query that is asked against several keyframes counts
as right where at least half of these pairs are.

A *lost stretch* is a run of consecutive wrong queries, as long as possible. Its seconds and metres go from its first
query to the next right one, or to the last query of the drive where none follows: until then nobody could know better.

A *run* of n consecutive queries is right where more than half of them are: for odd n, where the median of their joint
errors is within the thresholds. A tracker that is asked again and again may be wrong once if the run is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices, Mask


@dataclass(frozen=True, eq=False)
class Drive:
    """The queries of one pair set, in the order of their times."""

    right: Mask
    """(Q,)"""
    seconds: Array
    """(Q,) since the first query"""
    metres: Array
    """(Q,) travelled since some start of the drive; NaN where that is not known"""

    @classmethod
    def of(cls, right: Mask, query_ns: Indices, travelled_m: Array) -> Drive:
        """Put the pairs of one set in order.

        Args:
            right: (N,) of each pair.
            query_ns: (N,) the times of the pairs' queries.
            travelled_m: (N,) metres that the drive had travelled by then, NaN where not known.
        """
        times, first, query = np.unique(query_ns, return_index=True, return_inverse=True)
        share = np.bincount(query, right) / np.bincount(query)
        return cls(share >= 0.5, (times - times[0]) / 1e9, travelled_m[first])


@dataclass(frozen=True, eq=False)
class LostStretches:
    """The lost stretches of some drives."""

    queries: Indices
    """(S,) wrong queries of each"""
    seconds: Array
    """(S,)"""
    metres: Array
    """(S,) NaN where not known"""

    @classmethod
    def of(cls, drives: Sequence[Drive]) -> LostStretches:
        """Find the stretches of each drive."""
        parts = []
        for drive in drives:
            change = np.diff(np.concatenate([[False], ~drive.right, [False]]).astype(np.int8))
            begin, after = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
            found = np.minimum(after, len(drive.right) - 1)
            spans = (along[found] - along[begin] for along in (drive.seconds, drive.metres))
            parts.append((after - begin, *spans))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def share_of_stretches(self, least: int) -> float | None:
        """The share of the stretches that have at least so many queries; None where there is no stretch."""
        return float(np.mean(self.queries >= least)) if len(self.queries) else None

    def queries_in(self, least: int) -> int:
        """The number of queries on stretches of at least so many."""
        return int(self.queries[self.queries >= least].sum())


def right_runs(drives: Sequence[Drive], length: int) -> Mask:
    """Whether each run of ``length`` consecutive queries is right; none where a drive has fewer queries.

    Runs overlap: a drive of Q queries has ``Q - length + 1``, and none goes from one drive into the next.
    """
    kernel = np.ones(length)
    counts = [np.convolve(drive.right, kernel, "valid") for drive in drives if len(drive.right) >= length]
    out: Mask = 2 * np.concatenate([np.zeros(0), *counts]) > length
    return out
