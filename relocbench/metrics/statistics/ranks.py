"""Ranks of methods that hold their error rate over all methods and sets together.

Going down from the method with the highest mean, each is compared with those above it on the same pairs, and nothing
below it matters: methods that fail everywhere change nobody's rank. Its table holds it and those above, and every two
of a table are compared with one error rate: the largest absolute statistic of all these comparisons has, if the methods
are equal, a distribution that follows from the correlations between methods, the max-T test of Hothorn, Bretz and
Westfall ("Simultaneous inference in general parametric models", Biometrical Journal 2008), stepped down by Romano and
Wolf ("Exact and approximate stepdown methods for multiple hypothesis testing", JASA 2005): what is significant does not
count in the critical value of what is left. That a longer stretch of a table has a larger critical value is the idea of
Newman and Keuls (Keuls, "The use of the studentized range in connection with an analysis of variance", Euphytica 1952).

A method's rank is one more than the number of methods above that are significantly better (Mogstad, Romano, Shaikh and
Wilhelm, "Inference for ranks", Review of Economic Studies 2024), and never smaller than that of a method above it.

Near-copies are represented by one of them (:mod:`relocbench.metrics.statistics.families`): methods are compared with
representatives alone, so that copies count for one comparison, and for one method that is better. A copy's rank is
never larger than that of a method below it.

The pair sets of one road become one series first (:mod:`relocbench.metrics.statistics.roads`). From
:data:`~relocbench.metrics.statistics.intervals.MANY_ROADS` roads on, a comparison must be significant by the spread of
the roads' differences as well: for equal methods a road's differences are as likely the one way as the other. Of each
comparison it is counted how many random signs of the roads give as large a difference, and the smallest such share of a
table is compared with those under the same random signs (Westfall and Young, "Resampling-based multiple testing",
1993). The shares, unlike t statistics, have one distribution whatever the differences look like; those of methods that
differ by one pair on each road would otherwise exceed all others by chance.
"""

from __future__ import annotations

import zlib
from collections.abc import Hashable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices, Mask
from relocbench.metrics.statistics.effective_size import (
    Inflation,
    difference_inflation,
    fill_missing_with_prior,
    measured_inflation,
    normal_scores,
)
from relocbench.metrics.statistics.families import families_of, same_answers
from relocbench.metrics.statistics.intervals import (
    LEVEL,
    MANY_ROADS,
    finite_values,
    mean_of_means,
    pairs_in_equal_sets,
    with_two_pairs,
)
from relocbench.metrics.statistics.roads import aligned, by_road, sign_patterns

DRAWS = 10_000
"""random draws for a critical value"""
_EQUAL = 1e-12
"""means that differ by no more are equal"""


def generator(seed: int, place: str, metric: str) -> np.random.Generator:
    """The random generator for one metric in one table, so that a number does not depend on which others there are."""
    return np.random.default_rng([seed, zlib.crc32(f"{place} {metric}".encode())])


def rank_with_ties(
    values: Mapping[str, Sequence[ArrayLike | None]],
    rng: np.random.Generator,
    errors: Mapping[str, Sequence[ArrayLike | None]] | None = None,
    *,
    families: Mapping[str, str] | None = None,
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
        families: the representative of each method (:func:`relocbench.metrics.families_of`), where one that is not
            named represents itself; None to find near-copies by the errors, those that come first representing others.
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
    means = {name: sign * mean_of_means(by_road(of, roads)) for name, of in complete.items()}
    order = sorted(complete, key=lambda name: (-means[name], name))
    stacked = [sign * np.stack(methods) for methods in zip(*(complete[name] for name in order), strict=True)]
    of_methods = None if errors is None else [[e for e in errors[name] if e is not None] for name in order]
    if families is None:
        oriented = {name: [sign * of for of in sets] for name, sets in complete.items()}
        families = families_of(oriented, lambda a, b: errors is not None and same_answers(errors[a], errors[b]))
    represents = np.array([families.get(name, name) == name for name in order])
    tables = _tables(stacked, roads, represents)
    behind = _behind(stacked, tables, represents, rng, of_methods, roads=roads, independent=independent)
    places = behind.sum(axis=1) + 1
    for index in range(len(order)):  # best first, so that those above are final
        places[index] = max(places[index], places[tables[index]].max())
    in_order = np.array([means[name] for name in order])
    for index in np.flatnonzero(~represents)[::-1]:  # nor does a copy stand behind what has a lower mean
        below = in_order < in_order[index] - _EQUAL
        places[index] = min(places[index], places[below].min(initial=places[index]))
    for index, name in enumerate(order):
        ranks[name] = int(places[index])
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
    """Which methods differ significantly from which, (M, M), each compared among those with a mean that is as high.

    Args:
        pair_sets: (M, N_s) the values of M methods on the same pairs of each set, ordered by reference time.
        rng, errors, roads, independent, level: as in :func:`rank_with_ties`; errors by method in the order of the
            values.
    """
    means = np.mean([x.mean(axis=1) for x in by_road(pair_sets, roads)], axis=0)
    order = np.argsort(-means, kind="stable")
    in_order = [x[order] for x in pair_sets]
    of_methods = None if errors is None else [errors[m] for m in order]
    all_ = np.ones(len(order), dtype=bool)
    tables = _tables(in_order, roads, all_)
    behind = _behind(in_order, tables, all_, rng, of_methods, roads=roads, independent=independent, level=level)
    out = np.zeros_like(behind)
    out[np.ix_(order, order)] = behind | behind.T
    return out


def _tables(pair_sets: Sequence[Array], roads: Sequence[Hashable] | None, represents: Mask) -> Mask:
    """(M, M) by method, among which it is compared: the representatives with a higher mean, and itself."""
    means = np.mean([x.mean(axis=1) for x in by_road(pair_sets, roads)], axis=0)
    above: Mask = (means[None, :] > means[:, None] + _EQUAL) & represents[None, :]
    return above | np.eye(len(means), dtype=bool)


def _behind(
    pair_sets: Sequence[Array],
    tables: Mask,
    represents: Mask,
    rng: np.random.Generator,
    errors: Sequence[Sequence[ArrayLike]] | None,
    *,
    roads: Sequence[Hashable] | None,
    independent: bool,
    level: float = LEVEL,
) -> Mask:
    """(M, M) which methods are significantly better than a method, [method, better], among those of its table.

    Args:
        pair_sets: (M, N_s) with the highest mean first.
        tables: of :func:`_tables`.
    """
    size, represented = len(tables), np.flatnonzero(represents)
    series = by_road(pair_sets, roads)
    statistic = _statistics(series, tables, pair_sets, errors, roads, independent)
    seed = int(rng.integers(2**32))
    tests: list[_ByPairs | _ByRoads] = [_ByPairs(series, statistic, represented, np.random.default_rng([seed, 0]))]
    if len(series) >= MANY_ROADS:
        tests.append(_ByRoads(series, np.random.default_rng([seed, 1])))
    behind = np.zeros((size, size), dtype=bool)
    largest: list[Array | float] = [-np.inf] * len(tests)  # among the representatives above, of what is not significant
    joining: list[tuple[int, list[Array]]] = []  # the same of representatives that are not yet above
    for method in range(size):
        for _, of_tests in (each for each in joining if tables[method, each[0]]):
            largest = [np.maximum(*both) for both in zip(largest, of_tests, strict=True)]
        joining = [each for each in joining if not tables[method, each[0]]]
        testable = represents & np.isfinite(statistic[method])
        others = np.flatnonzero(testable & tables[method])
        drawn = [test.drawn(method, others) for test in tests]
        open_ = np.ones(len(others), dtype=bool)
        while open_.any():
            now = open_.copy()
            for above, (observed, null) in zip(largest, drawn, strict=True):
                limit = np.quantile(np.maximum(null[open_].max(axis=0), above), level, method="higher")
                now &= observed > limit * (1 + 1e-9)
            if not now.any():
                break
            open_ &= ~now
        behind[method, others[~open_]] = True
        if represents[method]:
            equal = np.array([other for other, _ in joining if testable[other]], dtype=int)
            of_equal = [test.drawn(method, equal) for test in tests]
            both = [np.concatenate([a[1][open_], b[1]]) for a, b in zip(drawn, of_equal, strict=True)]
            joining.append((method, [null.max(axis=0, initial=-np.inf) for null in both]))
    return behind


class _ByPairs:
    """Comparisons by the spread of pairs: a statistic of each, which is normal if the methods are equal."""

    def __init__(
        self, series: Sequence[Array], statistic: Array, represented: Indices, rng: np.random.Generator
    ) -> None:
        self._statistic, self._rng = statistic, rng
        self._covariance = _covariance(series)
        self._scale = np.sqrt(_differences(self._covariance))
        self._represented = represented
        self._roots = np.zeros((len(statistic), len(represented) + 1))
        self._normal = [rng.standard_normal(DRAWS)]
        self._means = [self._draw(method) for method in range(len(statistic))]

    def drawn(self, method: int, others: Indices) -> tuple[Array, Array]:
        """(K,) the statistics of a method against others, and (K, DRAWS) what they are if all methods are equal."""
        scale = self._scale[method, others]
        null = np.abs(np.stack([self._means[m] for m in others]) - self._means[method]) if len(others) else _none(DRAWS)
        with np.errstate(invalid="ignore", divide="ignore"):
            null = np.where(scale[:, None] > 0, null / scale[:, None], np.abs(self._normal[0]))
        return np.abs(self._statistic[method, others]), null

    def _draw(self, method: int) -> Array:
        """(DRAWS,) a method's mean, given those of the representatives before it: it depends on no other method."""
        before = self._represented[self._represented < method]
        root = self._roots[method]
        for place, other in enumerate(before):
            own = self._roots[other, place]
            if own**2 > 1e-10 * self._covariance[other, other]:
                shared = root[:place] @ self._roots[other, :place]
                root[place] = (self._covariance[method, other] - shared) / own
        root[len(before)] = np.sqrt(max(self._covariance[method, method] - float(root @ root), 0.0))
        while len(self._normal) <= len(before) + 1:
            self._normal.append(self._rng.standard_normal(DRAWS))
        out: Array = root[: len(before) + 1] @ np.stack(self._normal[1 : len(before) + 2])
        return out


class _ByRoads:
    """Comparisons by the means of many roads, each of which is one draw of a difference that is symmetric around 0."""

    def __init__(self, series: Sequence[Array], rng: np.random.Generator) -> None:
        self._means = np.stack([x.mean(axis=1) for x in series], axis=1)
        self._signs = sign_patterns(len(series), rng)

    def drawn(self, method: int, others: Indices) -> tuple[Array, Array]:
        """(K,) how rare the differences are, and (K, signs) how rare they are under random signs, both from 0 to 1."""
        differences = self._means[others] - self._means[method]
        size = np.sqrt(np.sum(differences**2, axis=1, keepdims=True))
        sums = np.abs(differences @ self._signs.T) / np.where(size > 0, size, 1.0)
        sums = np.round(sums, 9)
        rarer = np.empty_like(sums)
        for of_one, row in zip(rarer, sums, strict=True):
            of_one[:] = np.searchsorted(np.sort(row), row) / len(row)
        rarer += sums * 1e-6  # among equally rare ones, the larger counts
        return rarer[:, 0], rarer


def _none(draws: int) -> Array:
    return np.empty((0, draws))


def _statistics(
    series: Sequence[Array],
    tables: Mask,
    pair_sets: Sequence[Array],
    errors: Sequence[Sequence[ArrayLike]] | None,
    roads: Sequence[Hashable] | None,
    independent: bool,
) -> Array:
    """(M, M) the differences of every two methods as normal statistics in the table of the first, NaN where undefined.

    Student's t, with two pairs added that have the largest difference either way as in
    :func:`relocbench.metrics.statistics.intervals.paired_difference`, is turned into the normal value of the same tail.
    """
    from scipy.special import ndtri, stdtr

    pairs = pairs_in_equal_sets([x.shape[1] for x in series])
    methods = len(series[0])
    if independent:
        inflation = Inflation(np.ones((methods, methods)), np.ones((methods, methods)))
    else:
        inflation = _with_constant_differences(
            difference_inflation(aligned(pair_sets, roads), tables), pair_sets, errors, roads
        )
    means = np.mean([x.mean(axis=1) for x in series], axis=0)
    mean = means[:, None] - means[None, :]
    variance = _differences(_covariance(series)) * pairs
    largest = np.max([_largest_differences(x) for x in series], axis=0)
    size = pairs / inflation.likely
    with np.errstate(invalid="ignore", divide="ignore"):
        known = inflation.enough(pairs) & (largest > 0)
        adjusted, of_mean = with_two_pairs(mean, variance, largest, size)
        if errors is not None and not independent:
            of_mean = np.fmax(of_mean, _variance_by_errors(pair_sets, tables, errors, roads))
        tail = stdtr(np.where(known, size - 1, np.nan), -np.abs(adjusted / np.sqrt(of_mean)))
        out: Array = np.sign(mean) * -ndtri(np.maximum(tail, 1e-300))
    return out


def _variance_by_errors(
    pair_sets: Sequence[Array], tables: Mask, errors: Sequence[Sequence[ArrayLike]], roads: Sequence[Hashable] | None
) -> Array:
    """(M, M) the variance of the differences of means that follows from errors, if two methods are equal.

    Equal methods need not err on equally long stretches. One that a drive suits by chance has fewer failures there,
    hence a smaller variance than it has elsewhere, and one that is right throughout has none. Its errors vary all the
    same. With the normal scores S of errors, a difference of equal methods is given the variance of ``S_i - S_j``,
    times the variance of a value of both methods together.
    """
    own = np.mean([x.var(axis=1) for x in pair_sets], axis=0)
    means = np.mean([x.mean(axis=1) for x in by_road(pair_sets, roads)], axis=0)
    of_both: Array = (own[:, None] + own[None, :]) / 2 + (means[:, None] - means[None, :]) ** 2 / 4
    of_sets = [
        np.stack([np.atleast_2d(np.asarray(e, float)) for e in of_methods]) for of_methods in zip(*errors, strict=True)
    ]
    out: Array = np.zeros_like(of_both)
    for kind in range(of_sets[0].shape[1]):
        scores = [normal_scores(of[:, kind]) for of in of_sets]
        likely = difference_inflation(aligned(scores, roads), tables).likely
        out = np.fmax(out, of_both * _differences(_covariance(by_road(scores, roads))) * likely)
    return out


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
