"""``TASK.csv`` of a pipeline: one row for each query, with what was retrieved, the tracker's answer and its errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np

from relocbench.evaluation.tables.schema import (
    COUNT,
    ERROR,
    NUMBER,
    STATUS,
    TEXT,
    TIMESTAMP,
    Kind,
    Record,
    Schema,
    TableRow,
    float_text,
    one_of,
    or_blank,
)
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
_SECONDS = Kind(TableRow.seconds_or_none, float_text)
"""sums of rounded seconds, with all their digits"""


@dataclass(frozen=True)
class PipelineAnswer(Record):
    """A row of ``TASK.csv``."""

    query_timestamp_ns: Annotated[int, TIMESTAMP]
    status: Annotated[str, STATUS]
    """``ok``; ``failed``: no answer, or nothing retrieved; ``error``: no answer because one of the methods broke"""
    outcome: Annotated[Outcome, one_of(OUTCOMES)]
    ref_timestamp_ns: Annotated[int | None, or_blank(TIMESTAMP)] = None
    """keyframe of the answer that was kept"""
    rank: Annotated[int | None, or_blank(COUNT)] = None
    """1-based rank of that keyframe"""
    hit_rank: Annotated[int | None, or_blank(COUNT)] = None
    """1-based rank of the first keyframe in the basin, among those that the tracker was run against"""
    right_rank: Annotated[int | None, or_blank(COUNT)] = None
    """1-based rank of the first keyframe against which the answer was right"""
    asked: Annotated[int, COUNT] = 0
    """number of keyframes that the tracker was run against"""
    rotation_error_deg: Annotated[float, ERROR] = math.inf
    translation_error_m: Annotated[float, ERROR] = math.inf
    mlad_translation_error_m: Annotated[float, ERROR] = math.inf
    confidence: Annotated[float | None, NUMBER] = None
    seconds: Annotated[float | None, _SECONDS] = None
    """of retrieval and all K runs of the tracker together"""
    message: Annotated[str, TEXT] = ""

    @property
    def named(self) -> str:
        return f"query {self.query_timestamp_ns}"


PIPELINE = Schema(PipelineAnswer)


def errors_of(answers: Sequence[PipelineAnswer]) -> PoseErrors:
    """The errors of the rows, as arrays."""
    return PoseErrors(
        rotation_error_deg=np.array([a.rotation_error_deg for a in answers], dtype=np.float64),
        translation_error_m=np.array([a.translation_error_m for a in answers], dtype=np.float64),
        mlad_translation_error_m=np.array([a.mlad_translation_error_m for a in answers], dtype=np.float64),
    )
