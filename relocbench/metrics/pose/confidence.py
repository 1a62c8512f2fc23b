"""Whether a method knows when it is right: precision, recall and risk over the confidence that it reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices, Mask

CONFIDENT = 0.5
"""the confidence from which on an answer counts as confident: as a probability, more probably right than wrong"""


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """A precision-recall curve with one point for each distinct confidence, highest confidence first."""

    precision: Array
    """(K,) share of correct answers among the answers whose confidence is at least that high"""
    recall: Array
    """(K,) correct answers whose confidence is at least that high, as a share of all pairs of the set"""
    coverage: Array
    """(K,) answers whose confidence is at least that high, as a share of all pairs of the set"""

    @property
    def area(self) -> float:
        """``sum_k (recall_k - recall_{k-1}) precision_k``: no interpolation, in 0..1."""
        return float(np.sum(np.diff(self.recall, prepend=0.0) * self.precision))

    @property
    def area_over_coverage(self) -> float:
        """``sum_k (coverage_k - coverage_{k-1}) precision_k``, in 0..1: what Map-free relocalization calls AUC."""
        return float(np.sum(np.diff(self.coverage, prepend=0.0) * self.precision))

    def coverage_at(self, precision: float) -> float:
        """The largest coverage of a threshold whose precision is at least that high; 0 where there is none."""
        return float(np.max(self.coverage[self.precision >= precision], initial=0.0))


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
    pairs = np.size(correct)
    sizes, solved = _blocks(correct, answered, confidence)
    submitted, found = np.cumsum(sizes), np.cumsum(solved)
    return PrecisionRecall(precision=found / submitted, recall=found / pairs, coverage=submitted / pairs)


def is_confident(confidence: Array) -> Mask:
    """Which confidences (N,) are at least :data:`CONFIDENT`; NaN, one that was not given, is not."""
    out: Mask = confidence >= CONFIDENT
    return out


def risk_coverage_area(correct: ArrayLike, answered: ArrayLike, confidence: ArrayLike) -> float:
    """The area under the risk-coverage curve, ``1/N sum_k w_k / k``, in 0..1; 0 is best.

    ``w_k`` is the number of wrong ones among the k pairs of highest confidence (Geifman and El-Yaniv, NIPS 2017). Pairs
    without an answer are wrong and come after all answers, so that the denominator is every pair of the set. Among
    answers of equal confidence ``w_k`` grows evenly, which is its mean over all orders of them; answers without a
    confidence (NaN) come after those that have one.

    Arguments and errors are those of :func:`precision_recall`.
    """
    pairs = np.size(correct)
    sizes, solved = _blocks(correct, answered, confidence)
    failed = pairs - int(sizes.sum())
    wrong = np.concatenate([np.repeat(1.0 - solved / sizes, sizes), np.ones(failed)])
    return float(np.mean(np.cumsum(wrong) / np.arange(1, pairs + 1)))


def _blocks(correct: ArrayLike, answered: ArrayLike, confidence: ArrayLike) -> tuple[Indices, Array]:
    """The number of answers (K,) of each distinct confidence, highest first, and how many of them (K,) are correct.

    Answers without a confidence are the last block. Raises ValueError as :func:`precision_recall`.
    """
    right, given = np.asarray(correct, dtype=bool), np.asarray(answered, dtype=bool)
    sure = np.asarray(confidence, dtype=np.float64)
    if right.ndim != 1 or right.size == 0 or not right.shape == given.shape == sure.shape:
        raise ValueError("correct, answered and confidence must be non-empty arrays of one length")
    sure = np.where(np.isnan(sure), -np.inf, sure)[given]
    distinct, block = np.unique(-sure, return_inverse=True)  # negated: highest confidence first
    sizes = np.bincount(block, minlength=len(distinct))
    solved = np.bincount(block, weights=right[given], minlength=len(distinct))
    return sizes.astype(np.intp), np.asarray(solved, dtype=np.float64)
