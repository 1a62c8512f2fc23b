"""The table of how each answer of a method came about: ``PAIRSET.csv``."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.core.pairfile import PairKey, may_be_among
from relocbench.evaluation.common.tables import (
    KEY_COLUMNS,
    STATUSES,
    TableRow,
    float_text,
    is_duration,
    read_chunks,
    seconds_text,
    write_rows,
)
from relocbench.files import quick_counts, quick_floats

ANSWER_COLUMNS = (*KEY_COLUMNS, "status", "seconds", "confidence", "message", "info")


@dataclass(frozen=True)
class Answer:
    """How the answer to one pair came about; the pose itself is in the prediction file."""

    key: PairKey
    status: str
    seconds: float | None = None
    """wall-clock time of the tracker alone, after reading the images and preparing the reference"""
    confidence: float | None = None
    message: str = ""
    info: str = ""
    """JSON object with whatever else the method reported"""


def write_answers(path: Path, answers: Sequence[Answer]) -> None:
    """Write ``PAIRSET.csv``, in the order given."""
    rows = ([*a.key, a.status, seconds_text(a.seconds), float_text(a.confidence), a.message, a.info] for a in answers)
    write_rows(path, [ANSWER_COLUMNS, *rows])


def read_answers(path: Path, only: Container[PairKey] | None = None) -> dict[PairKey, Answer]:
    """Read ``PAIRSET.csv``.

    Args:
        only: the pairs whose rows are read and checked, if not all are; much faster where they are few.

    Raises:
        PredictionError: with file and line: a wrong header, a field that cannot be read, a pair that occurs twice.
    """
    out: dict[PairKey, Answer] = {}
    for lines, rows in read_chunks(path, ANSWER_COLUMNS):
        if only is not None:
            kept = [place for place, row in enumerate(rows) if may_be_among(only, row)]
            lines, rows = [lines[place] for place in kept], [rows[place] for place in kept]
        if not rows:
            continue
        usual = _fast(list(zip(*rows, strict=True)))
        if usual is not None and len(out.keys() | {answer.key for answer in usual}) == len(out) + len(usual):
            out.update((answer.key, answer) for answer in usual)
        else:
            _add_one_by_one(out, path, lines, rows)
    return out


def _fast(columns: Sequence[Sequence[str]]) -> list[Answer] | None:
    """The answers of whole columns; None where a field needs a closer look."""
    reference_ns, query_ns = quick_counts(columns[0]), quick_counts(columns[1])
    statuses, messages, infos = columns[2], columns[5], columns[6]
    seconds, confidences = _quick_optional(columns[3]), _quick_optional(columns[4])
    if reference_ns is None or query_ns is None or seconds is None or confidences is None:
        return None
    if not set(statuses) <= set(STATUSES) or not all(time is None or is_duration(time) for time in seconds):
        return None
    pairs = zip(reference_ns, query_ns, strict=True)
    return list(map(Answer, pairs, statuses, seconds, confidences, messages, infos))


def _quick_optional(texts: Sequence[str]) -> list[float | None] | None:
    """Numbers, None for a blank field; None altogether where one of them is not plainly good."""
    values = quick_floats([text or "0" for text in texts])
    return None if values is None else [value if text else None for text, value in zip(texts, values, strict=True)]


def _add_one_by_one(
    out: dict[PairKey, Answer], path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]]
) -> None:
    """Add answers field by field. Raises PredictionError with the line."""
    for line, fields in zip(lines, rows, strict=True):
        row = TableRow(path, line, dict(zip(ANSWER_COLUMNS, fields, strict=True)))
        key = row.key()
        if key in out:
            raise row.fault(f"pair {key[0]} {key[1]} occurs again")
        seconds, confidence = row.seconds_or_none(), row.number_or_none("confidence")
        out[key] = Answer(key, row.status(), seconds, confidence, row["message"], row["info"])
