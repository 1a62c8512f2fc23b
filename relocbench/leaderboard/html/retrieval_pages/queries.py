"""What the page of a query shows: the first images of every method, which of them are right, and their pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.leaderboard.html.chosen import worst_and_drawn
from relocbench.leaderboard.html.retrieval_pages.distances import Distances
from relocbench.leaderboard.html.retrieval_pages.lists import SHOWN, KeptLists, task_of
from relocbench.leaderboard.html.retrieval_pages.payloads import is_random
from relocbench.leaderboard.html.thumbnails import Thumbnail, thumbnail_name
from relocbench.leaderboard.retrieval.board import RetrievalSetBoard, Retriever
from relocbench.retrieval import RetrievalTask


def chosen_queries(methods: Sequence[Retriever], task: str, count: int) -> list[int]:
    """The indices of the queries that are shown with pictures, in ascending order.

    They are the ``count`` worst of each method that is no trivial baseline, by the rank of their first right
    image, and ``count`` drawn at random.
    """
    competing = [method.answers[task] for method in methods if not is_random(method)]
    first = [[a.ranks[0] if a.ranks else np.inf for a in answers] for answers in competing]
    return worst_and_drawn(first, len(methods[0].answers[task]), count)


def lists_payload(
    asked: RetrievalSetBoard,
    name: str,
    lists: Mapping[str, KeptLists],
    kept: Sequence[int],
    chosen: Sequence[int],
    distances: Distances | None,
) -> dict[str, Any]:
    """The lists of the queries of a task that are kept.

    Args:
        lists: of each method that has answered the task, by label.
        kept: indices of queries, ascending.
        chosen: those of them that have pictures where the dataset is available.
        distances: between the cameras of queries and keyframes; None where they are not known.
    """
    methods = {m.label: m for m in asked.methods if m.label in lists}
    answers = next(iter(methods.values())).answers[name]
    task = task_of(asked, name)
    right = {q: right_images(task, q, distances) for q in range(len(answers))}
    pictured = {key for q in chosen for key in _shown(lists, right, q)} if task is not None else set()
    images = sorted({key for q in kept for key in _shown(lists, right, q)})
    place = {key: index for index, key in enumerate(images)}

    def told(query: int, key: str) -> list[float | int | None]:
        """The place of an image among those that are shown, and how far its camera was, in metres."""
        metres = np.nan if distances is None else distances.of(query, key)
        return [place[key], round(metres, 3) if np.isfinite(metres) else None]

    def first(label: str, query: int) -> list[list[float | int | None]]:
        """What is told of the first images of a method, and whether each is right: 1, 0, or null."""
        keys, flags = lists[label].top[query], lists[label].right[query]
        return [[*told(query, key), None if flag is None else int(flag)] for key, flag in zip(keys, flags, strict=True)]

    return {
        "rows": None if len(kept) == len(answers) else list(kept),
        "images": images,
        "pictures": [thumbnail_name(key) if key in pictured else None for key in images],
        "queries": {} if task is None else {q: thumbnail_name(task.queries[q].key) for q in chosen},
        "right": None if task is None else [[told(q, key) for key in right[q]] for q in kept],
        "methods": {label: {"top": [first(label, q) for q in kept]} for label in methods},
    }


def thumbnails_of(
    task: RetrievalTask,
    lists: Mapping[str, KeptLists],
    chosen: Sequence[int],
    distances: Distances | None,
    site: Path,
    of_set: str,
) -> Iterator[Thumbnail]:
    """The pictures that the pages of chosen queries show."""
    right = {q: right_images(task, q, distances) for q in chosen}
    wanted = {key for q in chosen for key in _shown(lists, right, q)}
    views = [*(task.queries[q] for q in chosen), *(image for image in task.gallery if image.key in wanted)]
    return (Thumbnail(site, of_set, view) for view in views)


def right_images(task: RetrievalTask | None, query: int, distances: Distances | None) -> list[str]:
    """The keys of the first right images of a query: the nearest, or else in the order of the gallery.

    There are none where the dataset is not available.
    """
    if task is None:
        return []
    keys = [task.gallery[k].key for k in task.relevance.of(query)]
    if distances is not None:
        keys.sort(key=lambda key: np.nan_to_num(distances.of(query, key), nan=np.inf))
    return keys[:SHOWN]


def _shown(lists: Mapping[str, KeptLists], right: Mapping[int, Sequence[str]], query: int) -> set[str]:
    """The keys of the images that the page of a query shows."""
    return {key for of in lists.values() for key in of.top[query]} | set(right[query])
