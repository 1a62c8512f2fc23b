"""Ranks of methods that hold their error rate over all methods and sets together.

Every two methods are compared on the same pairs. The largest absolute t statistic of all comparisons has, if the
methods are equal, a distribution that follows from the correlations between methods: the single-step max-T test of
Hothorn, Bretz and Westfall ("Simultaneous inference in general parametric models", Biometrical Journal 2008), stepped
down by Romano and Wolf ("Exact and approximate stepdown methods for multiple hypothesis testing", JASA 2005): what is
not rejected is tested again with the smaller critical value of what is left. With probability ``level`` no comparison
of equal methods is significant.

A method's rank is one more than the number of methods that are significantly better: the best rank that it may have
(Mogstad, Romano, Shaikh and Wilhelm, "Inference for ranks", Review of Economic Studies 2024). Nobody stands behind a
method with a lower mean: a rank is never larger than those further down.

The pair sets of one road become one series first (:mod:`relocbench.metrics.statistics.roads`). From
:data:`~relocbench.metrics.statistics.intervals.MANY_ROADS` roads on, a comparison must be significant by the spread of
the roads' differences as well, whose largest t statistic is compared with those under random signs of the roads
(Romano and Wolf, the same): for equal methods a road's differences are as likely the one way as the other.
"""

from __future__ import annotations

import zlib
from collections.abc import Hashable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Mask
from relocbench.metrics.statistics.effective_size import (
    Inflation,
    difference_inflation,
    fill_missing_with_prior,
    measured_inflation,
)
from relocbench.metrics.statistics.intervals import (
    LEVEL,
    MANY_ROADS,
    finite_values,
    mean_of_means,
    pairs_in_equal_sets,
    with_two_pairs,
)
from relocbench.metrics.statistics.roads import aligned, by_road

DRAWS = 10_000
"""random draws for a critical value"""
_DRAWN_AT_ONCE = 2**22


def generator(seed: int, place: str, metric: str) -> np.random.Generator:
    """The random generator for one metric in one table, so that a number does not depend on which others there are."""
    return np.random.default_rng([seed, zlib.crc32(f"{place} {metric}".encode())])


def rank_with_ties(
    values: Mapping[str, Sequence[ArrayLike | None]],
    rng: np.random.Generator,
    errors: Mapping[str, Sequence[ArrayLike | None]] | None = None,
    *,
    higher_is_better: bool = True,
    roads: Sequence[Hashable] | None = None,
    independent: bool = False,
) -> dict[str, int | None]:
    """The ranks of methods: one more than the number of methods that are significantly better (1, 1, 3).

    Args:
        values: for each method one entry for each pair set, in the same order of sets for all methods: (N_s,) per-pair
            values ordered by reference time, or None where the method has no result on the set.
        rng: the source of the draws for critical values.
        errors: (K, N_s) for each method and pair set: continuous errors of the same pairs, which say how correlated
            neighbours are where the difference of two methods is the same on all pairs.
        higher_is_better: the direction of the metric.
        roads: the road of each pair set, such as the name of its dataset; None where all are of one road.
        independent: whether the pairs are known to be independent.

    Returns:
        the rank of each method, in the order of ``values``; None for a method that misses a set.

    Raises:
        ValueError: methods with different pairs, values that are not finite, or roads of other sets.
    """
    complete: dict[str, list[Array]] = {}
    for name, sets in values.items():
        present = [finite_values(v) for v in sets if v is not None]
        if present and len(present) == len(sets):
            complete[name] = present
    ranks: dict[str, int | None] = dict.fromkeys(values)
    if not complete:
        return ranks
    if len({tuple(map(len, sets)) for sets in complete.values()}) > 1:
        raise ValueError("ranked methods must have the same pairs in the same pair sets")
    sign = 1.0 if higher_is_better else -1.0
    order = sorted(complete, key=lambda name: (-sign * mean_of_means(by_road(complete[name], roads)), name))
    stacked = [np.stack(methods) for methods in zip(*(complete[name] for name in order), strict=True)]
    of_methods = None if errors is None else [[e for e in errors[name] if e is not None] for name in order]
    differs = different_methods(stacked, rng, of_methods, roads=roads, independent=independent)
    behind = np.tril(differs, -1).sum(axis=1) + 1
    places = np.minimum.accumulate(behind[::-1])[::-1]
    for name, place in zip(order, places.tolist(), strict=True):
        ranks[name] = place
    return ranks


def different_methods(
    pair_sets: Sequence[Array],
    rng: np.random.Generator,
    errors: Sequence[Sequence[ArrayLike]] | None = None,
    *,
    roads: Sequence[Hashable] | None = None,
    independent: bool = False,
    level: float = LEVEL,
) -> Mask:
    """Which methods differ significantly from which, (M, M), with one error rate over all comparisons.

    Args:
        pair_sets: (M, N_s) the values of M methods on the same pairs of each set, ordered by reference time.
        rng, errors, roads, independent, level: as in :func:`rank_with_ties`; errors by method in the order of the
            values.
    """
    size = len(pair_sets[0])
    series = by_road(pair_sets, roads)
    statistic, freedom = _t_statistics(series, pair_sets, errors, roads, independent)
    rejected = np.zeros((size, size), dtype=bool)
    if size < 2 or not np.isfinite(freedom):
        return rejected
    open_ = np.triu(np.isfinite(statistic), 1)
    between = _BetweenRoads(series, rng) if len(series) >= MANY_ROADS else None
    while open_.any():
        limit = np.quantile(_largest_statistics(series, freedom, rng, open_), level)
        now = open_ & (np.abs(statistic) > limit)
        if between is not None:
            now &= between.significant(open_, level)
        if not now.any():
            break
        rejected |= now
        open_ &= ~now
    return rejected | rejected.T


class _BetweenRoads:
    """Comparisons by the means of many roads, each of which is one draw of a difference that is symmetric around 0."""

    def __init__(self, series: Sequence[Array], rng: np.random.Generator) -> None:
        means = np.stack([x.mean(axis=1) for x in series], axis=1)
        self._pairs = np.triu_indices(len(means), 1)
        self._differences = means[self._pairs[0]] - means[self._pairs[1]]  # (comparisons, roads)
        roads = len(series)
        if 2 ** (roads - 1) <= DRAWS:  # all signs, up to the sign of the first road, which changes no absolute value
            bits = np.arange(2 ** (roads - 1))[:, None] >> np.arange(roads)
            self._signs = 1.0 - 2.0 * (bits & 1)
        else:
            self._signs = rng.choice([-1.0, 1.0], (DRAWS, roads))
            self._signs[0] = 1.0
        self._size = len(means)

    def significant(self, open_: Mask, level: float) -> Mask:
        """(M, M) which open comparisons exceed the largest ones under random signs."""
        chosen = open_[self._pairs]
        differences = self._differences[chosen]
        statistics = np.abs(self._t(differences @ self._signs.T, differences))
        observed = np.abs(self._t(differences.sum(axis=1, keepdims=True), differences))[:, 0]
        limit = np.quantile(statistics.max(axis=0), level, method="higher")
        out = np.zeros((self._size, self._size), dtype=bool)
        first, second = (of[chosen] for of in self._pairs)
        out[first, second] = observed > limit * (1 + 1e-9)
        return out

    @staticmethod
    def _t(sums: Array, differences: Array) -> Array:
        """Student's t of sums of signed differences, whose squares do not depend on the signs; inf without spread."""
        roads = differences.shape[1]
        squares = (differences**2).sum(axis=1, keepdims=True)
        spread = np.maximum(squares - sums**2 / roads, 1e-12 * squares) / (roads - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            out: Array = np.where(squares > 0, sums / np.sqrt(roads * spread), 0.0)
        return out


def _t_statistics(
    series: Sequence[Array],
    pair_sets: Sequence[Array],
    errors: Sequence[Sequence[ArrayLike]] | None,
    roads: Sequence[Hashable] | None,
    independent: bool,
) -> tuple[Array, float]:
    """(M, M) t statistics of the differences, NaN where undefined, and their least degrees of freedom.

    Two pairs with the largest difference either way are added, as in
    :func:`relocbench.metrics.statistics.intervals.paired_difference`.
    """
    pairs = pairs_in_equal_sets([x.shape[1] for x in series])
    methods = len(series[0])
    if independent:
        inflation = Inflation(np.ones((methods, methods)), np.ones((methods, methods)))
    else:
        inflation = _with_constant_differences(
            difference_inflation(aligned(pair_sets, roads)), pair_sets, errors, roads
        )
    means = np.mean([x.mean(axis=1) for x in series], axis=0)
    mean = means[:, None] - means[None, :]
    variance = _differences(_covariance(series)) * pairs
    largest = np.max([_largest_differences(x) for x in series], axis=0)
    size = pairs / inflation.likely
    with np.errstate(invalid="ignore", divide="ignore"):
        known = inflation.enough(pairs) & (largest > 0)
        adjusted, of_mean = with_two_pairs(mean, variance, largest, size)
        statistic = np.where(known, adjusted / np.sqrt(of_mean), np.nan)
    freedom = float(size[known].min() - 1) if known.any() else np.nan
    return statistic, freedom


def _with_constant_differences(
    inflation: Inflation,
    pair_sets: Sequence[Array],
    errors: Sequence[Sequence[ArrayLike]] | None,
    roads: Sequence[Hashable] | None,
) -> Inflation:
    """The inflation of all differences: where one does not vary, that of the two methods."""
    unknown = np.isnan(inflation.likely)
    if not np.triu(unknown, 1).any():
        return inflation
    own = [
        measured_inflation([x[m] for x in pair_sets], None if errors is None else errors[m], roads)
        for m in range(len(unknown))
    ]
    likely, cautious = (np.concatenate([getattr(o, name) for o in own]) for name in ("likely", "cautious"))
    larger = fill_missing_with_prior(Inflation(np.fmax.outer(likely, likely), np.fmax.outer(cautious, cautious)))
    return Inflation(
        np.where(unknown, larger.likely, inflation.likely), np.where(unknown, larger.cautious, inflation.cautious)
    )


def _largest_statistics(series: Sequence[Array], freedom: float, rng: np.random.Generator, open_: Mask) -> Array:
    """(DRAWS,) the largest absolute t statistic among the open comparisons if all methods were equal."""
    covariance = _covariance(series)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    scale = np.sqrt(_differences(covariance))
    first, second = np.nonzero(open_ & (scale > 0))
    out = np.empty(DRAWS)
    step = max(1, _DRAWN_AT_ONCE // max(1, len(first)))
    for start in range(0, DRAWS, step):
        count = min(step, DRAWS - start)
        drawn = rng.standard_normal((count, len(root))) @ root.T
        statistics = np.abs(drawn[:, first] - drawn[:, second]) / scale[first, second]
        if (open_ & (scale == 0)).any():  # a difference without a variance is correlated with no other
            statistics = np.column_stack([statistics, np.abs(rng.standard_normal(count))])
        chi = np.sqrt(rng.chisquare(freedom, count) / freedom)
        out[start : start + count] = statistics.max(axis=1, initial=0.0) / chi
    return out


def _covariance(series: Sequence[Array]) -> Array:
    """(M, M) the covariance of the methods' means if neighbours were independent."""
    centred = [x - x.mean(axis=1, keepdims=True) for x in series]
    out: Array = np.sum([c @ c.T / c.shape[1] ** 2 for c in centred], axis=0) / len(series) ** 2
    return out


def _differences(covariance: Array) -> Array:
    """The variance of the difference of every two, from their covariance. (M, M) -> (M, M)."""
    own = np.diag(covariance)
    return np.maximum(own[:, None] + own[None, :] - covariance - covariance.T, 0.0)


def _largest_differences(values: Array) -> Array:
    """The largest absolute difference of every two methods on any pair. (M, N) -> (M, M)."""
    return np.stack([np.abs(values - row).max(axis=1) for row in values])
