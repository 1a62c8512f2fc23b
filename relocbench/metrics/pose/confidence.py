"""Whether a method knows when it is right: precision and recall over the confidence that it reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """A precision-recall curve with one point for each distinct confidence, highest confidence first."""

    precision: Array
    """(K,) share of correct answers among the answers whose confidence is at least that high"""
    recall: Array
    """(K,) correct answers whose confidence is at least that high, as a share of all pairs of the set"""

    @property
    def area(self) -> float:
        """``sum_k (recall_k - recall_{k-1}) precision_k``: no interpolation, in 0..1."""
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.precision))


def precision_recall(correct: ArrayLike, answered: ArrayLike, confidence: ArrayLike) -> PrecisionRecall:
    """Precision and recall as the required confidence falls.

    The denominator of the recall is every pair of the set, as in all metrics: the area is 1 only for a method that
    solves every pair, and never above the share of correct answers. Answers of equal confidence enter together,
    since the order among them is not the method's and must not count. Answers without a confidence (NaN) enter
    together after all others; pairs without an answer never enter.

    Args:
        correct: (N,) bool.
        answered: (N,) bool.
        confidence: (N,) higher is more certain, on any scale; NaN where not given; ignored where not answered.

    Raises:
        ValueError: no pairs, or the shapes do not fit.
    """
    right, given = np.asarray(correct, dtype=bool), np.asarray(answered, dtype=bool)
    sure = np.asarray(confidence, dtype=np.float64)
    if right.ndim != 1 or right.size == 0 or not right.shape == given.shape == sure.shape:
        raise ValueError("correct, answered and confidence must be non-empty arrays of one length")
    sure = np.where(np.isnan(sure), -np.inf, sure)[given]
    distinct, block = np.unique(-sure, return_inverse=True)  # negated: highest confidence first
    submitted = np.cumsum(np.bincount(block, minlength=len(distinct)))
    solved = np.cumsum(np.bincount(block, weights=right[given], minlength=len(distinct)))
    return PrecisionRecall(precision=solved / submitted, recall=solved / right.size)
