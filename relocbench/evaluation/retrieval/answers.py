"""``TASK.txt`` and ``TASK.csv``: the retrieved images, and the ranks of each query's positives in the whole ranking."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np

from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.tables.schema import COUNT, SECONDS, STATUS, TEXT, Kind, Record, Schema, TableRow
from relocbench.files import atomic_write, lines_of, read_text, whole_number
from relocbench.files.plain import MAX_BYTES
from relocbench.metrics import NEVER, Ranking
from relocbench.retrieval import RetrievalTask


def _read_ranks(row: TableRow, name: str) -> tuple[int, ...]:
    words = row[name].split()
    ranks = tuple(rank for word in words if (rank := whole_number(word)))
    if len(ranks) < len(words):
        raise row.fault(f"ranks are {quoted(row[name], 60)}, expected positive integers")
    if any(b <= a for a, b in pairwise(ranks)):
        raise row.fault("ranks do not increase")
    return ranks


def _quick_ranks(texts: Sequence[str]) -> list[tuple[int, ...]] | None:
    digits = "".join(texts).replace(" ", "")
    if not (digits.isascii() and digits.isdecimal()):
        return None
    out = [tuple(map(int, text.split())) for text in texts]
    usual = all(ranks[0] > 0 and ranks[-1] < 2**63 for ranks in out if ranks)
    return out if usual and all(a < b for ranks in out for a, b in pairwise(ranks)) else None


RANKS = Kind(_read_ranks, lambda ranks: " ".join(map(str, ranks)), _quick_ranks)


@dataclass(frozen=True)
class QueryAnswer(Record):
    """A row of ``TASK.csv``."""

    query: Annotated[str, TEXT]
    group: Annotated[str, TEXT]
    """queries of one group are resampled together; empty along a drive"""
    status: Annotated[str, STATUS]
    """``ok``; ``failed``: the query has no descriptor, or nothing was retrieved; ``error``: the method broke"""
    positives: Annotated[int, COUNT]
    """number of positives in the gallery"""
    ranks: Annotated[tuple[int, ...], RANKS] = ()
    """1-based ranks of the retrieved positives, ascending, in the whole ranking without junk"""
    seconds: Annotated[float | None, SECONDS] = None
    """of describing and reranking, without reading the image and without the search"""
    message: Annotated[str, TEXT] = ""

    @property
    def named(self) -> str:
        return f"query '{self.query}'"

    def contradiction(self) -> str | None:
        if len(self.ranks) > self.positives:
            return f"{len(self.ranks)} ranks of {self.positives} positives"
        return None


ANSWERS = Schema(QueryAnswer)


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


def list_lines(path: Path, most_bytes: int = MAX_BYTES) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each line of a file of lists, without blank lines and comments, which begin with ``#``.

    Raises:
        PredictionError: the file cannot be read.
    """
    text = read_text(path, "retrieved images, a line 'query db' each", PredictionError, most_bytes)
    for number, line in enumerate(lines_of(text), start=1):
        if not line.startswith("#") and (words := line.split()):
            yield number, words


def read_task_lists(path: Path, task: RetrievalTask) -> dict[str, list[int]]:
    """Read the file of a task, as :func:`read_lists`, in the order of its queries."""
    queries, gallery = ({image.key: place for place, image in enumerate(of)} for of in (task.queries, task.gallery))
    return read_lists(path, queries, gallery)


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
    for number, words in list_lines(path):
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
