"""The exact area under a cumulative error curve: the share of all pairs with an error of at most a threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array


def area_shares(error: ArrayLike, threshold: float) -> Array:
    """``max(0, 1 - e / threshold)`` of each error (N,), in 0..1.

    Their mean is the area under the cumulative curve from 0 to ``threshold``, divided by ``threshold``. It is exact,
    because the step function integrates to ``1/N sum max(0, threshold - e)``; trapezoids through the sorted errors
    and histograms give other numbers when N is small.

    Raises:
        ValueError: a threshold that is not positive, and as :func:`checked_errors`.
    """
    if not threshold > 0:
        raise ValueError(f"the threshold of an area must be positive, got {threshold}")
    return np.maximum(0.0, 1.0 - checked_errors(error) / threshold)


def checked_errors(error: ArrayLike) -> Array:
    """Errors (N,) as float64; inf is allowed. Raises ValueError on NaN, a negative error, or no errors at all."""
    e = np.asarray(error, dtype=np.float64)
    if e.ndim != 1 or e.size == 0 or not np.all(e >= 0):
        raise ValueError("errors must be a non-empty (N,) array of numbers >= 0 or inf")
    return e
