"""What a reader must know of a dataset before its numbers: thresholds that ask hardly anything, doubt of the truth."""

from __future__ import annotations

from relocbench.leaderboard.tracking.doubt import doubts_of
from relocbench.leaderboard.tracking.model import DatasetBoard
from relocbench.leaderboard.tracking.thresholds import FINER, finer_thresholds
from relocbench.metrics import CORRECT


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
