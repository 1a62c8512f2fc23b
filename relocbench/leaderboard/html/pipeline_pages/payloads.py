"""What the page of a dataset's pipelines shows: its tables, and of every query the errors and where it was lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.evaluation.relocalization.answers import OUTCOMES, PipelineAnswer
from relocbench.evaluation.relocalization.pipeline import RIGHT
from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE, PipelineTask
from relocbench.evaluation.relocalization.score import FAILURES
from relocbench.evaluation.tables.rows import STATUSES
from relocbench.leaderboard.common.columns import Line
from relocbench.leaderboard.common.headings import BASIN, COUNTS
from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import bytes_of, floats, integers
from relocbench.leaderboard.html.pipeline_pages.stages import retrieval_seconds
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
from relocbench.metrics.pose.registry import SIGMA_FACTOR

LOSSES = ("right_and_hit", "right_without_hit", *FAILURES)
"""shares of all queries that add up to one: what is right, and what the others are lost to"""
_NONE = -1
"""in place of the timestamp of a keyframe that there is none of"""
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


def id_of_pipelines(asked: PipelineSetBoard) -> str:
    """The id of a dataset's pipelines in links and names of files."""
    return links.set_id(asked.record.name, asked.record.fingerprint)


def located_key(asked: PipelineSetBoard, task: str) -> str:
    """The key of the payload with the errors of a task's queries."""
    return f"located/{id_of_pipelines(asked)}/{links.pair_set_id(task)}"


def candidates_key(asked: PipelineSetBoard, task: str) -> str:
    """The key of the payload with the keyframes that were retrieved for a task's queries."""
    return f"candidates/{id_of_pipelines(asked)}/{links.pair_set_id(task)}"


def is_keyframe_pose(pipeline: Pipeline) -> bool:
    """Whether a pipeline answers the pose of its first keyframe."""
    return pipeline.run.tracker == KEYFRAME


def marks_of_row(row: PipelineRow, table: PipelineTable) -> list[str]:
    """The words behind the name of a pipeline."""
    pipeline = row.method
    known = {
        "trivial baseline": is_keyframe_pose(pipeline),
        "knows the truth": pipeline.knows_truth,
        "uses times": pipeline.uses_times,
    }
    return [*(word for word, applies in known.items() if applies), *marks_of_pipeline(row, table)]


def pipelines_payload(board: PipelineBoard, asked: PipelineSetBoard, trackers: Mapping[str, str]) -> dict[str, Any]:
    """All tables of a dataset's pipelines.

    Args:
        trackers: task -> the id of the set of trackers whose pairs have pages, where there is one.
    """
    columns = pipeline_columns(board)
    used = [name for name in asked.record.tasks if name in asked.used]
    rows = {row.method.label: row for row in asked.tables[0].rows}
    return {
        "id": id_of_pipelines(asked),
        "title": asked.title,
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
        "methods": {label: _pipeline(rows[label], asked.tables[0]) for label in sorted(rows)},
        "tasks": {name: _task(asked, name, asked.record.tasks[name], trackers.get(name)) for name in used},
        "tables": [_table(board, asked, table, columns) for table in asked.tables],
    }


def located_payload(asked: PipelineSetBoard, task: str) -> dict[str, Any]:
    """The answers of all pipelines to the queries of a task, in the order of time."""
    pipelines = {pipeline.label: pipeline for pipeline in asked.methods if task in pipeline.answers}
    first = next(iter(pipelines.values())).answers[task]
    return {
        "units": {"query": integers([a.query_timestamp_ns for a in first])},
        "methods": {label: _answers(pipeline, task) for label, pipeline in pipelines.items()},
    }


def _pipeline(row: PipelineRow, table: PipelineTable) -> dict[str, Any]:
    run = row.method.run
    return {
        "parts": [run.retriever, run.tracker],
        "top": run.top,
        "baseline": is_keyframe_pose(row.method),
        "oracle": run.retriever == ORACLE,
        "competes": run.retriever != ORACLE and not is_keyframe_pose(row.method),
        "marks": marks_of_row(row, table),
    }


def _task(asked: PipelineSetBoard, name: str, task: PipelineTask, trackers: str | None) -> dict[str, Any]:
    sigma = task.median_sigma_translation_m
    return {
        "answers": located_key(asked, name),
        "details": None if asked.truth is None else candidates_key(asked, name),
        "query": task.condition_query,
        "gallery": task.condition_gallery,
        "has_conditions": bool(task.condition_query or task.condition_gallery),
        "trackers": trackers,
        "finest_m": None if sigma is None else SIGMA_FACTOR * sigma,
    }


def _table(
    board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable, columns: Mapping[str, PipelineColumn]
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
        [(row.method.label, Line(asked, table, row)) for row in table.rows],
        metric=board.metric,
        about=about,
        further=LOSSES,
    )


def _answers(pipeline: Pipeline, task: str) -> dict[str, Any]:
    rows = pipeline.answers[task]
    whole = _numbers([a.seconds for a in rows])
    retrieval = retrieval_seconds(pipeline, task)
    return {
        "translation_error_m": floats([a.translation_error_m for a in rows]),
        "rotation_error_deg": floats([a.rotation_error_deg for a in rows]),
        "confidence": floats(_numbers([a.confidence for a in rows])),
        "seconds": floats(whole),
        "retrieval_seconds": None if retrieval is None else floats(retrieval),
        "status": bytes_of([STATUSES.index(a.status) for a in rows]),
        "outcome": bytes_of([OUTCOMES.index(a.outcome) for a in rows]),
        "keyframe": integers([_NONE if a.ref_timestamp_ns is None else a.ref_timestamp_ns for a in rows]),
        "asked": floats([a.asked for a in rows]),
        **{name: floats([_or_none(a, name) for a in rows]) for name in ("rank", "hit_rank", "right_rank")},
        "messages": {row: answer.message for row, answer in enumerate(rows) if answer.message},
    }


def _or_none(answer: PipelineAnswer, name: str) -> float:
    """A rank; infinite where there is none."""
    value: int | None = getattr(answer, name)
    return np.inf if value is None else value


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values])
