"""The pages of retrieval sets: their tables and the words on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.retrieval.records import SetRecord, TaskRecord
from relocbench.evaluation.retrieval.rescoring import RetrievalTruth
from relocbench.leaderboard.common.by_query import Table
from relocbench.leaderboard.common.model import Row
from relocbench.leaderboard.displays import RETRIEVAL
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.query_pages import QueryPages
from relocbench.leaderboard.html.query_tables import ANSWER_COLUMNS, columns_payload, table_payload, view_of
from relocbench.leaderboard.html.retrieval_pages.queries import RankedQueries
from relocbench.leaderboard.retrieval.board import RetrievalBoard, RetrievalSetBoard, RetrievalTable, Retriever, is_part
from relocbench.leaderboard.retrieval.columns import CHANCE, PAGE, RetrievalColumn, lines_of, retrieval_columns
from relocbench.leaderboard.retrieval.page import not_above_chance
from relocbench.leaderboard.tracking.marks import made_elsewhere

_LIST = (
    {"key": "task", "title": "task", "kind": "text"},
    {"key": "query", "title": "query", "kind": "link"},
    {"key": "group", "title": "place", "kind": "text", "optional": True},
    {"key": "first", "title": "first right rank", "kind": "rank"},
    {"key": "positives", "title": "right images", "kind": "rank"},
    {"key": "distance_m", "title": "first keyframe, m", "kind": "m", "optional": True},
)


class RetrievalPages(QueryPages[SetRecord, TaskRecord, Retriever, RetrievalTruth]):
    """The pages of retrievers."""

    display = RETRIEVAL
    title = "Retrievers"
    page = "retrieval"
    charts = ("recall",)
    query_page = links.QUERY_PAGE
    folders = ("retrieval", "ranks", "lists")
    has_method_pages = True

    def queries(self, of: RetrievalSetBoard, task: str) -> RankedQueries:
        return RankedQueries(of, task)

    def facts(self, of: RetrievalSetBoard) -> dict[str, object]:
        return {
            "task": "retrieval",
            "fingerprint": of.record.fingerprint[:SHORT],
            **({"right are": of.record.positives} if of.record.positives else {}),
            "tasks": len(of.used),
        }

    def is_baseline(self, method: Retriever) -> bool:
        return method.is_baseline

    def marks(self, row: Row[Retriever], table: Table[Retriever, TaskRecord]) -> list[str]:
        return _marks(row.method)

    def involves(self, method: Retriever, label: str) -> bool:
        return method.label == label

    def note(self, board: RetrievalBoard, table: RetrievalTable) -> str:
        at_chance = ", ".join(row.method.label for row in table.rows if not_above_chance(board, table, row))
        return f"No significant gain over chance: {at_chance}" if at_chance else ""

    def is_first(self, table: RetrievalTable) -> bool:
        """Single tasks too where their directions are not to be mixed up."""
        across_views = any(record.view_query != record.view_gallery for record in table.records)
        return super().is_first(table) or (across_views and len(table.tasks) == 1 and "__" not in table.name)

    def payload(self, board: RetrievalBoard, of: RetrievalSetBoard) -> dict[str, Any]:
        record, columns = of.record, retrieval_columns(board)
        return {
            "id": links.set_id(record),
            "title": of.title,
            "ranking": board.metric,
            "unit": "query",
            "units": "queries",
            "page": {"file": links.QUERY_PAGE, "task": "task", "unit": "query", "method": "method"},
            "worst": "first",
            "list": [*_LIST, *ANSWER_COLUMNS],
            "columns": columns_payload(columns, view_of(PAGE)),
            "heat": ["query", "gallery"],
            "least_cells": 1,
            "radius_m": radius if isinstance(radius := record.options.get("radius"), float | int) else None,
            "methods": {
                m.label: {"baseline": m.is_baseline, "competes": not m.is_baseline, "marks": _marks(m)}
                for m in of.methods
            },
            "tasks": {name: _task(record, name) for name in of.used},
            "tables": [self._table(board, of, table, columns) for table in of.tables],
        }

    def _table(
        self,
        board: RetrievalBoard,
        of: RetrievalSetBoard,
        table: RetrievalTable,
        columns: Mapping[str, RetrievalColumn],
    ) -> dict[str, Any]:
        several, without = len(table.tasks) > 1, sum(r.without_positives for r in table.records)
        about = f"Mean over {len(table.tasks)} tasks" if several else table.records[0].direction
        about += f". {table.queries} queries, {sum(r.gallery for r in table.records)} images in the galler"
        about += "ies." if several else "y."
        if without:
            about += f" {without} queries have no right image in the gallery, and count as not found."
        return table_payload(
            table,
            {"methods": view_of(PAGE)},
            columns,
            [(CHANCE if line.row is None else line.row.method.label, line) for line in lines_of(of, table)],
            metric=board.metric,
            about=about,
            note=self.note(board, table),
        )


def _marks(method: Retriever) -> list[str]:
    marks = ["trivial baseline"] if method.is_baseline else []
    return [*marks, *(["made elsewhere"] if made_elsewhere(method.run) else [])]


def _task(record: SetRecord, name: str) -> dict[str, Any]:
    task = record.tasks[name]
    return {
        "answers": links.unit_key("ranks", record, name),
        "details": links.unit_key("lists", record, name),
        "query": _shown_as(task, task.view_query, task.condition_query),
        "gallery": _shown_as(task, task.view_gallery, task.condition_gallery),
        "has_conditions": bool(task.condition_query or task.condition_gallery),
        "part_of": name.rpartition("__")[0] if is_part(name, record.tasks) else None,
    }


def _shown_as(task: TaskRecord, view: str, condition: str) -> str:
    """Queries or a gallery in words: their condition, and their view where the two differ in it."""
    return ", ".join(filter(None, [view if task.view_query != task.view_gallery else "", condition])) or view
