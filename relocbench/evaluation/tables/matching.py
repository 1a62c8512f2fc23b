"""``PAIRSET.matching.csv``: the matching quality of a tracker, a row for each pair and start offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError
from relocbench.evaluation.tables.schema import ALL, COUNT, TEXT, PairRecord, Schema

OFFSETS_PX = (1, 2, 4, 8, 16)
"""distances between the start and the true pixel"""

Summary = dict[str, dict[str, float | int | None]]
"""start offset (``all``, ``1px``, ...) -> counts, and shares 0..1"""


@dataclass(frozen=True)
class MatchingRow(PairRecord):
    """How many pixels of a pair, those that were started at one offset, the method brought near the truth."""

    group: Annotated[str, TEXT]
    offset_px: Annotated[int, COUNT]
    pixels: Annotated[int, COUNT]
    """number of pixels that started at this offset; every pixel starts at one offset only"""
    answered: Annotated[int, COUNT]
    within_1px: Annotated[int, COUNT]
    within_3px: Annotated[int, COUNT]
    start_within_1px: Annotated[int, COUNT]
    """starts that are that near already, which a method that does not move would get"""
    start_within_3px: Annotated[int, COUNT]
    message: Annotated[str, TEXT] = ""
    """how the method crashed, in which case it answered no pixel"""

    @property
    def named(self) -> str:
        return ""  # a pair has a row for each offset

    def contradiction(self) -> str | None:
        if self.within_1px <= self.within_3px <= self.answered <= self.pixels:
            return None
        return "expected within_1px <= within_3px <= answered <= pixels"


MATCHING = Schema(MatchingRow)


def check_complete(rows: Sequence[MatchingRow], keys: Sequence[PairKey], path: Path) -> None:
    """Raise PredictionError unless there is one row for each pair of the set and each offset."""
    present = sorted((row.key, row.offset_px) for row in rows)
    if present != sorted((key, offset) for key in keys for offset in OFFSETS_PX):
        raise PredictionError(
            f"expected one row for each of the {len(keys)} pairs and each offset "
            f"({', '.join(map(str, OFFSETS_PX))} px); remove the file and measure again",
            path,
        )


def summarize_matching(rows: Sequence[MatchingRow], group: str = ALL) -> Summary:
    """Shares of all correspondences of a group's pairs, over all offsets and by offset; None where there are none."""
    chosen = [row for row in rows if group in (ALL, row.group)]
    return {
        ALL: _shares(chosen),
        **{f"{offset}px": _shares([row for row in chosen if row.offset_px == offset]) for offset in OFFSETS_PX},
    }


def _shares(rows: Sequence[MatchingRow]) -> dict[str, float | int | None]:
    count = sum(row.pixels for row in rows)

    def share(name: str) -> float | None:
        return sum(getattr(row, name) for row in rows) / count if count else None

    return {
        "count": count,
        "answered": share("answered"),
        "match@1px": share("within_1px"),
        "match@3px": share("within_3px"),
        "start@1px": share("start_within_1px"),
        "start@3px": share("start_within_3px"),
    }
