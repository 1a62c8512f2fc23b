"""The tables of the start page and of the pages of methods: one honest number of each method, with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from relocbench.evaluation.tables.matching import ALL
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.common import ranks
from relocbench.leaderboard.common.ranks import HasRank, rank_text
from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.payloads import id_of, marks_of, table_title
from relocbench.leaderboard.html.pipeline_pages.payloads import id_of_pipelines, is_keyframe_pose, marks_of_row
from relocbench.leaderboard.html.retrieval_pages.payloads import id_of_places, is_random, marks_of_retriever
from relocbench.leaderboard.relocalization.board import PipelineBoard, PipelineRow, PipelineSetBoard, PipelineTable
from relocbench.leaderboard.retrieval.board import (
    RetrievalBoard,
    RetrievalRow,
    RetrievalSetBoard,
    RetrievalTable,
    chance_of,
)
from relocbench.leaderboard.retrieval.columns import CHANCE
from relocbench.leaderboard.retrieval.page import not_above_chance
from relocbench.leaderboard.tracking.cells import level_with_identity, why_no_ranks
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import Interval

_MEAN = "mean "
"""begins the names of tables over several tasks that are not of some conditions or views alone"""


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
        sections.append(_retrievers(boards.retrieval))
    if boards.relocalization is not None:
        sections.append(_pipelines(boards.relocalization))
    return sections


def _retrievers(board: RetrievalBoard) -> dict[str, Any]:
    """The means of each set, and the single tasks of one whose directions are not to be mixed up."""
    rows, notes = [], []
    for asked in board.sets:
        for table in asked.tables:
            if not _is_first(table, asked.tables, across_views=_across_views(table)):
                continue
            rows += [retriever_line(board, asked, table, row) for row in table.rows]
            rows.append(_chance(asked, table, board.metric))
            if why := ranks.why_no_ranks(table.rows, board.metric, f"{table.queries} queries"):
                notes.append(f"{asked.title}, {table.name}: {why}")
            level = [row.method.label for row in table.rows if not_above_chance(board, table, row)]
            if level:
                notes.append(f"{asked.title}, {table.name}: no significant gain over chance: {', '.join(level)}")
    return {"title": "Retrievers", "metric": board.metric, "what": "queries", "rows": rows, "notes": notes}


def _pipelines(board: PipelineBoard) -> dict[str, Any]:
    """The means of each dataset."""
    first = [(asked, table) for asked in board.sets for table in asked.tables if _is_first(table, asked.tables)]
    rows = [pipeline_line(board, asked, table, row) for asked, table in first for row in table.rows]
    notes = [
        f"{asked.title}, {table.name}: {why}"
        for asked, table in first
        if (why := ranks.why_no_ranks(table.rows, board.metric, f"{table.queries} queries"))
    ]
    return {
        "title": "Full pipeline: retrieval, then tracking",
        "metric": board.metric,
        "what": "queries",
        "rows": rows,
        "notes": notes,
    }


def _is_first(table: Any, tables: Sequence[Any], *, across_views: bool = False) -> bool:
    """Whether a table is one of those that a reader looks at first; the others are on the page of the set."""
    if not any(other.name.startswith(_MEAN) for other in tables):
        return True
    return bool(table.name.startswith(_MEAN)) or (across_views and len(table.tasks) == 1 and "__" not in table.name)


def _across_views(table: RetrievalTable) -> bool:
    return any(record.view_query != record.view_gallery for record in table.records)


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
        "baseline": row.method.is_baseline,
        "marks": marks_of(row.method),
        **_ranked(row, table),
        "value": number(value, metric.unit),
        "sort": "" if value is None else repr(float(value)),
        "bounds": _bounds(row.intervals.get(metric.name), metric.unit),
        "finer": metric.name in table.finer,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
        "link": f"{links.set_page(id_of(dataset))}#{links.hash_of(state)}&pairs=1" if table.group == ALL else "",
    }


def retriever_line(
    board: RetrievalBoard, asked: RetrievalSetBoard, table: RetrievalTable, row: RetrievalRow
) -> dict[str, Any]:
    """The row of a retriever in a table of a retrieval set."""
    method = row.method
    page = links.retrieval_page(id_of_places(asked))
    own = {"page": page, "method_page": links.method_page(method.label), "baseline": is_random(method)}
    state = {"table": table.name, "method": method.label}
    marks = marks_of_retriever(method)
    return _other(asked.title, table, method.label, row, board.metric) | own | _linked(page, state) | {"marks": marks}


def pipeline_line(
    board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable, row: PipelineRow
) -> dict[str, Any]:
    """The row of a pipeline in a table of a dataset."""
    page = links.relocalization_page(id_of_pipelines(asked))
    own = {"page": page, "baseline": is_keyframe_pose(row.method), "marks": marks_of_row(row, table)}
    state = {"table": table.name, "method": row.method.label}
    return _other(asked.title, table, row.method.label, row, board.metric) | own | _linked(page, state)


def _linked(page: str, state: dict[str, str]) -> dict[str, str]:
    return {"link": f"{page}#{links.hash_of(state)}&queries=1"}


def _other(title: str, table: Any, label: str, row: Any, metric: str) -> dict[str, Any]:
    value = row.values.get(metric)
    return {
        "set": title,
        "table": table.name,
        "count": table.queries,
        "method": label,
        "method_page": "",
        **_ranked(row, table),
        "value": number(value, "share"),
        "sort": "" if value is None else repr(float(value)),
        "bounds": _bounds(row.intervals.get(metric), "share"),
        "finer": False,
        "missing": list(row.missing),
        "failed": row.failed,
        "broke": row.broke,
    }


def _chance(asked: RetrievalSetBoard, table: RetrievalTable, metric: str) -> dict[str, Any]:
    """What a random order of the gallery scores."""
    value = float(chance_of(table)[metric])
    page = links.retrieval_page(id_of_places(asked))
    return (
        dict.fromkeys(("method_page", "bounds"), "")
        | _linked(page, {"table": table.name})
        | {
            "set": asked.title,
            "page": page,
            "table": table.name,
            "count": table.queries,
            "method": CHANCE,
            "baseline": True,
            "marks": [],
            "rank": "",
            "order": 1_000_000,
            "value": number(value, "share"),
            "sort": repr(value),
            "finer": False,
            "missing": [],
            "failed": None,
            "broke": None,
        }
    )


def _notes(board: Board, dataset: DatasetBoard, table: Table) -> list[str]:
    """What a reader of a total must know besides its numbers."""
    where = f"{dataset.entry.title}, {table_title(table)}"
    notes = [f"{where}: {why}"] if (why := why_no_ranks(board, table)) else []
    level = level_with_identity(dataset, table)
    if level:
        notes.append(f"{where}: no significant gain over the identity baseline: {', '.join(level)}")
    return notes


def _ranked(row: HasRank, table: Any) -> dict[str, Any]:
    """The rank as text, and what sorts by it."""
    return {"rank": rank_text(row, table.rows), "order": 1_000_000 if row.rank is None else row.rank}


def _bounds(interval: Interval | None, unit: str) -> str:
    return "" if interval is None else f"[{number(interval.low, unit)}, {number(interval.high, unit)}]"
