"""Drives whose pairs are correlated from one to the next."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from relocbench.arrays import Array


def autoregressive(rng: np.random.Generator, n: int, rho: float) -> Array:
    """A stationary first-order autoregression of variance 1."""
    steps = np.sqrt(1 - rho**2) * rng.normal(size=n)
    steps[0] = rng.normal()
    out: Array = lfilter([1.0], [1.0, -rho], steps)
    return out
