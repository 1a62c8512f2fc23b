"""How far the order of trained systems follows another one's, and what keeps their differences from being significant.

Systems are trained with S seeds each and asked at the same P places. The agreement of two orders is Kendall's tau
("A new measure of rank correlation", Biometrika 1938): of all pairs of systems, the share in the same order minus the
share in the opposite one. Its p value is that of permutations, where all orders are equally likely. Its interval comes
from drawing places and seeds anew, with replacement and for all systems together (the bootstrap of two crossed factors;
Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 2007).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from relocbench.arrays import Array
from relocbench.metrics import LEVEL, Difference, controlled, crossed_difference

_DRAWS = 2000


class Agreement(NamedTuple):
    """Kendall's tau of two orders, from -1 (reversed) to 1 (the same)."""

    systems: int
    tau: float
    p: float
    """two-sided"""
    low: float
    high: float
    """ends of the interval over places and seeds"""


class Pair(NamedTuple):
    """Two systems, of which the other order has ``first`` in front."""

    first: str
    second: str
    apart: float
    """by how much in the other order, in its units"""
    difference: Difference
    """of the first from the second"""


class Pairs(NamedTuple):
    """All pairs of systems that differ in the other order."""

    same: list[Pair]
    """significantly different here, in the same order"""
    opposite: list[Pair]
    """significantly different here, in the opposite order"""
    open: list[Pair]
    """without a significant difference here"""


class Scatter(NamedTuple):
    """Standard errors of a difference, in the units of the values."""

    places: float
    """of other places, with the same trainings"""
    seeds: float
    """of other trainings, at the same places"""
    one_training: float
    """standard deviation of the difference of single trainings"""


def agreement(values: Mapping[str, Array], other: Mapping[str, float]) -> Agreement | None:
    """Kendall's tau of the systems' means and ``other``, and its interval.

    Args:
        values: (S, P) by system.
        other: a number for each of some of the systems.

    Returns:
        None for fewer than three systems that both have.
    """
    from scipy.stats import kendalltau

    names = [name for name in values if name in other]
    if len(names) < 3:
        return None
    ours, theirs = np.stack([values[name] for name in names]), [other[name] for name in names]
    tau, p = kendalltau(ours.mean(axis=(1, 2)), theirs)
    rng = np.random.default_rng(0)
    _, seeds, places = ours.shape
    drawn = []
    for _ in range(_DRAWS):
        of_seeds = ours[:, rng.integers(seeds, size=seeds)].mean(axis=1)
        drawn.append(kendalltau(of_seeds[:, rng.integers(places, size=places)].mean(axis=1), theirs).statistic)
    low, high = np.nanquantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Agreement(len(names), float(tau), float(p), float(low), float(high))


def pairs(values: Mapping[str, Array], other: Mapping[str, float]) -> Pairs:
    """Each pair of systems that differ in ``other``, by whether they differ here, with one error rate for all pairs.

    Arguments are those of :func:`agreement`.
    """
    listed = []
    for a, b in combinations([name for name in values if name in other], 2):
        if other[a] == other[b]:
            continue
        first, second = (a, b) if other[a] > other[b] else (b, a)
        listed.append((first, second, other[first] - other[second]))
    differences = controlled([crossed_difference(values[first], values[second]) for first, second, _ in listed])
    out = Pairs([], [], [])
    for names, difference in zip(listed, differences, strict=True):
        kind = out.open if not difference.significant else out.same if difference.mean > 0 else out.opposite
        kind.append(Pair(*names, difference))
    return out


def scatter(values: Array, first: Array) -> Scatter:
    """The standard errors of the mean difference of (S, P) values from those of another system."""
    difference = values - first
    seeds, places = difference.shape
    of_places = float(difference.mean(axis=0).std(ddof=1)) / math.sqrt(places)
    one = float(difference.mean(axis=1).std(ddof=1))
    return Scatter(of_places, one / math.sqrt(seeds), one)
