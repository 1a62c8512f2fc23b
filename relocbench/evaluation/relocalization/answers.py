"""``TASK.csv`` of a pipeline: one row for each query, with what was retrieved, the tracker's answer and its errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from relocbench.evaluation.common.tables import TableRow, read_rows, write_rows
from relocbench.metrics import PoseErrors

Outcome = Literal["right", "choice", "unreachable", "retrieval", "tracking"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""The outcome of a query, where the pipeline kept the answer against one of K retrieved keyframes:

- ``right``: the kept answer is right.
- ``choice``: another of the K answers was right.
- ``unreachable``: no true pose is known against the keyframe of the kept answer.
- ``retrieval``: none of the K keyframes is in the tracker's basin.
- ``tracking``: one of them is, but the tracker failed.
"""
COLUMNS = (
    "query_timestamp_ns",
    "status",
    "outcome",
    "ref_timestamp_ns",
    "rank",
    "hit_rank",
    "right_rank",
    "asked",
    "rotation_error_deg",
    "translation_error_m",
    "mlad_translation_error_m",
    "confidence",
    "seconds",
    "message",
)
_INTEGERS = ("rank", "hit_rank", "right_rank", "asked")


@dataclass(frozen=True)
class PipelineAnswer:
    """A row of ``TASK.csv``."""

    query_timestamp_ns: int
    status: str
    """``ok``; ``failed``: no answer, or nothing retrieved; ``error``: no answer because one of the methods broke"""
    outcome: Outcome
    ref_timestamp_ns: int | None = None
    """keyframe of the answer that was kept"""
    rank: int | None = None
    """1-based rank of that keyframe"""
    hit_rank: int | None = None
    """1-based rank of the first keyframe in the basin, among those that the tracker was run against"""
    right_rank: int | None = None
    """1-based rank of the first keyframe against which the answer was right"""
    asked: int = 0
    """number of keyframes that the tracker was run against"""
    rotation_error_deg: float = math.inf
    translation_error_m: float = math.inf
    mlad_translation_error_m: float = math.inf
    confidence: float | None = None
    seconds: float | None = None
    """of retrieval and all K runs of the tracker together"""
    message: str = ""


def errors_of(answers: Sequence[PipelineAnswer]) -> PoseErrors:
    """The errors of the rows, as arrays."""
    return PoseErrors(
        rotation_error_deg=np.array([a.rotation_error_deg for a in answers], dtype=np.float64),
        translation_error_m=np.array([a.translation_error_m for a in answers], dtype=np.float64),
        mlad_translation_error_m=np.array([a.mlad_translation_error_m for a in answers], dtype=np.float64),
    )


def write_pipeline(path: Path, answers: Sequence[PipelineAnswer]) -> None:
    """Write ``TASK.csv``, in the order given."""
    values = ([getattr(a, name) for name in COLUMNS] for a in answers)
    texts = (["" if v is None else repr(v) if isinstance(v, float) else v for v in row] for row in values)
    write_rows(path, [COLUMNS, *texts])


def read_pipeline(path: Path) -> list[PipelineAnswer]:
    """Read ``TASK.csv``.

    Raises:
        PredictionError: with file and line: wrong columns, an invalid status, outcome or number, or a query twice.
    """
    out: dict[int, PipelineAnswer] = {}
    for row in read_rows(path, COLUMNS):
        answer = _answer(row)
        if answer.query_timestamp_ns in out:
            raise row.fault(f"query {answer.query_timestamp_ns} occurs again")
        out[answer.query_timestamp_ns] = answer
    return list(out.values())


def _answer(row: TableRow) -> PipelineAnswer:
    status = row.status()
    outcome = next((known for known in OUTCOMES if known == row["outcome"]), None)
    if outcome is None:
        raise row.fault(f"outcome is '{row['outcome']}', expected {', '.join(OUTCOMES)}")
    rank, hit_rank, right_rank, asked = (row.count(name) if row[name] else None for name in _INTEGERS)
    return PipelineAnswer(
        query_timestamp_ns=row.timestamp("query_timestamp_ns"),
        status=status,
        outcome=outcome,
        ref_timestamp_ns=row.timestamp("ref_timestamp_ns") if row["ref_timestamp_ns"] else None,
        rank=rank,
        hit_rank=hit_rank,
        right_rank=right_rank,
        asked=asked or 0,
        rotation_error_deg=row.error("rotation_error_deg"),
        translation_error_m=row.error("translation_error_m"),
        mlad_translation_error_m=row.error("mlad_translation_error_m"),
        confidence=row.number_or_none("confidence"),
        seconds=row.seconds_or_none(),
        message=row["message"],
    )
