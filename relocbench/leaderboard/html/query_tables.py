"""The tables of sets of queries as the pages take them, of retrievers and of pipelines alike."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from relocbench.leaderboard.common.by_query import Table
from relocbench.leaderboard.common.columns import B, Column, Line, R, T
from relocbench.leaderboard.common.model import about_ranks
from relocbench.leaderboard.common.text import BASIN, METHOD, RANK, RESCORED, RETRIEVER, TOP, TRACKER

ANSWER_COLUMNS = (
    {"key": "seconds", "title": "seconds", "kind": "s", "higher": False},
    {"key": "status", "title": "answer", "kind": "status"},
)
"""the last columns of every list of queries: key of a row, heading, how it is shown, and whether more is better"""
_NAMES = (RANK, METHOD, RETRIEVER, TRACKER, TOP)


def view_of(columns: Iterable[str]) -> list[str]:
    """The columns of a page in Markdown as a page in HTML has them, which names a method in one column."""
    return [METHOD, *([RANK] if RANK in (of := tuple(columns)) else []), *(key for key in of if key not in _NAMES)]


def columns_payload(columns: Mapping[str, Column[Line[B, T, R]]], keys: Iterable[str]) -> dict[str, Any]:
    """What the columns of these keys are called, in which unit they are, and whether more is better."""
    return {
        key: {
            "heading": columns[key].heading,
            "unit": columns[key].unit,
            "higher": columns[key].higher_is_better,
            "words": key in (BASIN, RESCORED),
        }
        for key in keys
        if key != METHOD
    }


def table_payload(
    table: Table[Any, Any],
    views: Mapping[str, Sequence[str]],
    columns: Mapping[str, Column[Line[B, T, R]]],
    lines: Iterable[tuple[str, Line[B, T, R]]],
    *,
    metric: str,
    about: str,
    note: str = "",
    further: Sequence[str] = (),
) -> dict[str, Any]:
    """A table.

    Args:
        views: id of a table on the page -> the keys of its columns.
        lines: with the labels of their methods.
        metric: the one that ranks.
        about: sentences about its tasks.
        note: a sentence without its full stop for below the table, besides why there are no ranks.
        further: keys of columns whose numbers are drawn and not shown.
    """
    keys = [key for key in dict.fromkeys([*(key for of in views.values() for key in of), *further]) if key != METHOD]
    rows = [(label, line) for label, line in lines]
    missing = [f"{label} on {', '.join(line.row.missing)}" for label, line in rows if line.row and line.row.missing]
    return {
        "title": table.name,
        "tasks": list(table.tasks),
        "group": "all",
        "views": dict(views),
        "about": f"{about} Missing: {'; '.join(missing)}." if missing else about,
        "notes": [about_ranks(table.rows, metric, f"{table.queries} queries"), note],
        "rows": [_row(label, line, [columns[key] for key in keys]) for label, line in rows],
    }


def _row(label: str, line: Line[B, T, R], columns: Sequence[Column[Line[B, T, R]]]) -> dict[str, Any]:
    numbers = [column for column in columns if column.unit]
    bounds = {column.key: column.bounds(line) for column in numbers if column.bounds is not None}
    return {
        "method": label,
        "chance": line.row is None,
        "texts": {column.key: column.text(line) for column in columns if not column.unit},
        "values": {column.key: column.value(line) for column in numbers},
        "intervals": {key: [of.low, of.high] for key, of in bounds.items() if of is not None},
        "missing": [] if line.row is None else list(line.row.missing),
    }
