"""Differences that a page lists side by side, with one error rate over the whole list.

If every difference were tested at 5 % for itself, one in twenty between equal methods would look significant. What is
adjusted here is the p value of each, so that with a probability of 95 % no difference of equal methods is significant
anywhere on the list:

- From :data:`~relocbench.metrics.statistics.intervals.MANY_ROADS` roads on, by the signs of the roads. If two methods
  are equal, a road's difference is as likely the one way as the other, whatever its distribution. The p value of a
  difference is the share of all patterns of signs, the same for all differences, under which it would be as large; the
  smallest p value of the list is compared with those under the same patterns, and what is left is tested again without
  what is significant (the step-down minP of Westfall and Young, "Resampling-Based Multiple Testing", 1993). No p value
  is smaller than that of the interval, so that one of at most 5 % always has an interval without zero.
- With fewer roads, whose signs say too little, by the p values that belong to the intervals, multiplied by the number
  of differences that are left (Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal
  of Statistics 1979).

``benchmarks/truth/differences.py`` measures the error rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from relocbench.arrays import Array
from relocbench.metrics.statistics.intervals import MANY_ROADS, Difference
from relocbench.metrics.statistics.roads import sign_patterns


def controlled(differences: Sequence[Difference], *, seed: int = 0) -> list[Difference]:
    """The differences of one page with the p value of each adjusted for all of them.

    Args:
        differences: all that the page lists; those without an interval stay as they are, and do not count.
        seed: of the patterns of signs, where there are too many to go through all.
    """
    known = [index for index, each in enumerate(differences) if each.p is not None]
    listed = [differences[index] for index in known]
    out = list(differences)
    if not listed:
        return out
    many = all(len(each.by_road) >= MANY_ROADS for each in listed)
    adjusted = _by_signs(listed, seed) if many else _holm(np.array([each.p for each in listed], dtype=np.float64))
    for index, difference, p in zip(known, listed, adjusted.tolist(), strict=True):
        out[index] = replace(difference, adjusted_p=max(p, difference.p or 0.0))
    return out


def _by_signs(differences: Sequence[Difference], seed: int) -> Array:
    """(K,) the adjusted p values of K differences by the signs of their roads."""
    roads = list(dict.fromkeys(road for difference in differences for road in difference.by_road))
    # A road that a difference does not have counts for nothing in it.
    of_roads = np.array([[difference.by_road.get(road, 0.0) for road in roads] for difference in differences])
    patterns = sign_patterns(len(roads), np.random.default_rng(seed))
    p: Array = np.stack([_shares_at_least(np.abs(row)) for row in of_roads @ patterns.T])
    order = np.argsort(p[:, 0], kind="stable")
    smallest: Array = np.minimum.accumulate(p[order[::-1]], axis=0)[::-1]  # of each difference and those that follow it
    out = np.empty(len(differences))
    out[order] = np.maximum.accumulate((smallest <= smallest[:, :1] + 1e-12).mean(axis=1))
    return out


def _shares_at_least(statistics: Array) -> Array:
    """(S,) the share of S statistics that are at least as large as each; equal but for rounding is as large."""
    ordered = np.sort(statistics)
    slack = 1e-9 * float(ordered[-1])
    out: Array = 1.0 - np.searchsorted(ordered, statistics - slack) / len(statistics)
    return out


def _holm(p: Array) -> Array:
    order = np.argsort(p, kind="stable")
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return out
