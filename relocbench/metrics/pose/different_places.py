"""What a method does with negative pairs: keyframe and query show different places, and no pose is right.

Their true poses are known all the same. An answer that is right by them is not held against a method, however it came
about; every other one is wrong.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relocbench.metrics.pose.confidence import is_confident
from relocbench.metrics.statistics.intervals import LEVEL, share_interval


@dataclass(frozen=True)
class DifferentPlaces:
    """Counts of answers to pairs of different places."""

    pairs: int
    answered: int
    """answers at all"""
    confident: int
    """wrong answers that are confident, or without a confidence: nothing advises against them"""

    @classmethod
    def of(cls, correct: ArrayLike, answered: ArrayLike, confidence: ArrayLike) -> DifferentPlaces:
        """Count the answers.

        Args:
            correct: (N,) bool.
            answered: (N,) bool.
            confidence: (N,) NaN where not given; ignored where not answered.

        Raises:
            ValueError: the shapes do not fit.
        """
        right, given = np.asarray(correct, dtype=bool), np.asarray(answered, dtype=bool)
        sure = np.asarray(confidence, dtype=np.float64)
        if given.ndim != 1 or not right.shape == given.shape == sure.shape:
            raise ValueError("correct, answered and confidence must be arrays of one length")
        confident = np.isnan(sure) | is_confident(sure)
        return cls(len(given), int(given.sum()), int(np.sum(given & ~right & confident)))

    @classmethod
    def total(cls, parts: Iterable[DifferentPlaces]) -> DifferentPlaces:
        """The counts of several pair sets together."""
        counts = [(p.pairs, p.answered, p.confident) for p in parts]
        return cls(*(sum(column) for column in zip(*counts, strict=True))) if counts else cls(0, 0, 0)

    @property
    def answered_share(self) -> float | None:
        """In 0..1; None without pairs."""
        return self.answered / self.pairs if self.pairs else None

    @property
    def confident_share(self) -> float | None:
        """In 0..1; None without pairs. 0 is best."""
        return self.confident / self.pairs if self.pairs else None

    @property
    def confident_high(self) -> float | None:
        """The upper bound of the 95 % interval of :attr:`confident_share` by Clopper and Pearson; None without pairs.

        Pairs are drawn at random and count as independent.
        """
        return share_interval(self.confident, self.pairs, level=LEVEL).high if self.pairs else None

    def to_dict(self) -> dict[str, Any]:
        """Counts, shares and the bound as one flat mapping."""
        return {
            "pairs": self.pairs,
            "answered": self.answered,
            "confident": self.confident,
            "answered_share": self.answered_share,
            "confident_share": self.confident_share,
            "confident_high": self.confident_high,
        }
