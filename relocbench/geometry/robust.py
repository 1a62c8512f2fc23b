"""Robust spread of residuals with outliers."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array

_SIGMA_PER_MEDIAN = 1.4826
"""1 / 0.6745: half of a normal distribution lies within 0.6745 standard deviations"""


def robust_sigma(residuals: Array, weights: Array) -> float:
    """Robust standard deviation of residuals (N,) with weights (N,); nan if there are none.

    It is the weighted median of the absolute residuals, scaled to the standard deviation of a normal distribution
    (Hampel, The influence curve and its role in robust estimation, JASA 1974).
    """
    return _SIGMA_PER_MEDIAN * weighted_median(np.abs(residuals), weights)


def weighted_median(values: Array, weights: Array) -> float:
    """The value of (N,) below which half of the total weight (N,) lies; nan if there are none."""
    if not len(values):
        return float("nan")
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[min(np.searchsorted(total, total[-1] / 2), len(order) - 1)]])
