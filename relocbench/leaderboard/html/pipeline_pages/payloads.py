"""The pages of a dataset's pipelines: their tables and the words on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.relocalization.answers import OUTCOMES
from relocbench.evaluation.relocalization.pipeline import RIGHT
from relocbench.evaluation.relocalization.records import ORACLE, PipelineSet, PipelineTask
from relocbench.evaluation.relocalization.rescoring import PipelineTruth
from relocbench.evaluation.relocalization.score import FAILURES
from relocbench.leaderboard.common.columns import Line
from relocbench.leaderboard.common.text import BASIN, COUNTS, number
from relocbench.leaderboard.displays import RELOCALIZATION
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.pipeline_pages.queries import LocatedQueries
from relocbench.leaderboard.html.query_pages import QueryPages
from relocbench.leaderboard.html.query_tables import ANSWER_COLUMNS, columns_payload, table_payload, view_of
from relocbench.leaderboard.relocalization.board import (
    Pipeline,
    PipelineBoard,
    PipelineRow,
    PipelineSetBoard,
    PipelineTable,
)
from relocbench.leaderboard.relocalization.columns import (
    STAGES,
    PipelineColumn,
    pipeline_columns,
    pose_columns,
    stage_columns,
)
from relocbench.leaderboard.relocalization.page import marks_of_pipeline
from relocbench.leaderboard.tracking.model import Board, DatasetBoard
from relocbench.metrics.pose.metric import SIGMA_FACTOR

LOSSES = ("right_and_hit", "right_without_hit", *FAILURES)
"""shares of all queries that add up to one: what is right, and what the others are lost to"""
_LIST = (
    {"key": "task", "title": "task", "kind": "text"},
    {"key": "query", "title": "query, ns", "kind": "link"},
    {"key": "outcome", "title": "outcome", "kind": "outcome"},
    {"key": "translation_error_m", "title": "translation error, m", "kind": "error_m", "higher": False},
    {"key": "rotation_error_deg", "title": "rotation error, °", "kind": "error_deg", "higher": False},
    {"key": "rank", "title": "rank kept", "kind": "rank"},
    {"key": "hit_rank", "title": "first in basin", "kind": "rank"},
    {"key": "right_rank", "title": "first right", "kind": "rank"},
    {"key": "confidence", "title": "confidence", "kind": "number", "higher": True},
)


@dataclass(frozen=True)
class PipelinePages(QueryPages[PipelineSet, PipelineTask, Pipeline, PipelineTruth]):
    """The pages of pipelines."""

    tracking: Board | None = None
    """the trackers of the same results, to whose pairs the page of a query links"""

    display = RELOCALIZATION
    title = "Full pipeline: retrieval, then tracking"
    page = "relocalization"
    charts = ("errors", "stages")
    query_page = links.LOCATED_PAGE
    folders = ("pipelines", "located", "candidates")
    has_method_pages = False

    def queries(self, of: PipelineSetBoard, task: str) -> LocatedQueries:
        return LocatedQueries(of, task)

    def name(self, of: PipelineSetBoard) -> str:
        return of.record.dataset

    def facts(self, of: PipelineSetBoard) -> dict[str, object]:
        return {
            "task": "full pipeline: retrieval, then tracking",
            "fingerprint": of.record.dataset_fingerprint[:SHORT],
            "tasks": len(of.record.tasks),
        }

    def is_baseline(self, method: Pipeline) -> bool:
        return method.is_baseline

    def marks(self, row: PipelineRow, table: PipelineTable) -> list[str]:
        known = {
            "trivial baseline": row.method.is_baseline,
            "knows the truth": row.method.knows_truth,
            "uses times": row.method.uses_times,
        }
        words = [word for word, applies in known.items() if applies]
        return [*words, *marks_of_pipeline(row, table), *filter(None, [row.method.assumes])]

    def involves(self, method: Pipeline, label: str) -> bool:
        return label in (method.run.retriever, method.run.tracker)

    def payload(self, board: PipelineBoard, of: PipelineSetBoard) -> dict[str, Any]:
        columns, first = pipeline_columns(board), of.tables[0]
        rows = sorted(first.rows, key=lambda row: row.method.label)
        return {
            "id": links.set_id(of.record),
            "title": of.title,
            "ranking": board.metric,
            "unit": "query",
            "units": "queries",
            "page": {"file": links.LOCATED_PAGE, "task": "task", "unit": "query", "method": "pipeline"},
            "correct": list(RIGHT),
            "words": {"outcome": list(OUTCOMES)},
            "worst": "both",
            "list": [*_LIST, *ANSWER_COLUMNS],
            "columns": columns_payload(columns, view_of((*pose_columns(board), BASIN, *STAGES, COUNTS))),
            "heat": ["query", "map"],
            "least_cells": 1,
            "losses": list(LOSSES),
            "methods": {row.method.label: self._pipeline(row, first) for row in rows},
            "tasks": {name: self._task(of, name) for name in of.used},
            "tables": [_table(board, of, table, columns) for table in of.tables],
        }

    def _pipeline(self, row: PipelineRow, table: PipelineTable) -> dict[str, Any]:
        run, is_baseline = row.method.run, row.method.is_baseline
        return {
            "parts": [run.retriever, run.tracker],
            "top": run.top,
            "baseline": is_baseline,
            "oracle": run.retriever == ORACLE,
            "competes": run.retriever != ORACLE and not is_baseline,
            "marks": self.marks(row, table),
        }

    def _task(self, of: PipelineSetBoard, name: str) -> dict[str, Any]:
        task, trackers = of.units[name], self._trackers(of.record, name)
        sigma = task.median_sigma_translation_m
        return {
            "answers": links.unit_key("located", of.record, name),
            "details": None if of.truth is None else links.unit_key("candidates", of.record, name),
            "query": task.condition_query,
            "gallery": task.condition_gallery,
            "has_conditions": bool(task.condition_query or task.condition_gallery),
            "trackers": None if trackers is None else links.set_id(trackers.entry.record),
            "finest_m": None if sigma is None else SIGMA_FACTOR * sigma,
        }

    def _trackers(self, record: PipelineSet, task: str) -> DatasetBoard | None:
        """The trackers that were asked the pairs of a task."""
        for dataset in () if self.tracking is None else self.tracking.datasets:
            known = dataset.entry.record
            if (known.name, known.fingerprint) == (record.dataset, record.dataset_fingerprint):
                return dataset if any(task in method.errors for method in dataset.entry.methods) else None
        return None


def _table(
    board: PipelineBoard, of: PipelineSetBoard, table: PipelineTable, columns: Mapping[str, PipelineColumn]
) -> dict[str, Any]:
    about = f"{table.queries} queries."
    if len(table.tasks) > 1:
        about = f"Mean over {len(table.tasks)} tasks, each of which counts the same. {about}"
    sigma = max((r.median_sigma_translation_m or 0.0 for r in table.records), default=0.0)
    if SIGMA_FACTOR * sigma > RIGHT[0]:
        about += f" The truth is too coarse for thresholds below {number(SIGMA_FACTOR * sigma, 'm')} m."
    return table_payload(
        table,
        {"methods": view_of((*pose_columns(board), COUNTS)), "stages": view_of(stage_columns(table))[:-1]},
        columns,
        [(row.method.label, Line(of, table, row)) for row in table.rows],
        metric=board.metric,
        about=about,
        further=LOSSES,
    )
