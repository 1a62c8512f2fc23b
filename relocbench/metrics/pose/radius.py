"""The radius of convergence: the start offset at which the share of successes falls below a half.

Shares are known at a few offsets and interpolated linearly. The radius is the first place, going outwards, where the
interpolated share falls below the wanted one; it may rise again further out, but no user can rely on that.

Where fewer than half succeed even from the truth, that radius is 0 and does not compare methods. ``relative`` radii
measure the width of the basin independently of its height: shares are first divided by the share at the smallest
offset. A method that rarely succeeds can still have a wide basin, so the share from the truth and the relative radius
should be read together.

The interval of a radius goes from the radius of the curve of lower bounds to that of the curve of upper bounds of the
shares' distances from the wanted share. The interval of a ratio is that of the logarithm's first-order expansion in
the shares, pair by pair; where a radius is 0 or beyond the largest offset, it follows from the intervals of both radii
at a higher level (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array
from relocbench.metrics.statistics.intervals import LEVEL, Interval, linear_interval

HALF = 0.5
"""the wanted share of successes"""


@dataclass(frozen=True)
class Radius:
    """The offset up to which the wanted share of starts succeeds."""

    value: float
    """in the unit of the offsets; 0 where the share is too low even at the smallest offset"""
    beyond: bool
    """whether the share is high enough at every offset: ``value`` is then the largest offset, the radius greater"""
    interval: Interval | None = None
    """clipped to the largest offset; None when there are too few effective pairs for one"""


@dataclass(frozen=True)
class Ratio:
    """The ratio of A's radius to B's."""

    value: float
    """inf where only B's radius is 0, NaN where both are"""
    interval: Interval | None


def success_radius(offsets: ArrayLike, shares: ArrayLike, *, relative: bool = False) -> Radius:
    """The offset at which the share of successes falls below a half.

    Args:
        offsets: (K,) ascending, not negative.
        shares: (K,) share of successes at each offset, 0..1.
        relative: divide shares by the one at the smallest offset; where that is 0, the radius is 0.

    Raises:
        ValueError: the shapes do not fit, offsets do not ascend, or something is not finite.
    """
    x, y = _checked(offsets, np.asarray(shares, dtype=np.float64))
    y = _relative(y) if relative else y
    value = float(_radii(x, y, HALF))
    return Radius(value, beyond=bool(np.all(y >= HALF)))


def radius_of(
    pair_sets: Sequence[ArrayLike],
    offsets: ArrayLike,
    *,
    relative: bool = False,
    level: float = LEVEL,
) -> Radius:
    """The radius of the mean over pair sets of the mean over their pairs, with its interval.

    Args:
        pair_sets: (K, N_s) each: the share of successes at each offset of each pair, ordered by reference time.
        offsets: (K,).

    Raises:
        ValueError: as :func:`success_radius`; no pair sets, or an empty one.
    """
    x, sets = _fitting(pair_sets, offsets)
    means = _means(sets)
    first = success_radius(x, means, relative=relative)
    if relative and means[0] == 0:
        return first
    bounds = linear_interval([v - (HALF * v[0] if relative else HALF) for v in sets], level=level)
    if bounds is None:
        return first
    low, high = (float(_radii(x, bound, 0.0)) for bound in bounds)
    return Radius(first.value, first.beyond, Interval(min(low, first.value), max(high, first.value), level))


def radius_ratio(
    pair_sets_a: Sequence[ArrayLike],
    pair_sets_b: Sequence[ArrayLike],
    offsets: ArrayLike,
    *,
    relative: bool = False,
) -> Ratio:
    """The ratio of A's radius to B's on the same pairs in the same order.

    A radius beyond the largest offset counts as that offset. The arguments are those of :func:`radius_of`.
    """
    x, a = _fitting(pair_sets_a, offsets)
    _, b = _fitting(pair_sets_b, offsets)
    of_a, of_b = (success_radius(x, _means(sets), relative=relative) for sets in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(np.float64(of_a.value) / of_b.value)
    inside = all(r.value > 0 and not r.beyond for r in (of_a, of_b))
    interval = _expanded(x, a, b, relative) if inside else None
    if not inside and not np.isnan(value):
        first, second = (radius_of(s, x, relative=relative, level=(1 + LEVEL) / 2) for s in (a, b))
        interval = _quotient(first.interval, second.interval)
    return Ratio(value, interval)


def _expanded(x: Array, a: Sequence[Array], b: Sequence[Array], relative: bool) -> Interval | None:
    """The interval of a ratio of radii from the first-order expansion of its logarithm in the mean shares."""

    def logarithm(y: Array) -> Array:
        out: Array = np.log(np.maximum(_radii(x, _relative(y) if relative else y, HALF), 1e-12))
        return out

    k, step = len(x), 1e-6
    means = np.concatenate([_means(a), _means(b)])
    slopes = []
    for half, sign in ((slice(0, k), 1.0), (slice(k, None), -1.0)):
        moved = np.eye(k) * step
        slopes.append(sign * (logarithm(means[half] + moved) - logarithm(means[half] - moved)) / (2 * step))
    values = [np.concatenate([(slopes[0] @ v + slopes[1] @ w)[None], v, w]) for v, w in zip(a, b, strict=True)]
    bounds = linear_interval(values)
    if bounds is None:
        return None
    value = logarithm(means[:k]) - logarithm(means[k:])
    half_width = (bounds[1][0] - bounds[0][0]) / 2
    return Interval(float(np.exp(value - half_width)), float(np.exp(value + half_width)), LEVEL)


def _quotient(a: Interval | None, b: Interval | None) -> Interval | None:
    """The interval of the quotient of two values from their intervals; None where a bound is not defined."""
    if a is None or b is None or b.high == 0:
        return None
    return Interval(a.low / b.high, a.high / b.low if b.low > 0 else np.inf, LEVEL)


def _fitting(pair_sets: Sequence[ArrayLike], offsets: ArrayLike) -> tuple[Array, list[Array]]:
    """The offsets (K,) and the shares (K, N_s) of each pair set, checked."""
    x = np.asarray(offsets, dtype=np.float64)
    sets = [np.asarray(v, dtype=np.float64) for v in pair_sets]
    for v in sets:
        if v.ndim != 2 or len(v) != len(x) or not v.shape[1] or not np.isfinite(v).all():
            raise ValueError(f"expected finite shares ({len(x)}, N >= 1) of each pair set, got {v.shape}")
    return x, sets


def _means(sets: Sequence[Array]) -> Array:
    out: Array = np.mean([v.mean(axis=1) for v in sets], axis=0)
    return out


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
