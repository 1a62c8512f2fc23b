"""What boards of all tasks have in common: a method with its results, its row in a table, and its rank as it is shown.

A rank that all methods of a table share is not shown, since it says nothing of any.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from relocbench.metrics import MIN_EFFECTIVE, Interval


class Method(Protocol):
    """The results of one method on one set."""

    @property
    def label(self) -> str: ...

    @property
    def answers(self) -> Mapping[str, object]:
        """By pair set or task; those without results are absent."""
        ...


def is_renamed(label: str, ran_as: str) -> bool:
    """Whether a folder is not named as its run, other than by the fingerprint of a copy of the dataset."""
    return ran_as not in ("", label, label.rpartition("@")[0])


M_co = TypeVar("M_co", bound=Method, covariant=True)


@dataclass(frozen=True, eq=False)
class Row(Generic[M_co]):
    """A row for one method; it has no values if the method misses a pair set or task."""

    method: M_co
    values: Mapping[str, float | None]
    """by metric: means over the pair sets or tasks of means over what is asked; medians are over all together"""
    intervals: Mapping[str, Interval | None]
    rank: int | None
    """None if one is missing, and for a method that is not ranked"""
    failed: int | None = None
    """number of answers that the method declined"""
    broke: int | None = None
    """number of answers on which it raised, crashed or broke the contract"""
    missing: tuple[str, ...] = ()
    """the pair sets or tasks that are missing"""
    family: tuple[str, ...] = ()
    """the labels of near-copies, of which ranks count the first alone; empty where there are none"""


NEAR_COPIES = "≈"
"""behind the rank of a method that has near-copies"""
NO_RANK = "–"
"""in place of the rank that all methods of a table share"""
SHARED = "Methods share a rank where the pairs show no significant difference between them"


def share_a_rank(rows: Iterable[Row[Method]]) -> bool:
    """Whether all ranked rows share the first rank."""
    return all(row.rank in (1, None) for row in rows)


def rank_text(row: Row[Method], rows: Iterable[Row[Method]]) -> str:
    """The rank as text: empty for a row that is not ranked, a dash where all rows share a rank."""
    if row.rank is None:
        return ""
    if share_a_rank(rows):
        return NO_RANK
    return f"{row.rank} {NEAR_COPIES}" if row.family else str(row.rank)


def about_ranks(rows: Sequence[Row[Method]], metric: str, of: str) -> str:
    """Why a table shows no ranks, or which methods count once in them, without a full stop; empty for neither."""
    families = [] if share_a_rank(rows) else dict.fromkeys(row.family for row in rows if row.family)
    listed = "; ".join(", ".join(family) for family in families)
    copies = f"{NEAR_COPIES} near-copies count as one method in the ranks of others: {listed}" if listed else ""
    return why_no_ranks(rows, metric, of) or copies


def why_no_ranks(rows: Sequence[Row[Method]], metric: str, of: str) -> str:
    """Why a table shows no ranks, in a sentence without its full stop; empty where it has some, and without methods.

    Args:
        metric: the one that ranks.
        of: what the rows are over, with their number, such as ``24 pairs``.
    """
    ranked = [row for row in rows if row.rank is not None]
    if not ranked or not share_a_rank(rows):
        return ""
    if not all(row.intervals.get(metric) for row in ranked):  # a difference from what has no interval is not tested
        return f"No ranks: too few of the {of} are independent (effective sample size below {MIN_EFFECTIVE:g})"
    if len(ranked) == 1:
        return "No ranks: there is one method alone"
    return "No ranks: no significant difference between the methods"
