"""The content of a dataset in numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.traversal import Traversal
from relocbench.metrics.pose.tiers import TIERS, tiers_of


@dataclass(frozen=True)
class Spread:
    """Least, median and greatest of some values."""

    least: float
    median: float
    greatest: float

    @classmethod
    def of(cls, values: Sequence[float | None]) -> Spread | None:
        """The spread of the known values; None if there are none."""
        known = [v for v in values if v is not None]
        return cls(min(known), float(np.median(known)), max(known)) if known else None


@dataclass(frozen=True)
class TraversalSummary:
    """One traversal."""

    name: str
    condition: str
    location: str
    cameras: dict[str, str]
    """name -> model and size; of a frame without images, that there are poses alone"""
    images: int
    keyframes: int
    poses: int
    length_m: float
    """length of the path through the poses"""


@dataclass(frozen=True)
class PairSetInventory:
    """One pair set."""

    name: str
    reference: str
    query: str
    camera: str
    """of keyframes and queries, ``rear → front`` where they are two"""
    reference_condition: str
    query_condition: str
    pairs: int
    rejected: dict[str, int]
    """reason -> number of rejected pairs"""
    tiers: dict[str, int]
    """tier of difficulty -> number of accepted pairs; those whose tier is not known are in none"""
    groups: dict[str, int]
    """group -> number of accepted pairs"""
    elsewhere: int
    """number of pairs of different places, which nothing else here counts"""
    has_truth: bool
    sources: dict[str, int]
    distance_m: Spread | None
    angle_deg: Spread | None
    overlap: Spread | None
    sigma_translation_m: Spread | None
    sigma_rotation_deg: Spread | None


@dataclass(frozen=True)
class Inventory:
    """The whole dataset."""

    name: str
    licence: str
    fingerprint: str
    made_by: dict[str, Any]
    splits: dict[str, tuple[str, ...]]
    traversals: list[TraversalSummary]
    pair_sets: list[PairSetInventory]

    def to_dict(self) -> dict[str, Any]:
        """The inventory as plain values, for scripts."""
        return asdict(self)


def take_inventory(dataset: Dataset) -> Inventory:
    """Count and measure the content of a dataset; no image is read.

    Raises:
        DatasetError: a description, pose or pair file is bad.
    """
    return Inventory(
        name=dataset.name,
        licence=dataset.file.licence,
        fingerprint=dataset.fingerprint,
        made_by=dict(dataset.file.made_by),
        splits=dict(dataset.splits),
        traversals=[summarize_traversal(dataset.traversal(name)) for name in dataset.traversal_names],
        pair_sets=[summarize_pair_set(dataset, pair_set) for pair_set in dataset.pair_sets()],
    )


def summarize_traversal(traversal: Traversal) -> TraversalSummary:
    """Count a traversal's files and measure the length driven."""
    centres = np.array([T_world_rig[:3, 3] for T_world_rig in traversal.poses.values()]).reshape(-1, 3)
    return TraversalSummary(
        name=traversal.name,
        condition=str(traversal.condition),
        location=traversal.file.location,
        cameras={name: _camera_in_words(traversal, name) for name in traversal.cameras}
        | dict.fromkeys(traversal.frames, "poses alone"),
        images=sum(len(traversal.timestamps(camera)) for camera in traversal.cameras),
        keyframes=sum(len(traversal.keyframe_timestamps(camera)) for camera in traversal.cameras),
        poses=len(centres),
        length_m=float(np.sum(np.linalg.norm(np.diff(centres, axis=0), axis=1))),
    )


def _camera_in_words(traversal: Traversal, name: str) -> str:
    camera, own = traversal.camera(name), traversal.intrinsics(name)
    if own:
        return f"pinhole, {len(set(own.values()))} different ones for {len(own)} images"
    return f"{camera.model} {camera.width}x{camera.height}"


def summarize_pair_set(dataset: Dataset, pair_set: PairSet) -> PairSetInventory:
    """Count a set's pairs and measure how far apart they are."""
    pairs = pair_set.pairs
    return PairSetInventory(
        name=pair_set.name,
        reference=pair_set.reference,
        query=pair_set.query,
        camera=" → ".join(dict.fromkeys(pair_set.cameras)),
        reference_condition=str(dataset.traversal(pair_set.reference).condition),
        query_condition=str(dataset.traversal(pair_set.query).condition),
        pairs=len(pairs),
        rejected=dict(Counter(p.reason or "no reason given" for p in pair_set.rejected)),
        tiers={name: count for i, name in enumerate(TIERS) if (count := int(np.sum(tiers_of(pairs) == i)))},
        groups=dict(Counter(p.group for p in pairs if p.group)),
        elsewhere=len(pair_set.negative_pairs),
        has_truth=pair_set.has_truth,
        sources=dict(Counter(p.source for p in pairs if p.source)),
        distance_m=Spread.of([p.distance_m for p in pairs]),
        angle_deg=Spread.of([p.angle_deg for p in pairs]),
        overlap=Spread.of([p.overlap for p in pairs]),
        sigma_translation_m=Spread.of([p.sigma_translation_m for p in pairs]),
        sigma_rotation_deg=Spread.of([p.sigma_rotation_deg for p in pairs]),
    )
