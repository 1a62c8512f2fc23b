"""``TASK.csv`` of a chain: one row for each query, with what was retrieved, the tracker's answer and its errors."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import STATUSES
from relocbench.files import atomic_write, parse_count, parse_floats, parse_timestamp, read_table
from relocbench.metrics import PoseErrors

Outcome = Literal["right", "choice", "unreachable", "retrieval", "tracking"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
"""The outcome of a query, where the chain kept the answer against one of K retrieved keyframes:

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
class ChainAnswer:
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


def errors_of(answers: Sequence[ChainAnswer]) -> PoseErrors:
    """The errors of the rows, as arrays."""
    return PoseErrors(
        rotation_error_deg=np.array([a.rotation_error_deg for a in answers], dtype=np.float64),
        translation_error_m=np.array([a.translation_error_m for a in answers], dtype=np.float64),
        mlad_translation_error_m=np.array([a.mlad_translation_error_m for a in answers], dtype=np.float64),
    )


def write_chain(path: Path, answers: Sequence[ChainAnswer]) -> None:
    """Write ``TASK.csv``, in the order given."""
    with atomic_write(path) as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for a in answers:
            values = [getattr(a, name) for name in COLUMNS]
            table.writerow(["" if v is None else repr(v) if isinstance(v, float) else v for v in values])


def read_chain(path: Path) -> list[ChainAnswer]:
    """Read ``TASK.csv``.

    Raises:
        PredictionError: with file and line: wrong columns, an invalid status, outcome or number, or a query twice.
    """
    out: dict[int, ChainAnswer] = {}
    for number, row in read_table(path, COLUMNS, error=PredictionError):
        answer = _answer(dict(zip(COLUMNS, row, strict=True)), path, number)
        if answer.query_timestamp_ns in out:
            raise PredictionError(f"query {answer.query_timestamp_ns} occurs again", path, number)
        out[answer.query_timestamp_ns] = answer
    return list(out.values())


def _answer(field: dict[str, str], path: Path, line: int) -> ChainAnswer:
    if field["status"] not in STATUSES:
        raise PredictionError(f"status is '{field['status']}', expected {', '.join(STATUSES)}", path, line)
    outcome = next((known for known in OUTCOMES if known == field["outcome"]), None)
    if outcome is None:
        raise PredictionError(f"outcome is '{field['outcome']}', expected {', '.join(OUTCOMES)}", path, line)
    counts: dict[str, int | None] = {}
    for name in _INTEGERS:
        counts[name] = parse_count(field[name], name, path, line, PredictionError) if field[name] else None

    def value(name: str) -> float | None:
        return parse_floats([field[name]], path, line, name, PredictionError)[0] if field[name] else None

    errors = {n: math.inf if field[n] == "inf" else value(n) for n in COLUMNS if "_error_" in n}
    if None in errors.values():
        raise PredictionError("an error is blank, expected a number or inf", path, line)
    if any(error is not None and error < 0 for error in errors.values()):
        raise PredictionError("an error is negative, expected at least 0, or inf", path, line)
    ref = field["ref_timestamp_ns"]
    return ChainAnswer(
        query_timestamp_ns=parse_timestamp(field["query_timestamp_ns"], path, line, PredictionError),
        status=field["status"],
        outcome=outcome,
        ref_timestamp_ns=parse_timestamp(ref, path, line, PredictionError) if ref else None,
        rank=counts["rank"],
        hit_rank=counts["hit_rank"],
        right_rank=counts["right_rank"],
        asked=counts["asked"] or 0,
        **{name: float(error) for name, error in errors.items() if error is not None},
        confidence=value("confidence"),
        seconds=value("seconds"),
        message=field["message"],
    )
