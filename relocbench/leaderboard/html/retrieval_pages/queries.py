"""The queries of a task of retrievers: their ranks, the first images of every method, and which of these are right.

Where a dataset of drives is available, it is also shown how far the camera of a retrieved keyframe was from the query.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.datasets.pairs.street_places import StreetPlaces, time_of_key
from relocbench.errors import PredictionError
from relocbench.evaluation.relocalization.truth import MapTruth, distance_and_angle
from relocbench.evaluation.retrieval.answers import QueryAnswer, list_lines
from relocbench.evaluation.retrieval.rescoring import RetrievalTruth
from relocbench.evaluation.tables.schema import STATUSES
from relocbench.leaderboard.html.data import bytes_of, floats
from relocbench.leaderboard.html.thumbnails import thumbnail_name
from relocbench.leaderboard.retrieval.board import RetrievalSetBoard, Retriever
from relocbench.leaderboard.tracking.marks import made_elsewhere
from relocbench.metrics import chance_recall
from relocbench.retrieval import ImageView, RetrievalTask

_CURVE_POINTS = 60
"""numbers of images for which the recall of chance is told"""


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
        return [_first_ranks(m, self._name) for m in self._methods.values() if not m.is_baseline]

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
    for number, words in list_lines(path):
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


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances between the cameras of a task."""

    task: RetrievalTask
    metres: Floats
    """(Q, G) between each query and each keyframe; NaN where it is not known"""

    def of(self, query: int, key: str) -> float:
        """Metres between a query and a keyframe, by its key; NaN where it is not known."""
        place = self._place.get(key)
        return float("nan") if place is None else float(self.metres[query, place])

    @cached_property
    def _place(self) -> dict[str, int]:
        return {image.key: index for index, image in enumerate(self.task.gallery)}

    @property
    def nearest(self) -> Array:
        """(Q,) metres to the nearest keyframe; infinite where none is known."""
        known = np.where(np.isfinite(self.metres), self.metres, np.inf)
        return np.asarray(known.min(axis=1, initial=np.inf), dtype=np.float64)


def distances_of(truth: RetrievalTruth | None, name: str) -> Distances | None:
    """The distances of a task along drives; None for views of places, whose positions nobody records.

    They are None too where the dataset, or this task of it, is not available.

    With a radius they are those of the positions by which images are right. Pairs alone need no common world, and
    their distances are those of the pairs' true poses, transferred along the drive of the keyframes.
    """
    if truth is None or name not in truth.tasks or isinstance(truth.places, CrossViewSet):
        return None
    places = truth.places
    task, pair_set = truth.tasks[name], places.dataset.pair_set(name)
    if places.rule == "radius":
        query, gallery = (
            _centres(places, *side)
            for side in (
                (pair_set.query, pair_set.query_camera, task.queries),
                (pair_set.reference, pair_set.reference_camera, task.gallery),
            )
        )
        return Distances(task, np.stack([_lengths(gallery - centre) for centre in query]))
    if not pair_set.has_truth:
        return None
    known = MapTruth(
        places.dataset, pair_set, *([time_of_key(view.key) for view in of] for of in (task.queries, task.gallery))
    )
    rows = (distance_and_angle(known.relative(q))[0].astype(np.float32) for q in range(len(task.queries)))
    return Distances(task, np.stack(list(rows)))


def _lengths(vectors: Array) -> Floats:
    """(N, 3) -> (N,)"""
    return np.asarray(np.linalg.norm(vectors, axis=-1), dtype=np.float32)


def _centres(places: StreetPlaces, traversal: str, camera: str, images: tuple[ImageView, ...]) -> Array:
    """(N, 3) camera centres in the world."""
    drive: Traversal = places.dataset.traversal(traversal)
    return np.stack([drive.T_world_cam(camera, time_of_key(image.key))[:3, 3] for image in images])
