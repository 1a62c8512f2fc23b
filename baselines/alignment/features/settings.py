"""The settings of feature alignment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from baselines.alignment.features.reference import FeaturePoints
from baselines.alignment.shared.damping import DSO_DAMPING, Damping
from baselines.alignment.shared.levels import ABANDON_FACTOR
from relocbench.errors import MethodError

LM_RELOC_DAMPING = Damping(first=2.0, extrapolate_below=0.0, smallest_step=1e-4)
"""For features trained by LM-Reloc's descent loss. The factors are DSO's, but the first step of a level is damped as
that loss damps its one step (lambda = 2), and steps are never lengthened. Since such a step covers only a third of the
remaining distance, a level ends at a smaller step. LM-Reloc's own aligner uses DSO's schedule; the constants here are
derived from its loss and are not published."""


@dataclass(frozen=True)
class FeatureSettings:
    """Robust loss, iterations and damping.

    Raises:
        MethodError: the cutoff is below the Huber threshold, or one of them is not positive.
    """

    huber: float = 0.3
    """in ``unit``: the loss is quadratic below it and linear above"""
    cutoff: float = 1.0
    """in ``unit``: a larger residual has constant energy and does not influence the step"""
    unit: Literal["spread", "absolute"] = "spread"
    """``spread``: multiples of the robust scale of the reference's features on the level, so that the thresholds do not
    depend on how a network scales its features; ``absolute``: the features' own units"""
    per_channel: bool = False
    """apply the robust loss to each channel's residual instead of the norm over all channels. The norm is the default
    because single channels of a learned feature have no meaning and could be rotated into each other, and because an
    occluded point is wrong in all of them"""
    cutoff_levels: int = 1
    """number of the finest levels on which the cutoff applies; coarser ones only have the Huber loss"""
    iterations: tuple[int, ...] = (10, 20, 50, 50, 50)
    """the largest number on each level, finest first; the last entry holds for all coarser levels"""
    damping: Damping = DSO_DAMPING
    give_up: float = ABANDON_FACTOR
    """of several starts, one is given up on the first level whose root mean energy is this many times the lowest"""
    kept: tuple[int, ...] = ()
    """of several starts, at most so many are kept after each level, finest first; after coarser levels all"""
    nearby: tuple[float, ...] = ()
    """shares of the points' median depth: by so much the camera of the best poses of the level next to the finest is
    moved forth and back along each of its axes, for further starts on this level"""
    min_valid_share: float = 0.1
    """share of a level's residuals that must be in view where its alignment ends; with fewer the start has failed. The
    energy is a mean over those in view, and lowest where next to nothing is"""
    min_points: int = 8
    """a coarse level with fewer points is left out; with fewer on the finest level the alignment fails"""

    def __post_init__(self) -> None:
        if not 0 < self.huber <= self.cutoff:
            raise MethodError(f"cutoff ({self.cutoff}) must be at least huber ({self.huber}), both positive")

    def iterations_of(self, level: int) -> int:
        """The largest number of iterations on a level."""
        return self.iterations[min(level, len(self.iterations) - 1)]

    def kept_on(self, level: int) -> int | None:
        """How many starts are kept at most after a level; None: all."""
        return self.kept[level] if level < len(self.kept) else None

    def thresholds(self, reference: FeaturePoints, level: int) -> tuple[float, float]:
        """The Huber threshold and the cutoff of a level, in the features' own units; NaN if the spread is NaN."""
        unit = 1.0
        if self.unit == "spread":
            channels = reference.values.shape[1]
            # Each channel has an equal share of the squared distance.
            unit = reference.spread / (np.sqrt(channels) if self.per_channel else 1.0)
        return self.huber * unit, self.cutoff * unit if level < self.cutoff_levels else np.inf
