"""``TASK.txt`` and ``TASK.csv``: the retrieved images, and the ranks of each query's positives in the whole ranking."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.common.results import STATUSES
from relocbench.files import (
    atomic_write,
    lines_of,
    parse_count,
    parse_floats,
    plain_file,
    read_table,
    read_text,
    whole_number,
)
from relocbench.metrics import NEVER, Ranking

COLUMNS = ("query", "group", "status", "positives", "ranks", "seconds", "message")


@dataclass(frozen=True)
class QueryAnswer:
    """A row of ``TASK.csv``."""

    query: str
    group: str
    """queries of one group are resampled together; empty along a drive"""
    status: str
    """``ok``; ``failed``: the query has no descriptor, or nothing was retrieved; ``error``: the method broke"""
    positives: int
    """number of positives in the gallery"""
    ranks: tuple[int, ...] = ()
    """1-based ranks of the retrieved positives, ascending, in the whole ranking without junk"""
    seconds: float | None = None
    """of describing and reranking, without reading the image and without the search"""
    message: str = ""


def write_answers(path: Path, answers: Sequence[QueryAnswer]) -> None:
    """Write ``TASK.csv``, in the order given."""
    with atomic_write(path) as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for a in answers:
            seconds = "" if a.seconds is None else repr(round(a.seconds, 6))
            ranks = " ".join(map(str, a.ranks))
            table.writerow([a.query, a.group, a.status, a.positives, ranks, seconds, a.message])


def read_answers(path: Path) -> list[QueryAnswer]:
    """Read ``TASK.csv``.

    Raises:
        PredictionError: with file and line: wrong columns, an invalid status or rank, or a query that occurs twice.
    """
    out: dict[str, QueryAnswer] = {}
    for number, row in read_table(path, COLUMNS, error=PredictionError):
        query, group, status, positives, ranks, seconds, message = row
        if query in out:
            raise PredictionError(f"query '{query}' occurs again", path, number)
        if status not in STATUSES:
            raise PredictionError(f"status is '{status}', expected {', '.join(STATUSES)}", path, number)
        places = _ranks(ranks, path, number)
        count = parse_count(positives, "positives", path, number, PredictionError)
        if count < len(places):
            raise PredictionError(f"{len(places)} ranks of '{count}' positives", path, number)
        took = parse_floats([seconds], path, number, "seconds", PredictionError)[0] if seconds else None
        out[query] = QueryAnswer(query, group, status, count, places, took, message)
    return list(out.values())


def ranking_of(answers: Sequence[QueryAnswer], gallery: int) -> Ranking:
    """Convert the ranks to what the metrics take; ``gallery`` is its size with junk."""
    counts = [a.positives for a in answers]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    position = np.full(int(starts[-1]), NEVER)
    for start, answer in zip(starts, answers, strict=False):
        position[start : start + len(answer.ranks)] = np.array(answer.ranks, dtype=np.int64) - 1
    return Ranking(starts, position, np.array([a.status == "ok" for a in answers], dtype=bool), gallery)


def write_lists(path: Path, lists: Mapping[str, Sequence[str]]) -> None:
    """Write ``TASK.txt``: a line ``query db`` for each retrieved image, best first."""
    with atomic_write(path) as stream:
        for query, retrieved in lists.items():
            stream.writelines(f"{query} {image}\n" for image in retrieved)


def read_lists(path: Path, queries: Mapping[str, int], gallery: Mapping[str, int]) -> dict[str, list[int]]:
    """Read a file of ``query db`` lines: the gallery indices retrieved for each query, best first.

    Args:
        path: the lines of one query need not be adjacent; lines that begin with ``#`` are comments.
        queries, gallery: key -> index.

    Raises:
        PredictionError: with file and line: a line without two words, an unknown query or image, or an image twice for
            one query.
    """
    lists: dict[str, list[int]] = {key: [] for key in queries}
    seen: set[tuple[str, int]] = set()
    text = read_text(path, "retrieved images, a line 'query db' each", PredictionError)
    for number, line in enumerate(lines_of(text), start=1):
        words = line.split()
        if not words or line.startswith("#"):
            continue
        if len(words) != 2:
            raise PredictionError(f"expected 'query db', found {len(words)} words", path, number)
        query, image = words
        if query not in queries:
            raise PredictionError(
                f"unknown query '{query}'; queries have names such as '{next(iter(queries))}'", path, number
            )
        if image not in gallery:
            known = next(iter(gallery))
            raise PredictionError(
                f"image '{image}' is not in the gallery, whose images have names such as '{known}'", path, number
            )
        if (query, gallery[image]) in seen:
            raise PredictionError(f"image '{image}' occurs again for the query '{query}'", path, number)
        seen.add((query, gallery[image]))
        lists[query].append(gallery[image])
    return lists


def answers_hash(path: Path) -> str:
    """The SHA-256 of a table, by which stale scores are recognized."""
    return hashlib.sha256(plain_file(path, "answers").read_bytes()).hexdigest()


def _ranks(text: str, path: Path, line: int) -> tuple[int, ...]:
    words = text.split()
    ranks = tuple(rank for word in words if (rank := whole_number(word)))
    if len(ranks) < len(words):
        raise PredictionError(f"ranks are {quoted(text, 60)}, expected positive integers", path, line)
    if any(b <= a for a, b in pairwise(ranks)):
        raise PredictionError("ranks do not increase", path, line)
    return ranks
