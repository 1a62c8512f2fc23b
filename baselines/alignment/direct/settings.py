"""What the direct aligner can be told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.errors import MethodError


@dataclass(frozen=True)
class Settings:
    """What the solver can be told; the defaults are DSO's but for ``cutoff_levels``.

    Raises:
        MethodError: the cutoff is below the Huber threshold: a saturated residual would cost less than one that fits.
    """

    huber: float = 9.0
    """in units of the values: below it the loss is quadratic, above linear"""
    cutoff: float = 20.0
    """in units of the values: above it a residual has constant energy and no say in the step"""
    cutoff_levels: int = 1
    """the cutoff holds on so many of the finest levels; coarser ones have none. DSO has it on all: there the start is
    a motion model's. From a start metres off, half of the right residuals would be cut off before they could pull"""
    iterations: tuple[int, ...] = (10, 20, 50, 50, 50)
    """at most so many, finest level first; the last holds for all coarser levels"""
    affine: bool = True
    """estimate gain and offset of the brightness"""

    def __post_init__(self) -> None:
        if not 0 < self.huber <= self.cutoff:
            raise MethodError(f"cutoff ({self.cutoff}) must be at least huber ({self.huber}), both positive")

    def iterations_of(self, level: int) -> int:
        """At most so many iterations on a level."""
        return self.iterations[min(level, len(self.iterations) - 1)]

    def cutoff_of(self, level: int) -> float:
        """The cutoff of a level, in units of the values; infinite where there is none."""
        return self.cutoff if level < self.cutoff_levels else np.inf
