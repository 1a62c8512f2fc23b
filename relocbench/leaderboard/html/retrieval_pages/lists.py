"""The first images that a retriever's results keep of each query, whether the dataset is available or not."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from relocbench.errors import PredictionError
from relocbench.evaluation.retrieval.answers import QueryAnswer
from relocbench.files import lines_of, read_text
from relocbench.leaderboard.retrieval.board import RetrievalSetBoard, Retriever
from relocbench.leaderboard.tracking.marks import made_elsewhere
from relocbench.retrieval import RetrievalTask

SHOWN = 5
"""images of a query that a page shows, of each method and of the right ones"""


@dataclass(frozen=True)
class KeptLists:
    """The beginnings of a method's lists on a task."""

    top: list[list[str]]
    """the keys of the first images of each query, best first, without junk"""
    right: list[list[bool | None]]
    """whether each of these is right; None where nothing tells"""
    depth: int | None
    """up to which rank the method's rankings go; None: they hold the whole gallery"""


def task_of(asked: RetrievalSetBoard, name: str) -> RetrievalTask | None:
    """A task with its images; None where the dataset, or this task of it, is not available."""
    return None if asked.truth is None else asked.truth.tasks.get(name)


def kept_lists(asked: RetrievalSetBoard, method: Retriever, name: str) -> KeptLists:
    """The beginnings of the lists of a task that a method has answered.

    Which images are right follows from the dataset. Without it, the ranks of right images say it, as long
    as no junk, which they do not count, is in the gallery.

    Raises:
        PredictionError: with file and line: a line that is not 'query db'.
    """
    answers = method.answers[name]
    task = task_of(asked, name)
    junk: Collection[str] = ()
    if task is not None:
        junk = {image.key for image, out in zip(task.gallery, task.relevance.junk, strict=True) if out}
    path = method.folder.predictions(name)
    top: dict[str, list[str]] = {answer.query: [] for answer in answers}
    length = dict.fromkeys(top, 0)
    text = read_text(path, "retrieved images, a line 'query db' each", PredictionError)
    for number, line in enumerate(lines_of(text), start=1):
        words = line.split()
        if not words or line.startswith("#"):
            continue
        if len(words) != 2 or words[0] not in top:
            raise PredictionError("expected 'query db' with a query of the table beside it", path, number)
        length[words[0]] += 1
        if len(top[words[0]]) < SHOWN and words[1] not in junk:
            top[words[0]].append(words[1])
    if task is not None:
        positives = [{task.gallery[k].key for k in task.relevance.of(q)} for q in range(len(task.queries))]
        right: list[list[bool | None]] = [
            [key in of for key in keys] for of, keys in zip(positives, top.values(), strict=True)
        ]
    else:
        without_junk = not asked.record.tasks[name].junk
        right = [_by_ranks(answer, len(top[answer.query]), without_junk) for answer in answers]
    depth = max(length.values(), default=0) if made_elsewhere(method.run) else None
    return KeptLists(list(top.values()), right, depth)


def _by_ranks(answer: QueryAnswer, count: int, known: bool) -> list[bool | None]:
    return [rank in answer.ranks if known else None for rank in range(1, count + 1)]
