"""What the feature aligner can be told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from baselines.alignment.features.reference import FeaturePoints
from baselines.alignment.shared.damping import DSO_DAMPING, Damping
from relocbench.errors import MethodError

LM_RELOC_DAMPING = Damping(first=2.0, extrapolate_below=0.0, smallest_step=1e-4)
"""For features that were trained by LM-Reloc's descent loss: DSO's factors, but the first step of a level is damped as
that loss damps its one step (lambda = 2), and steps are never lengthened. A damped step is a third of what is left to
go, so that a level ends at a smaller one. LM-Reloc's own aligner uses DSO's schedule; the constants of this one are a
reading of its loss, not published ones."""


@dataclass(frozen=True)
class FeatureSettings:
    """Robust loss, iterations, damping.

    Raises:
        MethodError: the cutoff is below the Huber threshold, or a number is not positive.
    """

    huber: float = 0.3
    """in ``unit``: below it the loss is quadratic, above linear"""
    cutoff: float = 1.0
    """in ``unit``: above it a residual has constant energy and no say in the step"""
    unit: Literal["spread", "absolute"] = "spread"
    """``spread``: multiples of the robust scale of the reference's features on the level, so that a network may scale
    its features as it likes, on each level; ``absolute``: the features' own units"""
    per_channel: bool = False
    """robust loss on each channel's residual, else on the norm over all channels. The norm is the default: channels of
    a learned feature mean nothing one by one and may be rotated into each other, and a point that is hidden is wrong in
    all of them"""
    cutoff_levels: int = 1
    """the cutoff holds on so many of the finest levels; coarser ones only have the Huber loss"""
    iterations: tuple[int, ...] = (10, 20, 50, 50, 50)
    """at most so many, finest level first; the last holds for all coarser levels"""
    damping: Damping = DSO_DAMPING
    min_points: int = 8
    """a coarse level with fewer points is left out; fewer on the finest are a stated trouble"""

    def __post_init__(self) -> None:
        if not 0 < self.huber <= self.cutoff:
            raise MethodError(f"cutoff ({self.cutoff}) must be at least huber ({self.huber}), both positive")
        if self.unit not in ("spread", "absolute"):
            raise MethodError(f"unit is '{self.unit}', expected spread or absolute")
        if not self.iterations or min(*self.iterations, self.min_points, 1) < 1:
            raise MethodError("iterations and min_points must be at least 1")

    def iterations_of(self, level: int) -> int:
        """At most so many iterations on a level."""
        return self.iterations[min(level, len(self.iterations) - 1)]

    def thresholds(self, reference: FeaturePoints, level: int) -> tuple[float, float]:
        """Huber threshold and cutoff of a level, in the features' own units; not a number if the spread is not."""
        unit = 1.0
        if self.unit == "spread":
            channels = reference.values.shape[1]
            # One channel holds its share of the squared distance.
            unit = reference.spread / (np.sqrt(channels) if self.per_channel else 1.0)
        return self.huber * unit, self.cutoff * unit if level < self.cutoff_levels else np.inf
