"""How many independent pairs the pairs of a drive are worth.

Neighbouring pairs see the same street. The variance of a mean over N of them is V times what it would be if they were
independent, so that they are worth ``N / V`` independent ones. V is the variance inflation: the sum of the
autocorrelations over all lags, 1 for independent pairs and ``(1 + rho) / (1 - rho)`` for a first-order autoregression.

V is estimated to be rather too large than too small:

- From the drive as it is: ``(1 + rho) / (1 - rho)`` for the upper bound of a one-sided 90 % interval of the lag-one
  autocorrelation rho, whose small-sample bias is corrected (Marriott and Pope, "Bias in the estimation of
  autocorrelations", Biometrika 1954; Kendall, the same issue).
- Where a road has several sets: the same for what they have in common and for what is their own, each with its share of
  the variance. The covariance of different sets is that of what they have in common. So slow changes are found that
  are common while noise is not, or the other way round.
- From the means of blocks of b = 2, 4, 8, ... neighbouring pairs: b times their variance over the variance of single
  pairs, times ``(1 + rho) / (1 - rho)`` of the block means (Flyvbjerg and Petersen, "Error estimates on averages of
  correlated data", J. Chem. Phys. 1989). It finds slow changes that noise from pair to pair hides.

The largest counts. The series of several roads (:mod:`relocbench.metrics.statistics.roads`) are estimated together,
each around its own mean.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Mask
from relocbench.metrics.statistics.roads import aligned

MIN_EFFECTIVE = 10.0
"""effective sample size below which there is no interval"""
PRIOR_CORRELATION = 0.95
"""correlation of neighbouring pairs where nothing varies, so that none can be measured"""

_LIKELY, _CAUTIOUS = 1.28, 3.0
"""quantiles of the normal distribution at 90 % and 99.9 %"""
_BOUND_OF_RUNS = 0.95
"""level of the one-sided interval of the mean length of runs"""
_MIN_BLOCKS = 16
"""blocks of an average set, at least, in which a correlation of block means is looked for"""
_DOUBT = 2.0
"""by how many times ``1 / sqrt(blocks)`` the variance of block means is taken to be smaller than measured, since the
largest of several estimates counts: a standard error is ``sqrt(2 / blocks)``"""
_LARGEST_CORRELATION = 0.9995
_CERTAIN = 3.0
"""standard errors that the covariance of different sets must exceed for them to have something in common"""
_PRIOR_INFLATION = (1 + PRIOR_CORRELATION) / (1 - PRIOR_CORRELATION)

Product = Callable[[Array, Array], Array]
"""of two (K, N) arrays, a sum over N"""


@dataclass(frozen=True, eq=False)
class Inflation:
    """The variance inflation of each of several series."""

    likely: Array
    """at least 1; what intervals and tests use"""
    cautious: Array
    """at least ``likely``, from the 99.9 % bound of the lag-one autocorrelation: what decides whether there is one"""

    def enough(self, pairs: float) -> Mask:
        """Whether so many pairs are worth :data:`MIN_EFFECTIVE` independent ones by the cautious estimate."""
        out: Mask = pairs / self.cautious >= MIN_EFFECTIVE
        return out


def series_inflation(roads: Sequence[Array]) -> Inflation:
    """The variance inflation of each of K series, which are averages over the sets of each road.

    Args:
        roads: (S, K, N) the values of S sets each, finite, by stretches in the order of the drive
            (:func:`relocbench.metrics.statistics.roads.aligned`). A series that does not vary is NaN in the result.
    """
    return _inflation(roads, lambda a, b: np.einsum("kn,kn->k", a, b))


def difference_inflation(roads: Sequence[Array], tables: Mask) -> Inflation:
    """The variance inflation of the differences of every two of M series, as (M, M) arrays.

    Entry [x, y] is that of series x and y in the table of x: it is at least the one of all differences within that
    table together, which are better known than a single one.

    Args:
        roads: (S, M, N) each, as in :func:`series_inflation`. Two series that differ by a constant are NaN.
        tables: (M, M) by series x, those among which it is compared, with itself.
    """
    within = tables.astype(np.float64)

    def product(a: Array, b: Array) -> Array:
        cross = a @ b.T
        own = np.diag(cross)
        return own[:, None] + own[None, :] - cross - cross.T

    def together(a: Array, b: Array) -> Array:
        of_pairs = np.nan_to_num(product(a, b) / variance)
        out: Array = np.sum((within @ of_pairs) * within, axis=1)
        return out

    each = _inflation(roads, product, likely_at=0.0)
    variance = np.sum([product(x, x) for x in (_centred(of.mean(axis=0)) for of in roads)], axis=0)
    variance[np.isnan(each.likely)] = np.nan
    if np.isnan(variance).all():
        return each
    pooled = _inflation(roads, together)
    likely, cautious = (
        np.where(np.isnan(own), np.nan, np.fmax(own, of_table[:, None]))
        for own, of_table in ((each.likely, pooled.likely), (each.cautious, pooled.cautious))
    )
    return Inflation(likely, cautious)


def inflation_of(
    values: Sequence[Array],
    errors: Sequence[ArrayLike] | None = None,
    roads: Sequence[Hashable] | None = None,
    *,
    independent: bool = False,
) -> Inflation:
    """One variance inflation of the mean of a value of each pair, whose pairs are the stretches of roads.

    It is the larger one of the values and of the normal scores of the continuous errors that the values come from. By
    Gebelein's inequality no function of two normal variables is more correlated than they are, so that errors bound
    the inflation of every share and area, also where all pairs succeed and the values themselves say nothing. That
    holds for the averages of a road's sets as well, whose normal scores are taken set by set: a function that weakens
    the correlation of neighbours weakens that between sets as much.

    Args:
        values: (N_s,) of each set, in the order of the drive.
        errors: (K, N_s) of each set: continuous errors of the same pairs, inf allowed; None where there are none.
        roads: the road of each set; None where all are of one road.
        independent: whether the values are known to be independent, such as one for each place.

    Returns:
        arrays of one element. Where nothing varies, that of :data:`PRIOR_CORRELATION`.
    """
    if independent:
        return Inflation(np.ones(1), np.ones(1))
    return fill_missing_with_prior(measured_inflation(values, errors, roads))


def fill_missing_with_prior(inflation: Inflation) -> Inflation:
    """The inflation of :data:`PRIOR_CORRELATION` where one is NaN because nothing varies."""
    return Inflation(*(np.where(np.isnan(i), _PRIOR_INFLATION, i) for i in (inflation.likely, inflation.cautious)))


def inflation_of_runs(occurs: Sequence[Mask]) -> float:
    """The variance inflation of a rare event from how long its runs are, from 1 to that of :data:`PRIOR_CORRELATION`.

    An event whose runs have lengths with a geometric law of mean L goes on with the probability ``1 - 1 / L``. If it is
    rare, that is the correlation of neighbours, so that V is ``2 L - 1``. A few runs tell little of L: it is taken at
    the upper bound of a one-sided 95 % interval, which is that of the mean of as many exponential lengths. One run
    would allow any length; but who has seen one knows no less than who has seen none.

    Args:
        occurs: (N,) of each road, whether the event occurs in a stretch.
    """
    from scipy.special import chdtri

    runs = sum(int(of[0]) + np.count_nonzero(of[1:] & ~of[:-1]) for of in occurs)
    if not runs:
        return 1.0
    mean = 2 * sum(map(np.count_nonzero, occurs)) / float(chdtri(2 * runs, _BOUND_OF_RUNS))
    return min(max(1.0, 2 * mean - 1), _PRIOR_INFLATION)


def measured_inflation(
    values: Sequence[Array], errors: Sequence[ArrayLike] | None, roads: Sequence[Hashable] | None = None
) -> Inflation:
    """As :func:`inflation_of`, but NaN where nothing varies."""
    estimates = [series_inflation(aligned([v[None] for v in values], roads))]
    if errors is not None:
        scores = [normal_scores(np.atleast_2d(np.asarray(e, float))) for e in errors]
        estimates.append(series_inflation(aligned(scores, roads)))
    likely = np.concatenate([e.likely for e in estimates])
    cautious = np.concatenate([e.cautious for e in estimates])
    return Inflation(np.fmax.reduce(likely, keepdims=True), np.fmax.reduce(cautious, keepdims=True))


def _inflation(roads: Sequence[Array], product: Product, likely_at: float = _LIKELY) -> Inflation:
    levels = _moments([of.mean(axis=0) for of in roads], product)
    pairs, variance, lagged = next(levels)
    varies = variance > 1e-12 * max(float(variance.max(initial=0.0)), 1e-300)
    variance = np.where(varies, variance, np.nan)
    likely = _autoregressive(lagged / variance, pairs, len(roads), likely_at)
    cautious = _autoregressive(lagged / variance, pairs, len(roads), _CAUTIOUS)
    if any(len(of) > 1 for of in roads):
        of_parts = _of_two_parts(roads, product, (likely_at, _CAUTIOUS))
        likely, cautious = np.fmax(likely, of_parts[0]), np.fmax(cautious, of_parts[1])
    block = 2
    for blocks, of_means, lagged in levels:
        known = np.where(of_means > 0, of_means, np.nan)
        ratio = block * (known / blocks) / (variance / pairs) * (1 - _DOUBT / np.sqrt(blocks))
        inflation = ratio * _autoregressive(lagged / known, blocks, len(roads))
        likely = np.where(np.isnan(inflation), likely, np.maximum(likely, inflation))
        block *= 2
    likely, cautious = (np.where(varies, of, np.nan) for of in (likely, cautious))
    return Inflation(np.maximum(likely, 1.0), np.maximum(np.maximum(cautious, likely), 1.0))


def _of_two_parts(roads: Sequence[Array], product: Product, quantiles: Sequence[float]) -> list[Array]:
    """The inflation of the averages of sets from what the sets have in common and what is their own, by quantile.

    NaN where it is not certain that they have anything in common.
    """
    sets = max(len(of) for of in roads)
    pairs = sum(of.shape[-1] for of in roads)
    common, own = _parts(roads, product)
    total = common[0] + own[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.where(own[0] > 1e-9 * np.abs(total), own, np.nan)
        correlation = np.clip(own[1] / own[0], 0.0, _LARGEST_CORRELATION)
        of_products = (1 + correlation**2) / (1 - correlation**2)
        noise = own[0] * np.sqrt(2 * sets / (sets - 1) * of_products / pairs)
        certain = common[0] > np.fmax(_CERTAIN * noise, 1e-9 * np.abs(total))
        slow = np.ones_like(total)
        for block, of_blocks in _in_blocks(roads):
            blocks = sum(of.shape[-1] for of in of_blocks)
            of_means = _parts(of_blocks, product)[1]
            known = np.where(of_means[0] > 0, of_means[0], np.nan)
            ratio = block * (known / blocks) / (own[0] / pairs) * (1 - _DOUBT / np.sqrt(blocks * max(1, sets - 1)))
            slow = np.fmax(slow, ratio * _autoregressive(of_means[1] / known, blocks, len(roads)))
        out = []
        for quantile in quantiles:
            of_common = common[0] * _autoregressive(common[1] / common[0], pairs, len(roads), quantile)
            inflation = np.fmax(_autoregressive(own[1] / own[0], pairs, len(roads), quantile), slow)
            of_own = np.where(np.isnan(own[0]), 0.0, own[0] * inflation)
            out.append(np.where(certain, (of_common + of_own) / total, np.nan))
    return out


def _parts(roads: Sequence[Array], product: Product) -> tuple[Array, Array]:
    """The squares and the products of neighbours, (2, ...) each, of what sets have in common and of what is their own.

    Both are parts of those of the averages of the sets.
    """
    common, own = [], []
    for after, before in ((slice(None), slice(None)), (slice(1, None), slice(None, -1))):
        shared, alone = [], []
        for of in roads:
            x, count = _centred(of), len(of)
            y = x.mean(axis=0)
            whole = product(y[:, after], y[:, before])
            of_itself = product(_in_a_row(x[..., after]), _in_a_row(x[..., before])) / count**2
            shared.append((whole - of_itself) * (count / max(count - 1, 1)))
            alone.append(whole - shared[-1])
        common.append(np.sum(shared, axis=0))
        own.append(np.sum(alone, axis=0))
    return np.stack(common), np.stack(own)


def _in_a_row(x: Array) -> Array:
    """The values of all sets one after the other. (S, K, N) -> (K, S N)."""
    return x.swapaxes(0, 1).reshape(x.shape[1], -1)


def _in_blocks(series: Sequence[Array]) -> Iterator[tuple[int, list[Array]]]:
    """The means of blocks of 2, 4, ... values along the last axis, as long as there are enough."""
    means, block = list(series), 1
    while True:
        # Blocks of 2 b pairs are pairs of blocks of b; a last block without a partner is left out.
        means = [(x[..., 0 : x.shape[-1] // 2 * 2 : 2] + x[..., 1::2]) / 2 for x in means if x.shape[-1] >= 4]
        if sum(x.shape[-1] for x in means) < _MIN_BLOCKS * len(series):
            return
        block *= 2
        yield block, means


def _moments(sets: Sequence[Array], product: Product) -> Iterator[tuple[int, Array, Array]]:
    """The number of pairs, then of blocks of 2, 4, ... pairs, with sums of squares and of products of neighbours."""
    yield _sums(sets, product)
    for _, means in _in_blocks(sets):
        yield _sums(means, product)


def _centred(x: Array) -> Array:
    """Without the mean over the last axis."""
    out: Array = x - x.mean(axis=-1, keepdims=True)
    return out


def _sums(series: Sequence[Array], product: Product) -> tuple[int, Array, Array]:
    centred = [_centred(x) for x in series]
    squares = np.sum([product(x, x) for x in centred], axis=0)
    neighbours = np.sum([product(x[:, 1:], x[:, :-1]) for x in centred], axis=0)
    return sum(x.shape[1] for x in centred), squares, neighbours


def _autoregressive(lag_one: Array, count: int, sets: int, quantile: float = 0.0) -> Array:
    """``(1 + rho) / (1 - rho)`` of the bias-corrected lag-one autocorrelation plus ``quantile`` standard errors.

    The expectation of the sample's lag-one autocorrelation is ``rho - (1 + 4 rho) / n`` in the first order.
    """
    bias = min(sets / count, 0.2)
    rho = np.clip((lag_one + bias) / (1 - 4 * bias), 0.0, _LARGEST_CORRELATION)
    rho = np.minimum(rho + quantile * np.sqrt((1 - rho**2) / count), _LARGEST_CORRELATION)
    out: Array = (1 + rho) / (1 - rho)
    return out


def normal_scores(errors: Array) -> Array:
    """``Phi^-1((rank - 1/2) / N)`` of each row, equal errors with their mean rank. (K, N) -> (K, N)."""
    from scipy.special import ndtri

    out = np.empty_like(errors)
    for row, e in zip(out, errors, strict=True):
        _, place, count = np.unique(e, return_inverse=True, return_counts=True)
        last = np.cumsum(count)
        row[:] = ndtri((last - count / 2) / len(e))[place]
    return out
