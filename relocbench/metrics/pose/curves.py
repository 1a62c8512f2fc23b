"""Cumulative error curves, and the exact area under them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CumulativeCurve:
    """Sorted errors against the share of all pairs: a step function that rises by 1/N at each error."""

    error: Array
    """(M,) the finite errors, ascending; M <= N"""
    share: Array
    """(M,) share of all N pairs whose error is at most ``error``; the last entry is the coverage"""

    def at(self, threshold: float) -> float:
        """Share of all pairs with an error <= ``threshold``."""
        below = int(np.searchsorted(self.error, threshold, side="right"))
        return float(self.share[below - 1]) if below else 0.0


def cumulative_curve(error: ArrayLike) -> CumulativeCurve:
    """The cumulative curve of errors (N,), inf where there is no answer. Raises ValueError on NaN or no errors."""
    e = checked_errors(error)
    finite = np.sort(e[np.isfinite(e)])
    return CumulativeCurve(finite, np.arange(1, len(finite) + 1) / len(e))


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
