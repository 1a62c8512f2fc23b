"""The spread of residuals among which some are wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SIGMAS_A_MEDIAN = 1.4826
"""1 / 0.6745: half of a normal distribution lies within 0.6745 standard deviations"""


def robust_sigma(residuals: Array, weights: Array) -> float:
    """Standard deviation of the good ones of residuals (N,), whose weights are (N,); nan of none.

    The weighted median of the absolute residuals, scaled to the standard deviation of a normal distribution (Hampel,
    The influence curve and its role in robust estimation, JASA 1974).
    """
    return _SIGMAS_A_MEDIAN * _weighted_median(np.abs(residuals), weights)


def _weighted_median(values: Array, weights: Array) -> float:
    """The value (N,) with half of the weight (N,) below it; nan of none."""
    if not len(values):
        return float("nan")
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[min(np.searchsorted(total, total[-1] / 2), len(order) - 1)]])
