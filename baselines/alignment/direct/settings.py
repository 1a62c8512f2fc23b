"""The settings of direct alignment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.errors import MethodError


@dataclass(frozen=True)
class Settings:
    """Robust loss, iterations and brightness; the defaults are DSO's except for ``cutoff_levels``.

    Raises:
        MethodError: the cutoff is below the Huber threshold, so that an outlier would cost less than an inlier.
    """

    huber: float = 9.0
    """in units of the values: the loss is quadratic below it and linear above"""
    cutoff: float = 20.0
    """in units of the values: a larger residual has constant energy and does not influence the step"""
    cutoff_levels: int = 1
    """number of the finest levels on which the cutoff applies; coarser ones have none. DSO applies it on all levels,
    but starts from a motion model. From a start that is metres off, it would discard half of the correct residuals"""
    iterations: tuple[int, ...] = (10, 20, 50, 50, 50)
    """the largest number on each level, finest first; the last entry holds for all coarser levels"""
    affine: bool = True
    """estimate the affine brightness parameters, a gain and an offset"""

    def __post_init__(self) -> None:
        if not 0 < self.huber <= self.cutoff:
            raise MethodError(f"cutoff ({self.cutoff}) must be at least huber ({self.huber}), both positive")

    def iterations_of(self, level: int) -> int:
        """The largest number of iterations on a level."""
        return self.iterations[min(level, len(self.iterations) - 1)]

    def cutoff_of(self, level: int) -> float:
        """The cutoff of a level, in units of the values; infinite if it has none."""
        return self.cutoff if level < self.cutoff_levels else np.inf
