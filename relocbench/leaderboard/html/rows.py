"""The tables of the start page and of the pages of methods: one honest number of each method, with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from relocbench.evaluation.common.matching_table import ALL
from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.payloads import id_of, is_floor, marks_of, table_title
from relocbench.leaderboard.relocalization.board import ChainBoard
from relocbench.leaderboard.relocalization.page import marks_of_chain
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.tracking.cells import level_with_floor, share_a_rank, without_intervals
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import Interval


@dataclass(frozen=True)
class Boards:
    """What results hold, one board a task; None where there is nothing of it."""

    tracking: Board | None = None
    retrieval: RetrievalBoard | None = None
    relocalization: ChainBoard | None = None


def sections(boards: Boards) -> list[dict[str, Any]]:
    """The tables of the start page: one for each task."""
    sections = []
    board = boards.tracking
    if board is not None:
        rows = [line(board, d, table, row) for d in board.datasets for table in d.totals for row in table.rows]
        notes = [note for d in board.datasets for table in d.totals for note in _notes(board, d, table)]
        section = {"title": "Trackers", "metric": board.metric.name, "what": "pairs", "rows": rows, "notes": notes}
        sections.append(section)
    if boards.retrieval is not None:
        found, metric = [], boards.retrieval.metric
        for asked in boards.retrieval.sets:
            for table in asked.tables:
                for row in table.rows:
                    found.append(_other(asked.title, table, row.method.label, row, metric))
                found.append(_chance(asked.title, table, metric))
        sections.append({"title": "Retrievers", "metric": metric, "what": "queries", "rows": found})
    if boards.relocalization is not None:
        found, metric = [], boards.relocalization.metric
        for chains in boards.relocalization.sets:
            for chained in chains.tables:
                for link in chained.rows:
                    found.append(
                        {**_other(chains.title, chained, link.chain.label, link, metric), "marks": marks_of_chain(link)}
                    )
        sections.append({"title": "Retrieval, then tracking", "metric": metric, "what": "queries", "rows": found})
    return sections


def line(board: Board, dataset: DatasetBoard, table: Table, row: Row) -> dict[str, Any]:
    metric, value = board.metric, row.values[board.metric.name]
    state = {"table": table_title(table), "method": row.method.label}
    return {
        "set": dataset.entry.title,
        "page": links.set_page(id_of(dataset)),
        "table": table_title(table),
        "count": table.pairs,
        "method": row.method.label,
        "method_page": links.method_page(row.method.label),
        "floor": is_floor(row.method),
        "marks": marks_of(row.method),
        "rank": row.rank,
        "value": number(value, metric.unit),
        "sort": "" if value is None else repr(float(value)),
        "bounds": _bounds(row.intervals.get(metric.name), metric.unit),
        "finer": metric.name in table.finer,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
        "link": f"{links.set_page(id_of(dataset))}#{links.hash_of(state)}" if table.group == ALL else "",
    }


def _other(title: str, table: Any, label: str, row: Any, metric: str) -> dict[str, Any]:
    value = row.values.get(metric)
    return {
        "set": title,
        "page": "",
        "table": table.name,
        "count": table.queries,
        "method": label,
        "method_page": "",
        "floor": False,
        "marks": [],
        "rank": row.rank,
        "value": number(value, "share"),
        "sort": "" if value is None else repr(float(value)),
        "bounds": _bounds(row.intervals.get(metric), "share"),
        "finer": False,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
        "link": "",
    }


def _chance(title: str, table: Any, metric: str) -> dict[str, Any]:
    """What a random order of the gallery scores."""
    value = float(table.chance[metric])
    same = dict.fromkeys(("page", "method_page", "link", "bounds"), "")
    return same | {
        "set": title,
        "table": table.name,
        "count": table.queries,
        "method": "(chance)",
        "floor": True,
        "marks": [],
        "rank": None,
        "value": number(value, "share"),
        "sort": repr(value),
        "finer": False,
        "missing": [],
        "failed": None,
        "broke": None,
    }


def _notes(board: Board, dataset: DatasetBoard, table: Table) -> list[str]:
    """What a reader of a total must know besides its numbers."""
    where = f"{dataset.entry.title}, {table_title(table)}"
    told = []
    if without_intervals(board, table):
        told.append(f"{where}: too few pairs for intervals, so that all methods share a rank")
    elif share_a_rank(table.rows):
        told.append(f"{where}: no method is shown to be better than another, and all share a rank")
    level = level_with_floor(dataset, table)
    if level:
        told.append(f"{where}: not shown to be better than the floor: {', '.join(level)}")
    return told


def _bounds(interval: Interval | None, unit: str) -> str:
    return "" if interval is None else f"[{number(interval.low, unit)}, {number(interval.high, unit)}]"
