"""``PAIRSET.csv``: how a tracker's answers came about, a row for each."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from relocbench.datasets.core.pairfile import PairKey, may_be_among
from relocbench.evaluation.tables.schema import COUNT, NUMBER, SECONDS, STATUS, TEXT, PairRecord, Schema, or_blank


@dataclass(frozen=True)
class Answer(PairRecord):
    """How the answer to one pair came about; the pose itself is in the prediction file."""

    status: Annotated[str, STATUS]
    seconds: Annotated[float | None, SECONDS] = None
    """wall-clock time of the tracker alone, after reading the images and preparing the reference"""
    confidence: Annotated[float | None, NUMBER] = None
    message: Annotated[str, TEXT] = ""
    info: Annotated[str, TEXT] = ""
    """JSON object with whatever else the method reported"""
    peak_memory_bytes: Annotated[int | None, or_blank(COUNT)] = None
    """the most resident memory of the method's process until this answer, as the evaluator measured it"""


ANSWERS = Schema(Answer, last_optional=True)


def read_answers(path: Path, only: Container[PairKey] | None = None) -> dict[PairKey, Answer]:
    """Read ``PAIRSET.csv``.

    Args:
        only: the pairs whose rows are read and checked, if not all are; much faster where they are few.

    Raises:
        PredictionError: with file and line: a wrong header, a field that cannot be read, a pair that occurs twice.
    """
    keep = None if only is None else partial(may_be_among, only)
    return {answer.key: answer for answer in ANSWERS.read(path, keep)}
