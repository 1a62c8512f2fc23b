"""Whether method A is better than method B, or a stretch of road decided: block bootstrap over the pairs of a drive.

Neighbouring pairs see the same street and are not independent, so that blocks of consecutive pairs are resampled:
the circular block bootstrap (Politis and Romano, "A circular block-resampling procedure for stationary data",
1992). The drive is closed to a circle, so that every pair is equally likely to be drawn; the moving blocks of Kuensch
(1989) draw both ends of the drive too seldom. Intervals are percentile intervals (Efron 1979).

Measured on simulated drives of 0/1 recalls (autoregressive, nominal coverage 95 %), intervals cover the true value
in 94 % of cases for 2000 pairs with a correlation of 0.8 from one to the next, in 92 % with 0.9, and in 88 % for 600
pairs with 0.9, where the drive holds some thirty independent stretches; resampling single pairs covers 36 to 58 %.

Pairs must be ordered by reference time. All methods are resampled with the same blocks, so that the difference of two
methods is paired. Several pair sets are resampled separately and averaged, each set with equal weight.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.metrics.statistics.block_length import automatic_block_length

Array = NDArray[np.float64]

LEVEL = 0.95
RESAMPLES = 1000
MIN_BLOCKS = 6
"""With fewer independent blocks nothing is significant at 5 %: that all b of them favour A happens by chance
with probability 2 * 2^-b, which is 0.06 for b = 5 and 0.03 for b = 6."""

_DRAWN_AT_ONCE = 2**15
"""block starts that are held in memory at a time; the number does not change which starts are drawn"""


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
    """None when there are too few pairs for one"""

    @property
    def significant(self) -> bool:
        """Whether the interval excludes 0."""
        return self.interval is not None and self.interval.excludes(0.0)


def generator(seed: int, place: str, metric: str) -> np.random.Generator:
    """The random generator for one metric in one table, so that a number does not depend on which others there are."""
    return np.random.default_rng([seed, zlib.crc32(f"{place} {metric}".encode())])


def bootstrap_interval(
    pair_sets: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    block_length: int | None = None,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
) -> Interval | None:
    """The percentile interval of a metric that is a mean of per-pair values.

    Args:
        pair_sets: one (N_s,) array for each pair set, the metric's ``per_pair`` values ordered by reference time.
            The metric is the mean over the sets of the mean over a set's pairs.
        rng: the source of randomness.
        block_length: pairs in a block; None chooses it from the values (:func:`common_block_length`).
        resamples: number of resampled drives.
        level: nominal coverage of the interval.

    Returns:
        None when all pair sets together hold fewer than :data:`MIN_BLOCKS` blocks.

    Raises:
        ValueError: no pair sets, an empty one, values not finite, or impossible parameters.
    """
    sets = [_checked(values)[None] for values in pair_sets]
    means = _bootstrap_means(sets, rng, block_length, resamples)
    return None if means is None else _percentile_interval(means[0], level)


def paired_difference(
    pair_sets_a: Sequence[ArrayLike],
    pair_sets_b: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    block_length: int | None = None,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
) -> Difference:
    """The mean of A minus the mean of B on the same pairs, with its percentile interval.

    ``pair_sets_a`` and ``pair_sets_b`` hold the same pairs in the same order; the other arguments are those of
    :func:`bootstrap_interval`.

    Raises:
        ValueError: the pairs differ, and as :func:`bootstrap_interval`.
    """
    a, b = [_checked(v) for v in pair_sets_a], [_checked(v) for v in pair_sets_b]
    if [len(v) for v in a] != [len(v) for v in b]:
        raise ValueError("a paired difference needs both methods on the same pairs")
    difference = [x - y for x, y in zip(a, b, strict=True)]
    interval = bootstrap_interval(difference, rng, block_length=block_length, resamples=resamples, level=level)
    return Difference(_mean_of_means(difference), interval)


def rank_with_ties(
    values: Mapping[str, Sequence[ArrayLike | None]],
    rng: np.random.Generator,
    *,
    higher_is_better: bool = True,
    block_length: int | None = None,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
) -> dict[str, int | None]:
    """The ranks of methods; methods that do not differ significantly from the best of their group share a rank.

    Methods are taken from the best mean to the worst. A method joins the current group unless its paired difference
    to the group's best is significant; then it opens the next group, whose rank is one more than the number of
    methods before it (1, 1, 3).

    Args:
        values: for each method one entry for each pair set, in the same order of sets for all methods: (N_s,) per-pair
            values ordered by reference time, or None where the method has no result on the set.
        rng, block_length, resamples, level: as in :func:`bootstrap_interval`.

    Returns:
        the rank of each method, in the order of ``values``; None for a method that misses a set.

    Raises:
        ValueError: methods with different pairs, and as :func:`bootstrap_interval`.
    """
    complete: dict[str, list[Array]] = {}
    for name, sets in values.items():
        present = [_checked(v) for v in sets if v is not None]
        if present and len(present) == len(sets):
            complete[name] = present
    ranks: dict[str, int | None] = dict.fromkeys(values)
    if not complete:
        return ranks
    if len({tuple(map(len, sets)) for sets in complete.values()}) > 1:
        raise ValueError("ranked methods must have the same pairs in the same pair sets")

    sign = 1.0 if higher_is_better else -1.0
    order = sorted(complete, key=lambda name: (-sign * _mean_of_means(complete[name]), name))
    stacked = [np.stack(methods) for methods in zip(*(complete[name] for name in order), strict=True)]
    means = _bootstrap_means(stacked, rng, block_length, resamples)
    best, rank = 0, 1
    for place, name in enumerate(order):
        if means is not None and _percentile_interval(means[best] - means[place], level).excludes(0.0):
            best, rank = place, place + 1
        ranks[name] = rank
    return ranks


def resampled_set_means(
    pair_sets: Sequence[Array], rng: np.random.Generator, resamples: int = RESAMPLES
) -> Array | None:
    """The means of several per-pair values over resampled drives, with the same blocks for all of them.

    Args:
        pair_sets: (K, N_s) each, ordered by reference time: K values of each pair.

    Returns:
        (K, resamples): for each value, the mean over the sets of the mean over a set's resampled pairs; None when all
        sets together hold fewer than :data:`MIN_BLOCKS` blocks.
    """
    return _bootstrap_means(pair_sets, rng, None, resamples)


def common_block_length(values: ArrayLike) -> int:
    """One block length for all methods (methods, N) on a pair set: the longest that any of them needs.

    It is the longest automatic choice among the methods' values and their differences from the first method's values,
    but short enough for the set to hold :data:`MIN_BLOCKS` blocks.
    """
    v = np.asarray(values, dtype=np.float64)
    series = [*v, *(v[1:] - v[0])]
    wanted = max(automatic_block_length(x) for x in series)
    return int(max(1, min(wanted, v.shape[1] // MIN_BLOCKS)))


def _bootstrap_means(
    pair_sets: Sequence[Array], rng: np.random.Generator, block_length: int | None, resamples: int
) -> Array | None:
    """Bootstrap means (methods, resamples) of values (methods, N_s) of each pair set; None where blocks are too few."""
    if not pair_sets:
        raise ValueError("a bootstrap needs at least one pair set")
    if resamples < 1 or (block_length is not None and block_length < 1):
        raise ValueError(f"resamples and block_length must be positive, got {resamples} and {block_length}")
    lengths = [common_block_length(v) if block_length is None else block_length for v in pair_sets]
    blocks = sum(v.shape[1] // length for v, length in zip(pair_sets, lengths, strict=True))
    if blocks < MIN_BLOCKS:
        return None
    sets = zip(pair_sets, lengths, strict=True)
    out: Array | None = np.mean([_resampled_means(v, min(b, v.shape[1]), rng, resamples) for v, b in sets], axis=0)
    return out


def _resampled_means(values: Array, block_length: int, rng: np.random.Generator, resamples: int) -> Array:
    """Means over circular blocks, (methods, N) -> (methods, resamples), with the same blocks for every method.

    A resample of N pairs consists of ``N // L`` whole blocks and, where L does not divide N, the beginning of one
    more. The sum over the block at each of the N starts is computed once, so that a resample costs N / L additions.
    """
    n = values.shape[1]
    whole, rest = divmod(n, block_length)
    drawn = whole + (rest > 0)
    sums = _circular_window_sums(values, block_length)
    ends = _circular_window_sums(values, rest) if rest else None
    total = np.empty((len(values), resamples))
    # Resamples are drawn in batches: all of them at once would take 8 bytes for every pair of every resample.
    step = max(1, _DRAWN_AT_ONCE // drawn)
    for first in range(0, resamples, step):
        span = slice(first, min(first + step, resamples))
        starts = rng.integers(n, size=(span.stop - first, drawn))
        for k, of_method in enumerate(sums):
            total[k, span] = of_method.take(starts[:, :whole]).sum(axis=-1)
            if ends is not None:
                total[k, span] += ends[k].take(starts[:, whole])
    out: Array = total / n
    return out


def _circular_window_sums(values: Array, length: int) -> Array:
    """The sum of the ``length`` values from each start on, around the circle. (methods, N) -> (methods, N)."""
    closed = np.concatenate([values, values[:, : length - 1]], axis=1)
    out: Array = np.lib.stride_tricks.sliding_window_view(closed, length, axis=1).sum(axis=-1)
    return out


def _percentile_interval(means: Array, level: float) -> Interval:
    if not 0 < level < 1:
        raise ValueError(f"the level of an interval must be between 0 and 1, got {level}")
    low, high = np.quantile(means, [(1 - level) / 2, (1 + level) / 2])
    return Interval(float(low), float(high), level)


def _mean_of_means(pair_sets: Sequence[Array]) -> float:
    return math.fsum(float(np.mean(v)) for v in pair_sets) / len(pair_sets)


def _checked(values: ArrayLike) -> Array:
    v = np.asarray(values, dtype=np.float64)
    if v.ndim != 1 or v.size == 0 or not np.isfinite(v).all():
        raise ValueError("per-pair values must be a non-empty (N,) array of finite numbers")
    return v
