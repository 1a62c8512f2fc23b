"""What a reader must know of a dataset before its numbers: thresholds that ask hardly anything, doubt of the truth.

Finer thresholds are chosen by the pairs' own distances alone and by no method: where the keyframe's pose is right for
at least half of all pairs within the usual thresholds, the finer default is the first of 0.1, 0.05 and 0.025 m, each
with an angle in the usual proportion of 1 deg to 0.1 m, within which it is right for less than half; where there is
none, the finest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Mask
from relocbench.leaderboard.tracking.doubt import doubts_of
from relocbench.leaderboard.tracking.model import DatasetBoard, DatasetEntry
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


def reservations(dataset: DatasetBoard) -> list[str]:
    """Whole sentences of plain text, one item a matter; none where there is nothing to say."""
    entry = dataset.entry
    finer = finer_thresholds(entry)
    out = []
    if finer is not None:
        tried = ", ".join(_words(*each) for each in FINER)
        chosen = (
            f"the first of {tried} within which that pose is right for less than half"
            if finer.fits
            else f"the finest of {tried}, within which that pose is still right for {100 * finer.still_here:.0f} %"
        )
        out.append(
            f"Within {_words(*CORRECT)}, {entry.record.name} is nearly solved by standing still: the keyframe's own "
            f"pose is right for {100 * finer.still:.0f} % of the pairs. Beside it stands the finer default, "
            f"{_words(finer.metres, finer.degrees)}: {chosen}."
        )
    for pair_set, words in doubts_of(entry.truth_checks, entry.used):
        where = entry.record.name if len(entry.used) == 1 else f"{entry.record.name}, {pair_set},"
        out.append(
            f"The truth of {where} is in doubt: {words}. Errors of this size are the truth's "
            "rather than a method's; relocbench inspect --pictures shows the pairs."
        )
    return out


def _words(metres: float, degrees: float) -> str:
    return f"{metres:g} m and {degrees:g}°"
