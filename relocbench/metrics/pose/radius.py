"""The radius of convergence: the start offset at which the share of successes falls below a half.

Shares are known at a few offsets and interpolated linearly. The radius is the first place, going outwards, where the
interpolated share falls below the wanted one; it may rise again further out, but no user can rely on that.

Where fewer than half succeed even from the truth, that radius is 0 and does not compare methods. ``relative`` radii
measure the width of the basin independently of its height: shares are first divided by the share at the smallest
offset. A method that rarely succeeds can still have a wide basin, so the share from the truth and the relative radius
should be read together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.metrics.statistics.significance import LEVEL, RESAMPLES, Interval, resampled_set_means

Array = NDArray[np.float64]

HALF = 0.5


@dataclass(frozen=True)
class Radius:
    """The offset up to which the wanted share of starts succeeds."""

    value: float
    """in the unit of the offsets; 0 where the share is too low even at the smallest offset"""
    beyond: bool
    """whether the share is high enough at every offset: ``value`` is then the largest offset, the radius greater"""
    interval: Interval | None = None
    """from resampled drives, clipped to the largest offset; None when there are too few pairs for one"""


@dataclass(frozen=True)
class Ratio:
    """The ratio of A's radius to B's."""

    value: float
    """inf where only B's radius is 0, NaN where both are"""
    interval: Interval | None


def success_radius(offsets: ArrayLike, shares: ArrayLike, share: float = HALF, *, relative: bool = False) -> Radius:
    """The offset at which the share of successes falls below ``share``.

    Args:
        offsets: (K,) ascending, not negative.
        shares: (K,) share of successes at each offset, 0..1.
        relative: divide shares by the one at the smallest offset; where that is 0, the radius is 0.

    Raises:
        ValueError: the shapes do not fit, offsets do not ascend, or something is not finite.
    """
    x, y = _checked(offsets, np.asarray(shares, dtype=np.float64))
    y = _relative(y) if relative else y
    value = float(_radii(x, y, share))
    return Radius(value, beyond=bool(np.all(y >= share)))


def radius_of(
    pair_sets: Sequence[ArrayLike],
    offsets: ArrayLike,
    rng: np.random.Generator,
    *,
    share: float = HALF,
    relative: bool = False,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
) -> Radius:
    """The radius of the mean over pair sets of the mean over their pairs, with a block-bootstrap interval.

    Args:
        pair_sets: (K, N_s) each: the share of successes at each offset of each pair, ordered by reference time.
        offsets: (K,).

    Raises:
        ValueError: as :func:`success_radius`; no pair sets, or an empty one.
    """
    x, means, drawn = _resampled(pair_sets, offsets, rng, resamples)
    first = success_radius(x, means, share, relative=relative)
    if drawn is None:
        return first
    interval = _percentiles(_radii(x, _relative(drawn.T) if relative else drawn.T, share), level)
    return Radius(first.value, first.beyond, interval)


def radius_ratio(
    pair_sets_a: Sequence[ArrayLike],
    pair_sets_b: Sequence[ArrayLike],
    offsets: ArrayLike,
    rng: np.random.Generator,
    *,
    share: float = HALF,
    relative: bool = False,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
) -> Ratio:
    """The ratio of A's radius to B's on the same pairs in the same order, resampled with the same blocks.

    A radius beyond the largest offset counts as that offset. The arguments are those of :func:`radius_of`.
    """
    both = [np.concatenate([np.asarray(a), np.asarray(b)]) for a, b in zip(pair_sets_a, pair_sets_b, strict=True)]
    k = len(np.asarray(offsets))
    x, means, drawn = _resampled(both, np.tile(np.asarray(offsets, dtype=np.float64), 2), rng, resamples)
    x, _ = _checked(x[:k], means[:k])

    def radii(y: Array) -> Array:
        return _radii(x, _relative(y) if relative else y, share)

    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(radii(means[:k]) / radii(means[k:]))
        if drawn is None:
            return Ratio(value, None)
        ratios = radii(drawn[:k].T) / radii(drawn[k:].T)
    return Ratio(value, None if np.isnan(ratios).any() else _percentiles(ratios, level))


def _resampled(
    pair_sets: Sequence[ArrayLike], offsets: ArrayLike, rng: np.random.Generator, resamples: int
) -> tuple[Array, Array, Array | None]:
    """The offsets (K,), the mean shares (K,), and the mean shares (K, resamples) of resampled drives."""
    x = np.asarray(offsets, dtype=np.float64)
    values = [np.asarray(v, dtype=np.float64) for v in pair_sets]
    for v in values:
        if v.ndim != 2 or len(v) != len(x) or not v.shape[1] or not np.isfinite(v).all():
            raise ValueError(f"expected finite shares ({len(x)}, N >= 1) of each pair set, got {v.shape}")
    drawn = resampled_set_means(values, rng, resamples)
    return x, np.mean([v.mean(axis=1) for v in values], axis=0), drawn


def _checked(offsets: ArrayLike, shares: Array) -> tuple[Array, Array]:
    x = np.asarray(offsets, dtype=np.float64)
    if x.ndim != 1 or len(x) < 2 or shares.shape != x.shape:
        raise ValueError(f"expected one share for each of two or more offsets, got {shares.shape} for {x.shape}")
    if not (np.isfinite(x).all() and np.isfinite(shares).all() and x[0] >= 0 and np.all(np.diff(x) > 0)):
        raise ValueError("offsets must ascend from 0 or more; offsets and shares must be finite")
    return x, shares


def _relative(y: Array) -> Array:
    """Shares (..., K) divided by the first one; 0 where that is 0."""
    first = y[..., :1]
    return np.where(first > 0, y / np.where(first > 0, first, 1.0), 0.0)


def _radii(x: Array, y: Array, share: float) -> Array:
    """The radius of each row of shares (..., K)."""
    low = y < share
    first = np.where(low.any(axis=-1), low.argmax(axis=-1), len(x))
    after = np.clip(first, 1, len(x) - 1)
    y_before = np.take_along_axis(y, (after - 1)[..., None], axis=-1)[..., 0]
    y_after = np.take_along_axis(y, after[..., None], axis=-1)[..., 0]
    fall = np.where(y_before > y_after, y_before - y_after, 1.0)
    between = x[after - 1] + (y_before - share) / fall * (x[after] - x[after - 1])
    return np.where(first == 0, 0.0, np.where(first == len(x), x[-1], between))


def _percentiles(values: Array, level: float) -> Interval:
    tail = 50 * (1 - level)
    # An infinite ratio cannot be interpolated: take percentiles among the drawn values.
    low, high = np.percentile(values, [tail, 100 - tail], method="inverted_cdf")
    return Interval(float(low), float(high), level)
