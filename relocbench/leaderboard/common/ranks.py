"""Ranks as they are shown: never one that all methods of a table share, since it says nothing of any."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

NO_RANK = "–"
"""in place of the rank that all methods of a table share"""


class HasRank(Protocol):
    """A row of a table of any task."""

    @property
    def rank(self) -> int | None:
        """Among the rows of its table; None for a row that is not ranked."""
        ...


def share_a_rank(rows: Iterable[HasRank]) -> bool:
    """Whether all ranked rows share the first rank."""
    return all(row.rank in (1, None) for row in rows)


def rank_text(row: HasRank, rows: Iterable[HasRank]) -> str:
    """The rank as text: empty for a row that is not ranked, a dash where all rows share a rank."""
    if row.rank is None:
        return ""
    return NO_RANK if share_a_rank(rows) else str(row.rank)
