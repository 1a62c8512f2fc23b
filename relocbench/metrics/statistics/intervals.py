"""Confidence intervals of shares, areas, medians and paired differences over the correlated pairs of drives.

A percentile interval of a bootstrap over blocks is too narrow where a drive is worth few independent pairs, and has no
width at all where every pair succeeds. These intervals are those for independent pairs with the effective number of
pairs (:mod:`relocbench.metrics.statistics.effective_size`) in the place of their number:

- shares and areas: Clopper and Pearson's, with the effective size of Korn and Graubard ("Confidence intervals for
  proportions with small expected number of positive counts estimated from survey data", Survey Methodology 1998);
  Brown, Cai and DasGupta ("Interval estimation for a binomial proportion", Statistical Science 2001) say why none by
  the normal law serves near 0 and 1.
- medians: the order statistics at the bounds of a share of one half.
- differences: Student's t, with Bonett and Price's two added pairs ("Adjusted Wald confidence interval for a difference
  of binomial proportions based on paired data", J. Educ. Behav. Stat. 2012). This is symmetric, but the number of rare
  pairs on which methods differ is skewed: more of them may have been missed than seen too many. So where few pairs
  differ, the end away from zero is at least as far as the intervals of two shares demand, of the pairs that A wins and
  of those that it loses: the distances of their bounds are squared and added (Newcombe, "Improved confidence intervals
  for the difference between binomial proportions based on paired data", Statistics in Medicine 1998; Zou and Donner,
  "Construction of confidence limits about effect measures: a general approach", the same journal 2008). How many draws
  these shares have is also limited by how long the runs of differing pairs are (:func:`inflation_of_runs`).

Pairs must be ordered by reference time. What is estimated is the mean over roads of the mean over a road's pair sets of
the mean over a set's pairs. The sets of one road become one series first (:mod:`relocbench.metrics.statistics.roads`),
since they are not independent; roads are. From :data:`MANY_ROADS` roads on, the interval is at least as wide as
Student's t over the roads, and the spread of the roads bounds the effective number of draws of a share as well, with
the degrees of freedom of the roads (Korn and Graubard, the same).

``benchmarks/truth/intervals.py`` measures their coverage.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array
from relocbench.metrics.statistics.effective_size import inflation_of, inflation_of_runs
from relocbench.metrics.statistics.roads import by_road

AnyNumber = TypeVar("AnyNumber", float, Array)
LEVEL = 0.95
MANY_ROADS = 8
"""number of roads from which on their spread widens an interval: with fewer, t has heavy tails"""
_FEW = 0.5
"""share of stretches that differ, at most, for which it counts how few they are: where all differ, as
in areas, Student's t covers"""
_UNSEEN = 0.5
"""number of pairs of value 0, and of value 1, that are added to the variance of an area: the pairs seen may hold none
of the few that fail"""


@dataclass(frozen=True)
class Interval:
    """A two-sided confidence interval."""

    low: float
    high: float
    level: float

    def excludes(self, value: float) -> bool:
        """Whether ``value`` lies outside the interval."""
        return value < self.low or value > self.high


@dataclass(frozen=True)
class Difference:
    """By how much A exceeds B, in the metric's unit."""

    mean: float
    interval: Interval | None
    """for this difference alone; None when there are too few effective pairs for one"""
    p: float | None = field(default=None, compare=False)
    """one minus the largest level at which the interval would exclude 0; None without an interval"""
    by_road: Mapping[Hashable, float] = field(default_factory=dict, compare=False)
    """the difference on each road"""
    adjusted_p: float | None = field(default=None, compare=False)
    """the p value over all differences of a page (:func:`relocbench.metrics.statistics.multiplicity.controlled`)"""

    @property
    def significant(self) -> bool:
        """Whether the interval excludes 0, and the adjusted p value is small where there is one."""
        if self.interval is None or not self.interval.excludes(0.0):
            return False
        return self.adjusted_p is None or self.adjusted_p <= 1 - self.interval.level


def mean_interval(
    pair_sets: Sequence[ArrayLike],
    errors: Sequence[ArrayLike] | None = None,
    *,
    roads: Sequence[Hashable] | None = None,
    independent: bool = False,
    level: float = LEVEL,
) -> Interval | None:
    """The interval of a share or area: of the mean over the roads of the mean over a road's sets.

    Args:
        pair_sets: (N_s,) values of each pair set, ordered by reference time, whose means are in 0..1; single values of
            :func:`relocbench.metrics.per_group` may exceed 1.
        errors: (K, N_s) of each set: the continuous errors that the values come from (:func:`inflation_of`).
        roads: the road of each set, such as the name of its dataset; None where all sets are of one road.
        independent: whether the values of a set are known to be independent, such as one for each place.
        level: nominal coverage of the interval.

    Returns:
        None where there are fewer than :data:`MIN_EFFECTIVE` effective pairs.

    Raises:
        ValueError: no pair sets, an empty one, a mean outside 0..1, errors or roads of other sets, or an impossible
            level.
    """
    sets = [finite_values(values) for values in pair_sets]
    if any(not -1e-9 <= v.mean() <= 1 + 1e-9 for v in sets):
        raise ValueError("the mean of shares and areas must be in 0..1")
    size = _effective_size(sets, errors, roads, independent, level)
    if size is None:
        return None
    sets = by_road(sets, roads)
    p = _share(sets)
    low, high = _clopper_pearson(p, _draws(sets, size, level), level)
    between = _between_roads(sets, level)
    return Interval(max(0.0, min(low, p - between)), min(1.0, max(high, p + between)), level)


def share_interval(successes: int, draws: int, *, level: float = LEVEL) -> Interval:
    """Clopper and Pearson's interval of a share seen in independent draws.

    Raises:
        ValueError: no draws, or more successes than draws.
    """
    if not 0 <= successes <= draws or draws == 0:
        raise ValueError(f"a share needs draws, and no more successes than these, got {successes} of {draws}")
    return Interval(*_clopper_pearson(successes / draws, draws, level), level)


def median_interval(values: ArrayLike, *, independent: bool = False) -> Interval | None:
    """The interval of the median of a value of each pair of one set; infinite values are allowed.

    Args:
        values: (N,) ordered by reference time, inf where there is no answer.
        independent: whether the values are known to be independent.

    Returns:
        None where there are fewer than :data:`MIN_EFFECTIVE` effective pairs; ``high`` may be inf.

    Raises:
        ValueError: no values, or NaN among them.
    """
    v = np.asarray(values, dtype=np.float64)
    if v.ndim != 1 or v.size == 0 or np.isnan(v).any():
        raise ValueError("a median needs a non-empty (N,) array without NaN")
    below = (v <= np.median(v)).astype(np.float64)
    size = _effective_size([below], [v[None]], None, independent, LEVEL)
    if size is None:
        return None
    low, high = _clopper_pearson(0.5, size, LEVEL)
    ordered = np.sort(v)
    first = max(math.floor(low * v.size) - 1, 0)
    last = min(math.ceil(high * v.size), v.size - 1)
    return Interval(float(ordered[first]), float(ordered[last]), LEVEL)


def paired_difference(
    pair_sets_a: Sequence[ArrayLike],
    pair_sets_b: Sequence[ArrayLike],
    *,
    roads: Sequence[Hashable] | None = None,
    independent: bool = False,
) -> Difference:
    """The mean of A minus the mean of B on the same pairs, with its interval.

    Two pairs with the largest difference either way are added, so that an interval has a width where no pair differs.

    Args:
        pair_sets_a, pair_sets_b: (N_s,) values in 0..1 of each pair set, the same pairs in the same order.
        roads: the road of each set; None where all sets are of one road.
        independent: whether the pairs are known to be independent.

    Raises:
        ValueError: the pairs differ; no pair sets, an empty one, values not finite, or roads of other sets.
    """
    a, b = [finite_values(v) for v in pair_sets_a], [finite_values(v) for v in pair_sets_b]
    if [len(v) for v in a] != [len(v) for v in b]:
        raise ValueError("a paired difference needs both methods on the same pairs")
    difference = [x - y for x, y in zip(a, b, strict=True)]
    size = _effective_size(difference, [np.stack(both) for both in zip(a, b, strict=True)], roads, independent, LEVEL)
    won, lost = (by_road([np.maximum(sign * d, 0.0) for d in difference], roads) for sign in (1.0, -1.0))
    difference = by_road(difference, roads)
    mean = mean_of_means(difference)
    if size is None:
        return Difference(mean, None)
    low, high, p = _by_students_t(difference, size)
    if mean and _few_differ(difference):
        if not independent:
            runs = inflation_of_runs([np.abs(d) > np.abs(d).mean() for d in difference])
            size = min(size, pairs_in_equal_sets([len(d) for d in difference]) / runs)
        if mean > 0:
            high = max(high, mean + _beyond(won, lost, size))
        else:
            low = min(low, mean - _beyond(lost, won, size))
    names = [None] if roads is None else list(dict.fromkeys(roads))
    by_name = dict(zip(names, (float(x.mean()) for x in difference), strict=True))
    return Difference(mean, Interval(max(low, -1.0), min(high, 1.0), LEVEL), p, by_name)


def _by_students_t(difference: Sequence[Array], size: float) -> tuple[float, float, float]:
    """The bounds of the mean of roads' series by t over their stretches with two added pairs, and over the roads.

    Returns:
        the lower and the upper bound, and the p value of no difference.
    """
    from scipy.special import stdtrit

    mean = mean_of_means(difference)
    largest = max(float(np.abs(d).max()) for d in difference) or 1.0
    adjusted, variance = with_two_pairs(mean, _variance_of_one(difference), largest, size)
    half = float(stdtrit(size - 1, (1 + LEVEL) / 2)) * math.sqrt(variance)
    between = _between_roads(difference, LEVEL)
    p = max(
        two_sided_p(adjusted, math.sqrt(variance), size - 1),
        two_sided_p(mean, _error_between(difference), len(difference) - 1),
    )
    return min(adjusted - half, mean - between), max(adjusted + half, mean + between), p


def two_sided_p(mean: float, standard_error: float, freedom: float) -> float:
    """The p value of a mean of zero by Student's t; 0 where there is a mean without an error."""
    from scipy.special import stdtr

    if standard_error == 0:
        return 0.0 if mean else 1.0
    return 2 * float(stdtr(freedom, -abs(mean) / standard_error))


def _few_differ(series: Sequence[Array]) -> bool:
    """Whether few of the stretches make the difference, as where methods are both right on most pairs.

    It is the share of them that differ if these differ by the same, and needs none that is exactly 0: series of sets of
    unequal length have none.
    """
    v = np.concatenate(series)
    return bool(np.abs(v).mean() ** 2 <= _FEW * np.mean(v**2))


def _beyond(won: Sequence[Array], lost: Sequence[Array], size: float) -> float:
    """By how much the share that one method wins minus the share that it loses may exceed the one that was seen."""
    draws = _draws([x + y for x, y in zip(won, lost, strict=True)], size, LEVEL)
    wins, losses = _share(won), _share(lost)
    most = _clopper_pearson(wins, max(draws, _draws(won, size, LEVEL)), LEVEL)[1]
    least = _clopper_pearson(losses, max(draws, _draws(lost, size, LEVEL)), LEVEL)[0]
    return math.hypot(most - wins, losses - least)


def with_two_pairs(
    mean: AnyNumber, variance: AnyNumber, largest: AnyNumber, size: AnyNumber
) -> tuple[AnyNumber, AnyNumber]:
    """The mean of ``size`` effective differences with ``+largest`` and ``-largest`` added, and that mean's variance."""
    adjusted = mean * size / (size + 2)
    spread = (size * (variance * size / (size - 1) + mean**2) + 2 * largest**2) / (size + 2) - adjusted**2
    return adjusted, spread / (size + 2)


def linear_interval(pair_sets: Sequence[Array], *, level: float = LEVEL) -> tuple[Array, Array] | None:
    """The bounds of the means of K values of each pair, (K,) and (K,), by Student's t with one inflation for all.

    Args:
        pair_sets: (K, N_s) finite values of each pair set of one road, ordered by reference time.

    Returns:
        None where there are fewer than :data:`MIN_EFFECTIVE` effective pairs.
    """
    size = _effective_size([v[0] for v in pair_sets], pair_sets, None, False, level)
    if size is None:
        return None
    from scipy.special import stdtrit

    (series,) = by_road(pair_sets)
    mean = series.mean(axis=1)
    variance = series.var(axis=1) / (size - 1)
    half = float(stdtrit(size - 1, (1 + level) / 2)) * np.sqrt(variance)
    return mean - half, mean + half


def mean_of_means(pair_sets: Sequence[Array]) -> float:
    """The mean over the series of the mean of a series."""
    return math.fsum(float(np.mean(v)) for v in pair_sets) / len(pair_sets)


def pairs_in_equal_sets(lengths: Sequence[int]) -> float:
    """``S^2 / sum(1 / N_s)``: how many pairs one set would need for a mean as certain as that of the sets' means."""
    return len(lengths) ** 2 / math.fsum(1 / n for n in lengths)


def _effective_size(
    sets: Sequence[Array],
    errors: Sequence[ArrayLike] | None,
    roads: Sequence[Hashable] | None,
    independent: bool,
    level: float,
) -> float | None:
    """The number of effective stretches of the roads; None where they are too few."""
    if not sets:
        raise ValueError("an interval needs at least one pair set")
    if not 0 < level < 1:
        raise ValueError(f"the level of an interval must be between 0 and 1, got {level}")
    lengths = [len(v) for v in sets]
    if errors is not None and [np.shape(e)[-1] for e in errors] != lengths:
        raise ValueError("errors must be those of the same pairs in the same pair sets")
    pairs = pairs_in_equal_sets([len(v) for v in by_road(sets, roads)])
    inflation = inflation_of(sets, errors, roads, independent=independent)
    return pairs / float(inflation.likely[0]) if bool(inflation.enough(pairs)[0]) else None


def _share(series: Sequence[Array]) -> float:
    """The mean of roads' series, which rounding leaves in 0..1."""
    return min(max(mean_of_means(series), 0.0), 1.0)


def _draws(series: Sequence[Array], size: float, level: float) -> float:
    """How many independent draws of 0 or 1 have a mean as uncertain as that of roads' series.

    With p the mean and v its variance they are ``p (1 - p) / v``; and as many as there are effective stretches
    (``size``) where these hardly vary.
    """
    from scipy.special import ndtri, stdtrit

    def draws(variance: float, freedom: float) -> float:
        tails = float(ndtri((1 + level) / 2)) / float(stdtrit(freedom, (1 + level) / 2))
        return p * (1 - p) / variance * tails**2

    p, roads = _share(series), len(series)
    along = _variance_of_one(series) / (size - 1) + _UNSEEN * (p**2 + (1 - p) ** 2) / size**2
    of_stretches = max(draws(along, size - 1), size)
    between = _error_between(series) ** 2
    return min(of_stretches, draws(between, roads - 1)) if between > 0 and 0 < p < 1 else of_stretches


def _variance_of_one(sets: Sequence[Array]) -> float:
    """The variance of one pair's value around its set's mean, such that the mean's variance is this over the size."""
    weights = np.array([1 / len(v) for v in sets])
    return float(np.sum(weights * [v.var() for v in sets]) / weights.sum())


def _between_roads(roads: Sequence[Array], level: float) -> float:
    """Half the width of Student's t interval over the means of the roads' series; 0 where the roads are few."""
    from scipy.special import stdtrit

    error = _error_between(roads)
    return float(stdtrit(len(roads) - 1, (1 + level) / 2)) * error if error else 0.0


def _error_between(roads: Sequence[Array]) -> float:
    """The standard error of the mean of the roads' means by their spread; 0 where the roads are few."""
    if len(roads) < MANY_ROADS:
        return 0.0
    return float(np.std([v.mean() for v in roads], ddof=1)) / math.sqrt(len(roads))


def _clopper_pearson(share: float, draws: float, level: float) -> tuple[float, float]:
    """The bounds of a share seen in a number of independent draws, which need not be whole."""
    from scipy.special import betaincinv

    tail, right = (1 - level) / 2, share * draws
    wrong = draws - right
    low = float(betaincinv(right, wrong + 1, tail)) if right > 1e-9 else 0.0
    high = float(betaincinv(right + 1, wrong, 1 - tail)) if wrong > 1e-9 else 1.0
    return low, high


def finite_values(values: ArrayLike) -> Array:
    """Values of pairs as (N,) float64. Raises ValueError where there are none, or one is not finite."""
    v = np.asarray(values, dtype=np.float64)
    if v.ndim != 1 or v.size == 0 or not np.isfinite(v).all():
        raise ValueError("per-pair values must be a non-empty (N,) array of finite numbers")
    return v
