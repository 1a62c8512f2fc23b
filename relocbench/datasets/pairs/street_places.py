"""Street-level place recognition: the drives of a dataset as a retrieval set.

Each pair set of two traversals is a task. Its gallery holds the keyframes of the reference traversal's camera, and its
queries are the images of the query traversal's camera, in the order of the drive.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_rgb
from relocbench.datasets.core.layout import TraversalLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.worlds import differences
from relocbench.errors import ConfigError, DatasetError
from relocbench.metrics import Relevance, relevance_from_lists, relevance_within
from relocbench.metrics.retrieval.relevance import PLACE_RADIUS_M
from relocbench.retrieval import ImageView, RetrievalTask

Positives = Literal["radius", "pairs"]
VIEW = "street"
_ONE_WORLD_M = 2.0
"""greatest median difference between pairs' poses and traversals' poses if the traversals share a world"""
_VERSION = 1
"""to be increased when the same options give other tasks"""


@dataclass(frozen=True, eq=False)
class StreetPlaces:
    """A relocbench dataset as a :class:`~relocbench.retrieval.RetrievalSet`.

    With the rule ``radius`` a gallery image is relevant if its camera was within ``radius_m`` of the query's and, if
    ``heading_deg`` is given, their optical axes differ by at most that angle; queries without a pose are left out. With
    the rule ``pairs`` it is relevant if the pair set contains the pair, so that a tracker could reach the query from
    it; the queries are those of the pairs.

    Raises:
        ConfigError: a value is out of range, or a heading is given with the rule ``pairs``.
    """

    dataset: Dataset
    radius_m: float = PLACE_RADIUS_M
    heading_deg: float | None = None
    rule: Positives = "radius"

    def __post_init__(self) -> None:
        if self.rule == "pairs" and self.heading_deg is not None:
            raise ConfigError("--heading applies to --positives radius only, not to --positives pairs")
        if not 0 < self.radius_m < np.inf:
            raise ConfigError(f"--radius must be a positive number of metres, got {self.radius_m}")
        if self.heading_deg is not None and not 0 < self.heading_deg <= 180:
            raise ConfigError(f"--heading must be degrees in 0..180, got {self.heading_deg}")

    @property
    def name(self) -> str:
        """The dataset's name with the relevance rule; every choice of it is a retrieval set of its own."""
        if self.rule == "pairs":
            return f"{self.dataset.name}.places-pairs"
        heading = "" if self.heading_deg is None else f"-{self.heading_deg:g}deg"
        return f"{self.dataset.name}.places-{self.radius_m:g}m{heading}"

    @property
    def positives(self) -> str:
        """The relevance rule in words."""
        if self.rule == "pairs":
            return "keyframes that the pair set pairs with the query"
        heading = "" if self.heading_deg is None else f" that look the same way within {self.heading_deg:g}°"
        return f"keyframes within {self.radius_m:g} m{heading}"

    @property
    def options(self) -> dict[str, float | str]:
        """The command-line options that select this set."""
        if self.rule == "pairs":
            return {"positives": "pairs"}
        heading: dict[str, float | str] = {} if self.heading_deg is None else {"heading": self.heading_deg}
        return {"radius": self.radius_m, **heading}

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the dataset's fingerprint and the relevance rule."""
        return self._with_rule(self.dataset.fingerprint)

    @property
    def content_id(self) -> str:
        """SHA-256 of the dataset's content id and the relevance rule, the same on every processor."""
        return self._with_rule(self.dataset.content_id)

    def _with_rule(self, dataset: str) -> str:
        radius = None if self.rule == "pairs" else self.radius_m
        asked = {"version": _VERSION, "rule": self.rule, "radius_m": radius, "heading_deg": self.heading_deg}
        return hashlib.sha256(json.dumps({"dataset": dataset, **asked}, sort_keys=True).encode()).hexdigest()

    @property
    def splits(self) -> dict[str, tuple[str, ...]]:
        """The tasks of each split."""
        names = {s.name for s in self.pair_sets}
        return {split: tuple(n for n in of if n in names) for split, of in self.dataset.splits.items()}

    @cached_property
    def pair_sets(self) -> list[PairSet]:
        """The pair sets of two different traversals; within one traversal a query would find itself."""
        return [s for s in self.dataset.pair_sets() if s.reference != s.query]

    def tasks(self) -> Sequence[RetrievalTask]:
        """One task per pair set.

        Raises:
            DatasetError: there is no pair set of two traversals, no keyframe or query with a pose, or the traversals
                are in different worlds.
        """
        if not self.pair_sets:
            raise DatasetError(
                "holds no pair set of two different traversals; expected one for place recognition", self.dataset.root
            )
        return tuple(self.task(s) for s in self.pair_sets)

    def task(self, pair_set: PairSet) -> RetrievalTask:
        """The retrieval task of one pair set. Raises DatasetError."""
        reference, query = self.dataset.traversal(pair_set.reference), self.dataset.traversal(pair_set.query)
        keyframes = reference.keyframe_timestamps(pair_set.reference_camera)
        if self.rule == "radius":
            keyframes = [t for t in keyframes if t in reference.poses]
            times = [t for t in query.timestamps(pair_set.query_camera) if t in query.poses]
        else:
            times = sorted({p.query_timestamp_ns for p in pair_set.pairs})
        if not keyframes or not times:
            missing, camera = f"{query.name} has no image", pair_set.query_camera
            if not keyframes:
                missing, camera = f"{reference.name} has no keyframe", pair_set.reference_camera
            posed = " with a pose" if self.rule == "radius" else ""
            raise DatasetError(f"{missing} of camera '{camera}'{posed}", self.dataset.layout.pair_file(pair_set.name))
        if self.rule == "radius":
            relevance = self._within(pair_set, reference, query, keyframes, times)
        else:
            relevance = _paired(pair_set, keyframes, times)
        return RetrievalTask(
            name=pair_set.name,
            queries=tuple(street_view(query, pair_set.query_camera, t) for t in times),
            gallery=tuple(street_view(reference, pair_set.reference_camera, t) for t in keyframes),
            relevance=relevance,
            condition_query=str(query.condition),
            condition_gallery=str(reference.condition),
        )

    def _within(
        self, pair_set: PairSet, reference: Traversal, query: Traversal, keyframes: list[int], times: list[int]
    ) -> Relevance:
        check_one_world(pair_set, reference, query, "use --positives pairs")
        at = [
            np.stack([t.T_world_cam(camera, time) for time in of])
            for t, camera, of in (
                (query, pair_set.query_camera, times),
                (reference, pair_set.reference_camera, keyframes),
            )
        ]
        near = relevance_within(at[0][:, :3, 3], at[1][:, :3, 3], self.radius_m)
        if self.heading_deg is None:
            return near
        cosine = np.cos(np.radians(self.heading_deg)) - 1e-9
        axes = [poses[:, :3, 2] for poses in at]
        same_way = [near.of(q)[axes[1][near.of(q)] @ axes[0][q] >= cosine] for q in range(len(times))]
        return relevance_from_lists(same_way, len(keyframes))


def _paired(pair_set: PairSet, keyframes: list[int], times: list[int]) -> Relevance:
    place = {time: index for index, time in enumerate(keyframes)}
    found: dict[int, list[int]] = {time: [] for time in times}
    for pair in pair_set.pairs:
        if pair.ref_timestamp_ns not in place:
            raise DatasetError(
                f"pairs name the keyframe {pair.ref_timestamp_ns}, which has neither depth nor points",
                pair_set.layout.pair_file(pair_set.name),
            )
        found[pair.query_timestamp_ns].append(place[pair.ref_timestamp_ns])
    return relevance_from_lists(list(found.values()), len(keyframes))


def check_one_world(pair_set: PairSet, reference: Traversal, query: Traversal, remedy: str) -> None:
    """Raise DatasetError, with a remedy, if the pairs' poses show that two traversals are in different worlds."""
    some = pair_set.pairs[:: max(1, len(pair_set.pairs) // 100)]
    apart_m = differences(pair_set.cameras, some, reference, query)[:, 0]
    if len(apart_m) and np.median(apart_m) > _ONE_WORLD_M:
        raise DatasetError(
            f"the poses of {query.name} and {reference.name} differ from those of the pairs by "
            f"{np.median(apart_m):.1f} m, so they are not in one world; {remedy}",
            pair_set.layout.pair_file(pair_set.name),
        )


def image_key(traversal: Traversal, camera: str, timestamp_ns: int) -> str:
    """The key of an image in the tasks of its dataset, which is its path in the dataset."""
    path = traversal.layout.find_image(camera, timestamp_ns) or traversal.layout.image(camera, timestamp_ns)
    return path.relative_to(traversal.layout.root.parent.parent).as_posix()


def time_of_key(key: str) -> int:
    """The timestamp of the image with that key, nanoseconds."""
    return int(Path(key).stem)


def street_view(traversal: Traversal, camera: str, time: int) -> ImageView:
    """An image of a drive as a retriever sees it."""
    key = image_key(traversal, camera, time)
    return ImageView(key, VIEW, partial(_read, traversal.layout.root, camera, time))


def _read(root: Path, camera: str, time: int) -> Image:
    return as_rgb(_traversal(root).image(camera, time))


@cache
def _traversal(root: Path) -> Traversal:
    """A traversal, opened once per process: image views are sent to worker processes."""
    return Traversal(TraversalLayout(root))
