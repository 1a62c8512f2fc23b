"""Automatic choice of the bootstrap's block length: how many neighbouring pairs are resampled together.

Politis and White, "Automatic Block-Length Selection for the Dependent Bootstrap", Econometric Reviews 2004,
with the correction of Patton, Politis and White, Econometric Reviews 2009, for the circular block bootstrap.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def automatic_block_length(values: ArrayLike) -> int:
    """The block length that minimises the mean squared error of the bootstrap variance of the mean.

    ``b = (2 G^2 / D)^(1/3) N^(1/3)`` with ``G = sum w(k/M) |k| R(k)``, ``g = sum w(k/M) R(k)`` over |k| <= M,
    ``D = 4/3 g^2``, where R is the autocovariance and w the flat-top window ``min(1, 2 (1 - |s|))``. M is twice the
    lag beyond which the autocorrelation cannot be distinguished from 0.

    Args:
        values: (N,) in the order of the drive.

    Returns:
        at least 1, and at most ``min(3 sqrt(N), N / 3)`` as the authors advise.
    """
    x = np.asarray(values, dtype=np.float64)
    n = len(x)
    longest = max(1, min(math.ceil(3 * math.sqrt(n)), n // 3))
    run = max(5, math.ceil(math.sqrt(math.log10(n)))) if n > 1 else 5
    max_lag = min(math.ceil(math.sqrt(n)) + run, n - 1)
    if max_lag < 1:
        return 1
    R = _autocovariance(x, max_lag)
    if R[0] <= 0:
        return 1
    M = min(2 * _last_correlated_lag(R / R[0], run, 2 * math.sqrt(math.log10(n) / n)), max_lag)
    if M == 0:
        return 1
    k = np.arange(1, M + 1)
    weight = np.minimum(1.0, 2.0 * (1.0 - k / M))
    G = 2 * np.sum(weight * k * R[1 : M + 1])
    g = R[0] + 2 * np.sum(weight * R[1 : M + 1])
    D = 4 / 3 * g**2
    if D <= 0:
        return longest
    return int(np.clip(math.ceil((2 * G**2 / D * n) ** (1 / 3)), 1, longest))


def _autocovariance(x: Array, max_lag: int) -> Array:
    """``R(k) = 1/N sum (x_i - mean)(x_{i+k} - mean)`` for k = 0..max_lag."""
    centred = x - x.mean()
    return np.array([centred[: len(x) - k] @ centred[k:] for k in range(max_lag + 1)]) / len(x)


def _last_correlated_lag(rho: Array, run: int, limit: float) -> int:
    """The smallest lag followed by ``run`` autocorrelations (or all that remain) whose magnitude is below ``limit``."""
    small = np.abs(rho[1:]) < limit
    for m in range(len(small)):
        if small[m : m + run].all():
            return m
    return len(small)
