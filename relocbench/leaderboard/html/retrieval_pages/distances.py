"""How far the camera of a retrieved keyframe was from that of the query, where a dataset of drives is available."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.evaluation.relocalization.truth import MapTruth, distance_and_angle
from relocbench.evaluation.retrieval.rescoring import RetrievalTruth
from relocbench.retrieval import ImageView, RetrievalTask


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
            _centres(places, traversal, pair_set.camera, images)
            for traversal, images in ((pair_set.query, task.queries), (pair_set.reference, task.gallery))
        )
        return Distances(task, np.stack([_lengths(gallery - centre) for centre in query]))
    if not pair_set.has_truth:
        return None
    known = MapTruth(places.dataset, pair_set, *([time_of(view) for view in of] for of in (task.queries, task.gallery)))
    rows = (distance_and_angle(known.relative(q))[0].astype(np.float32) for q in range(len(task.queries)))
    return Distances(task, np.stack(list(rows)))


def _lengths(vectors: Array) -> Floats:
    """(N, 3) -> (N,)"""
    return np.asarray(np.linalg.norm(vectors, axis=-1), dtype=np.float32)


def time_of(view: ImageView) -> int:
    """The timestamp of an image of a drive, nanoseconds: the key is ``traversals/NAME/images/CAMERA/TIME.png``."""
    return int(Path(view.key).stem)


def _centres(places: StreetPlaces, traversal: str, camera: str, images: tuple[ImageView, ...]) -> Array:
    """(N, 3) camera centres in the world."""
    drive: Traversal = places.dataset.traversal(traversal)
    return np.stack([drive.T_world_cam(camera, time_of(image))[:3, 3] for image in images])
