"""Drives whose pairs are correlated from one to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def autoregressive(rng: np.random.Generator, n: int, rho: float) -> Array:
    """A stationary first-order autoregression of variance 1."""
    x = np.empty(n)
    x[0] = rng.normal()
    for i, innovation in enumerate(np.sqrt(1 - rho**2) * rng.normal(size=n - 1), start=1):
        x[i] = rho * x[i - 1] + innovation
    return x
