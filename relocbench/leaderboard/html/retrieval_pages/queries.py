"""The queries of a task of retrievers: their ranks, the first images of every method, and which of these are right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.evaluation.tables.rows import STATUSES
from relocbench.leaderboard.html.data import bytes_of, floats
from relocbench.leaderboard.html.retrieval_pages.distances import distances_of
from relocbench.leaderboard.html.retrieval_pages.lists import SHOWN, KeptLists, kept_lists, task_of
from relocbench.leaderboard.html.thumbnails import thumbnail_name
from relocbench.leaderboard.retrieval.board import RetrievalSetBoard, Retriever
from relocbench.metrics import chance_recall
from relocbench.retrieval import ImageView

RANDOM = "random"
"""the target of the retriever that ranks at random"""
_CURVE_POINTS = 60
"""numbers of images for which the recall of chance is told"""


def is_random(method: Retriever) -> bool:
    """Whether a method is the trivial baseline, which ranks at random."""
    return method.run.target == RANDOM


class RankedQueries:
    """The queries of a task that at least one method has answered."""

    def __init__(self, of: RetrievalSetBoard, name: str) -> None:
        """Read the beginnings of all lists.

        Raises:
            PredictionError: a list of retrieved images is bad.
        """
        self._name = name
        self._record = of.record.tasks[name]
        self._methods = {m.label: m for m in of.methods if name in m.answers}
        self._first = next(iter(self._methods.values())).answers[name]
        self._task = task_of(of, name)
        self._distances = distances_of(of.truth, name)
        self._lists = {label: kept_lists(of, m, name) for label, m in self._methods.items()}

    def answers(self) -> dict[str, Any]:
        """The ranks of all methods."""
        positives, gallery = [a.positives for a in self._first], self._record.gallery - self._record.junk
        depths = np.unique(np.rint(np.geomspace(1, max(gallery, 1), _CURVE_POINTS)).astype(np.int64)).tolist()
        return {
            "units": {
                "query": [a.query for a in self._first],
                "group": [a.group for a in self._first] if self._record.grouped else None,
                "positives": floats(positives),
            },
            "gallery": gallery,
            "chance": [depths, [round(share, 6) for share in chance_recall(positives, gallery, depths)]],
            "nearest_m": None if self._distances is None else floats(self._distances.nearest),
            "methods": {label: self._ranks(method) for label, method in self._methods.items()},
        }

    def how_bad(self) -> list[list[float]]:
        """The rank of the first right image."""
        return [_first_ranks(m, self._name) for m in self._methods.values() if not is_random(m)]

    def details(self, kept: Sequence[int], chosen: Sequence[int]) -> dict[str, Any]:
        """The first images of each method, and those that are right."""
        pictured = {key for q in chosen for key in self._shown(q)} if self._task is not None else set()
        images = sorted({key for q in kept for key in self._shown(q)})
        place = {key: index for index, key in enumerate(images)}

        def placed(query: int, key: str) -> list[float | int | None]:
            """The place of an image among those that are shown, and how far its camera was, in metres."""
            metres = np.nan if self._distances is None else self._distances.of(query, key)
            return [place[key], round(metres, 3) if np.isfinite(metres) else None]

        def first(lists: KeptLists, query: int) -> list[list[float | int | None]]:
            """What is told of the first images of a method, and whether each is right: 1, 0, or null."""
            both = zip(lists.top[query], lists.right[query], strict=True)
            return [[*placed(query, key), None if flag is None else int(flag)] for key, flag in both]

        task = self._task
        return {
            "rows": None if len(kept) == len(self._first) else list(kept),
            "images": images,
            "pictures": [thumbnail_name(key) if key in pictured else None for key in images],
            "queries": {} if task is None else {q: thumbnail_name(task.queries[q].key) for q in chosen},
            "right": None if task is None else [[placed(q, key) for key in self._right[q]] for q in kept],
            "methods": {label: {"top": [first(lists, q) for q in kept]} for label, lists in self._lists.items()},
        }

    def views(self, chosen: Sequence[int]) -> Iterator[ImageView]:
        """The chosen queries, and all images that their pages show."""
        if self._task is not None:
            wanted = {key for q in chosen for key in self._shown(q)}
            yield from (self._task.queries[q] for q in chosen)
            yield from (image for image in self._task.gallery if image.key in wanted)

    def _ranks(self, method: Retriever) -> dict[str, Any]:
        answers, lists = method.answers[self._name], self._lists[method.label]
        return {
            "first": floats(_first_ranks(method, self._name)),
            "status": bytes_of([STATUSES.index(a.status) for a in answers]),
            "seconds": floats([np.nan if a.seconds is None else a.seconds for a in answers]),
            "distance_m": None if self._distances is None else floats(self._of_first(lists)),
            "depth": lists.depth,
            "messages": {row: answer.message for row, answer in enumerate(answers) if answer.message},
        }

    def _of_first(self, lists: KeptLists) -> Array:
        """(Q,) metres between each query and the keyframe that was retrieved first; infinite where there is none."""
        assert self._distances is not None
        return np.array([self._distances.of(q, keys[0]) if keys else np.inf for q, keys in enumerate(lists.top)])

    @cached_property
    def _right(self) -> list[list[str]]:
        """The keys of the first right images of each query; none where the dataset is not available."""
        return [self._right_of(query) for query in range(len(self._first))]

    def _right_of(self, query: int) -> list[str]:
        """The nearest, or else those that come first in the gallery."""
        if self._task is None:
            return []
        keys = [self._task.gallery[k].key for k in self._task.relevance.of(query)]
        distances = self._distances
        if distances is not None:
            keys.sort(key=lambda key: np.nan_to_num(distances.of(query, key), nan=np.inf))
        return keys[:SHOWN]

    def _shown(self, query: int) -> set[str]:
        """The keys of the images that the page of a query shows."""
        return {key for of in self._lists.values() for key in of.top[query]} | set(self._right[query])


def _first_ranks(method: Retriever, task: str) -> list[float]:
    """(Q,) the rank of the first right image of each query; infinite where there is none."""
    return [answer.ranks[0] if answer.ranks else np.inf for answer in method.answers[task]]
