"""The table of how each answer of a method came about: ``PAIRSET.csv``."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

from relocbench.datasets.core.pairfile import PairKey, may_be_among
from relocbench.evaluation.tables.schema import NUMBER, SECONDS, STATUS, TEXT, PairRecord, Schema


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


ANSWERS = Schema(Answer)


def write_answers(path: Path, answers: Sequence[Answer]) -> None:
    """Write ``PAIRSET.csv``, in the order given."""
    ANSWERS.write(path, answers)


def read_answers(path: Path, only: Container[PairKey] | None = None) -> dict[PairKey, Answer]:
    """Read ``PAIRSET.csv``.

    Args:
        only: the pairs whose rows are read and checked, if not all are; much faster where they are few.

    Raises:
        PredictionError: with file and line: a wrong header, a field that cannot be read, a pair that occurs twice.
    """
    keep = None if only is None else partial(may_be_among, only)
    return {answer.key: answer for answer in ANSWERS.read(path, keep)}
