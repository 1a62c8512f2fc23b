"""What the page of a dataset's pipelines shows: its tables, and of every query the errors and where it was lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.evaluation.common.tables import STATUSES
from relocbench.evaluation.relocalization.answers import OUTCOMES, PipelineAnswer
from relocbench.evaluation.relocalization.pipeline import RIGHT
from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE, PipelineTask
from relocbench.evaluation.relocalization.score import FAILURES, HIT
from relocbench.leaderboard.common.columns import Line
from relocbench.leaderboard.common.headings import SECONDS, heading
from relocbench.leaderboard.common.ranks import rank_text, why_no_ranks
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import bytes_of, floats, integers
from relocbench.leaderboard.html.pipeline_pages.stages import retrieval_seconds
from relocbench.leaderboard.relocalization.board import (
    Pipeline,
    PipelineBoard,
    PipelineRow,
    PipelineSetBoard,
    PipelineTable,
)
from relocbench.leaderboard.relocalization.columns import GIVEN_HIT, MEDIANS, POSES, STAGES, basin_words
from relocbench.leaderboard.relocalization.page import marks_of_pipeline
from relocbench.metrics.pose.registry import SIGMA_FACTOR

LOSSES = ("right_and_hit", "right_without_hit", *FAILURES)
"""shares of all queries that add up to one: what is right, and what the others are lost to"""
_NONE = -1
"""in place of a timestamp or a rank that there is none of"""


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
    poses = list(dict.fromkeys((board.metric, *POSES)))
    shares = [*poses, "basin_recall@1", HIT, GIVEN_HIT, "right_among_K", *LOSSES]
    metrics = [(name, "share") for name in dict.fromkeys(shares)]
    metrics += [*zip(MEDIANS, ("m", "deg"), strict=True), (SECONDS, "s")]
    used = [name for name in asked.record.tasks if name in asked.used]
    rows = {row.method.label: row for row in asked.tables[0].rows}
    return {
        "id": id_of_pipelines(asked),
        "title": asked.title,
        "ranking": board.metric,
        "rescored": asked.truth is not None,
        "metrics": [{"name": name, "heading": heading(name, unit), "unit": unit} for name, unit in metrics],
        "shown": [*poses, *MEDIANS, SECONDS],
        "stages": list(STAGES),
        "losses": list(LOSSES),
        "outcomes": list(OUTCOMES),
        "right": list(RIGHT),
        "pipelines": {label: _pipeline(rows[label], asked.tables[0]) for label in sorted(rows)},
        "tasks": {name: _task(asked, name, asked.record.tasks[name], trackers.get(name)) for name in used},
        "tables": [_table(board, asked, table, [name for name, _ in metrics]) for table in asked.tables],
    }


def located_payload(asked: PipelineSetBoard, task: str) -> dict[str, Any]:
    """The answers of all pipelines to the queries of a task, in the order of time."""
    pipelines = {pipeline.label: pipeline for pipeline in asked.methods if task in pipeline.answers}
    first = next(iter(pipelines.values())).answers[task]
    return {
        "queries": integers([a.query_timestamp_ns for a in first]),
        "pipelines": {label: _answers(pipeline, task) for label, pipeline in pipelines.items()},
    }


def _pipeline(row: PipelineRow, table: PipelineTable) -> dict[str, Any]:
    run = row.method.run
    return {
        "retriever": run.retriever,
        "tracker": run.tracker,
        "top": run.top,
        "baseline": is_keyframe_pose(row.method),
        "oracle": run.retriever == ORACLE,
        "marks": marks_of_row(row, table),
    }


def _task(asked: PipelineSetBoard, name: str, task: PipelineTask, trackers: str | None) -> dict[str, Any]:
    sigma = task.median_sigma_translation_m
    return {
        "located": located_key(asked, name),
        "candidates": candidates_key(asked, name),
        "query": task.condition_query,
        "gallery": task.condition_gallery,
        "has_conditions": bool(task.condition_query or task.condition_gallery),
        "trackers": trackers,
        "finest_m": None if sigma is None else SIGMA_FACTOR * sigma,
    }


def _table(board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable, names: Sequence[str]) -> dict[str, Any]:
    return {
        "title": table.name,
        "tasks": list(table.tasks),
        "queries": table.queries,
        "ranks": why_no_ranks(table.rows, board.metric, f"{table.queries} queries"),
        "rows": [_row(asked, row, table, names) for row in table.rows],
    }


def _row(asked: PipelineSetBoard, row: PipelineRow, table: PipelineTable, names: Sequence[str]) -> dict[str, Any]:
    return {
        "method": row.method.label,
        "rank": rank_text(row, table.rows),
        "values": [row.values.get(name) for name in names],
        "intervals": {n: [i.low, i.high] for n in names if (i := row.intervals.get(n)) is not None},
        "basin": basin_words(Line(asked, table, row)),
        "failed": row.failed,
        "broke": row.broke,
        "missing": list(row.missing),
    }


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
        **{name: integers([_or_none(a, name) for a in rows]) for name in ("rank", "hit_rank", "right_rank", "asked")},
        "messages": {row: answer.message for row, answer in enumerate(rows) if answer.message},
    }


def _or_none(answer: PipelineAnswer, name: str) -> int:
    value: int | None = getattr(answer, name)
    return _NONE if value is None else value


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values])
