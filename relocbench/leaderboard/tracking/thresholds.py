"""Which thresholds fit a dataset: those within which standing still does not already find half of the pairs.

The rule knows the pairs' own distances alone and no method: where the keyframe's pose is right for at least half of all
pairs within the usual thresholds, the finer default is the first of 0.1, 0.05 and 0.025 m, each with an angle in the
usual proportion of 1 deg to 0.1 m, within which it is right for less than half; where there is none, the finest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Mask
from relocbench.leaderboard.tracking.model import DatasetEntry
from relocbench.metrics import CORRECT

FINER = ((0.1, 1.0), (0.05, 0.5), (0.025, 0.25))
"""(metres, degrees), coarsest first"""
_HALF = 0.5


@dataclass(frozen=True)
class FinerThresholds:
    """The default thresholds of a dataset that standing still nearly solves within the usual ones."""

    metres: float
    degrees: float
    still: float
    """share of all pairs that are at most :data:`CORRECT` apart, so that the keyframe's own pose is right"""
    still_here: float
    """the same share within these thresholds"""

    @property
    def fits(self) -> bool:
        """Whether standing still finds less than half of the pairs here; otherwise none of :data:`FINER` fits."""
        return self.still_here < _HALF


def finer_thresholds(entry: DatasetEntry) -> FinerThresholds | None:
    """The finer default of a dataset by the distances of all pairs with results; None where the usual one fits.

    Where a pair's distance or angle is not known, neither is the share, and the usual thresholds stay.
    """
    known = [table for name in entry.used if (table := entry.errors_of(name)) is not None]
    if not known:
        return None
    distance, angle = (np.concatenate([table.column(of) for table in known]) for of in ("distance_m", "angle_deg"))
    if np.isnan(distance).any() or np.isnan(angle).any():
        return None

    def still(metres: float, degrees: float) -> float:
        right: Mask = (distance <= metres) & (angle <= degrees)
        return float(right.mean())

    if still(*CORRECT) < _HALF:
        return None
    metres, degrees = next((each for each in FINER if still(*each) < _HALF), FINER[-1])
    return FinerThresholds(metres, degrees, still(*CORRECT), still(metres, degrees))
