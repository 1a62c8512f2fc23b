"""The tables of the start page and of the pages of methods: one honest number of each method, with its interval."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.common import model
from relocbench.leaderboard.common.by_query import Board as QueryBoard
from relocbench.leaderboard.common.columns import Line
from relocbench.leaderboard.common.model import Row, rank_text
from relocbench.leaderboard.common.over_datasets import GREATEST, LEAST, OverDatasets
from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.payloads import marks_of, no_gain, table_title
from relocbench.leaderboard.html.pipeline_pages.payloads import PipelinePages
from relocbench.leaderboard.html.query_pages import QueryPages
from relocbench.leaderboard.html.retrieval_pages.payloads import RetrievalPages
from relocbench.leaderboard.retrieval.columns import CHANCE
from relocbench.leaderboard.tracking.marks import about_ranks
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Table
from relocbench.leaderboard.tracking.model import Row as TrackerRow
from relocbench.metrics import Interval

_LAST = 1_000_000
"""by which rows without a rank sort"""


def pages_by_query(boards: Boards) -> list[tuple[QueryPages[Any, Any, Any, Any], QueryBoard[Any, Any, Any, Any]]]:
    """The boards of retrievers and of pipelines, with the pages that they get."""
    both = ((RetrievalPages(), boards.retrieval), (PipelinePages(boards.tracking), boards.relocalization))
    return [(pages, board) for pages, board in both if board is not None]


def sections(boards: Boards) -> list[dict[str, Any]]:
    """The tables of the start page: one for each task."""
    sections = []
    board = boards.tracking
    if board is not None:
        ran = frozenset(method.label for method in board.methods)
        sections += [_over_section("Trackers", over, ran) for over in board.over]
        totals = [(dataset, table) for dataset in board.datasets for table in dataset.totals]
        rows = [tracker_row(board, of, table, row) for of, table in totals for row in table.rows]
        remarks = [(of.entry.title, table_title(t), about_ranks(board, t), no_gain(of, t)) for of, t in totals]
        notes = [note for each in remarks for note in _notes(*each)]
        section = {"title": "Trackers", "metric": board.metric.name, "what": "pairs", "rows": rows, "notes": notes}
        sections.append(section)
    for pages, by_query in pages_by_query(boards):
        known = frozenset(m.label for of in by_query.sets for m in of.methods if pages.has_method_pages)
        sections += [_over_section(pages.title, over, known) for over in by_query.over]
        first = [(of, table) for of in by_query.sets for table in _first(pages, of.tables)]
        lines = [line for of, table in first for line in pages.display.lines(of, table)]
        why = [model.about_ranks(t.rows, by_query.metric, f"{t.queries} queries") for _, t in first]
        remarks = [(of.title, t.name, no, pages.note(by_query, t)) for (of, t), no in zip(first, why, strict=True)]
        notes = [note for each in remarks for note in _notes(*each)]
        rows = query_rows(pages, by_query, lines)
        section = {"title": pages.title, "metric": by_query.metric, "what": "queries", "rows": rows, "notes": notes}
        sections.append(section)
    return sections


def _over_section(title: str, over: OverDatasets[Any], known: frozenset[str]) -> dict[str, Any]:
    """The table over all datasets; ``known`` are the labels of methods with pages."""
    titles = ", ".join(part.title for part in over.parts)
    rows = [
        {
            "set": f"{over.roads} datasets{_span(row)}",
            "table": over.name,
            "count": over.count,
            "method": row.method.label,
            "method_page": links.method_page(row.method.label) if row.method.label in known else "",
            "baseline": row.rank is None and not row.missing,
            "marks": [],
            "finer": False,
            **_of_row(row, over.rows),
            **_number(row.values[over.metric], row.intervals.get(over.metric), "share"),
            "page": "",
            "link": "",
        }
        for row in over.rows
    ]
    return {
        "title": f"{title}, {over.title}",
        "metric": over.metric,
        "what": over.what,
        "rows": rows,
        "notes": [f"Every dataset counts once: {titles}", *over.notes],
    }


def _span(row: Row[Any]) -> str:
    """From the worst to the best of the datasets; empty without a value."""
    least, greatest = (row.values[key] for key in (LEAST, GREATEST))
    return "" if least is None else f", {number(least, 'share')} to {number(greatest, 'share')}"


def tracker_row(board: Board, dataset: DatasetBoard, table: Table, row: TrackerRow) -> dict[str, Any]:
    """The row of a tracker in a table of all pairs of a pair set, or in a total."""
    metric, label = board.metric, row.method.label
    return {
        "set": dataset.entry.title,
        "table": table_title(table),
        "count": table.pairs,
        "method": label,
        "method_page": links.method_page(label),
        "baseline": row.method.is_baseline,
        "marks": marks_of(row.method),
        "finer": metric.name in table.finer,
        **_of_row(row, table.rows),
        **_number(row.values[metric.name], row.intervals.get(metric.name), metric.unit),
        **_linked(links.set_page(dataset.entry.record), {"table": table_title(table), "method": label}, "pairs"),
    }


def query_rows(
    pages: QueryPages[Any, Any, Any, Any],
    board: QueryBoard[Any, Any, Any, Any],
    lines: Iterable[Line[Any, Any, Row[Any]]],
) -> list[dict[str, Any]]:
    """The rows of lines of the tables of a task that is asked by queries; what chance scores has one too."""
    column = pages.display.columns(board)[board.metric]
    rows = []
    for line in lines:
        row, state = line.row, {"table": line.table.name}
        label = CHANCE if row is None else row.method.label
        bounds = None if column.bounds is None else column.bounds(line)
        rows.append(
            {
                "set": line.set.title,
                "table": line.table.name,
                "count": line.table.queries,
                "method": label,
                "method_page": links.method_page(label) if row is not None and pages.has_method_pages else "",
                "baseline": row is None or pages.is_baseline(row.method),
                "marks": [] if row is None else pages.marks(row, line.table),
                "finer": False,
                **_of_row(row, line.table.rows),
                **_number(column.value(line), bounds, column.unit),
                **_linked(
                    links.set_page(line.set.record, pages.page),
                    state if row is None else {**state, "method": label},
                    "queries",
                ),
            }
        )
    return rows


def _first(pages: QueryPages[Any, Any, Any, Any], tables: Iterable[Any]) -> list[Any]:
    """The tables that a reader looks at first; the others are on the page of the set."""
    several = any(table.name.startswith("mean ") for table in tables)
    return [table for table in tables if not several or pages.is_first(table)]


def _of_row(row: Row[Any] | None, rows: Iterable[Row[Any]]) -> dict[str, Any]:
    """The rank as text and what sorts by it, what is missing, and how many answers were declined and crashed."""
    if row is None:
        return {"rank": "", "order": _LAST, "missing": [], "failed": None, "broke": None}
    return {
        "rank": rank_text(row, rows),
        "order": _LAST if row.rank is None else row.rank,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
    }


def _number(value: Any, interval: Interval | None, unit: str) -> dict[str, str]:
    """A value as text, what sorts by it, and its interval."""
    bounds = "" if interval is None else f"[{number(interval.low, unit)}, {number(interval.high, unit)}]"
    return {"value": number(value, unit), "sort": "" if value is None else repr(float(value)), "bounds": bounds}


def _linked(page: str, state: dict[str, str], units: str) -> dict[str, str]:
    """The page of a set, and the link to the list of a method's pairs or queries on it."""
    return {"page": page, "link": f"{page}#{links.hash_of(state)}&{units}=1"}


def _notes(title: str, table: str, no_ranks: str, gain: str) -> list[str]:
    """What a reader of a table must know besides its numbers, without what is empty."""
    return [f"{title}, {table}: {note}" for note in (no_ranks, gain[:1].lower() + gain[1:]) if note]
