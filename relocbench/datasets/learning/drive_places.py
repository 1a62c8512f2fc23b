"""Training places along drives: images that were taken near one spot, looking the same way, on several drives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.learning.training_pairs import refuse_test_split
from relocbench.datasets.pairs.street_places import check_one_world, street_view
from relocbench.errors import DatasetError
from relocbench.retrieval import PlaceData, PlaceImage

SPLIT = "train"
RADIUS_M, APART_M = 5.0, 15.0
"""of a place, and between places that look the same way; what lies between two places belongs to neither"""
HEADING_DEG = 20.0
"""largest angle between the optical axis of an image and that of the place's first image"""
APART_DEG = 2 * HEADING_DEG
"""between the optical axes of places at one spot, such as those of a rig's cameras"""


@dataclass(frozen=True, eq=False)
class _Shot:
    traversal: str
    camera: str
    timestamp_ns: int
    centre: Array
    """(3,) of the camera in the world, metres"""
    axis: Array
    """(3,) optical axis in the world, of norm 1"""


def drive_places(root: Path, radius_m: float = RADIUS_M, apart_m: float = APART_M) -> PlaceData:
    """The places of the split ``train`` of a dataset.

    The traversals must share a world, which is checked where pairs tell. Each is gone through in time; the first image
    that is ``apart_m`` or ``APART_DEG`` away from all places so far begins another one. Places that only one traversal
    shows teach nothing about light and weather and are left out.

    Args:
        root: folder of a dataset.
        radius_m: an image shows a place if its camera was so near to the place's first image.
        apart_m: between the first images of places that look the same way.

    Raises:
        ConfigError: the split shares a traversal with the test split.
        DatasetError: the dataset is bad, has no such split, or no two of its traversals show one place, or their
            poses are in different worlds.
    """
    dataset = Dataset(root)
    dataset.require_images(dataset.pair_sets(), "there is nothing to learn from")
    refuse_test_split(dataset, SPLIT)
    for pair_set in dataset.pair_sets(SPLIT):
        reference, query = dataset.traversal(pair_set.reference), dataset.traversal(pair_set.query)
        check_one_world(pair_set, reference, query, "places along drives need a common one")
    shots = list(_shots(dataset))
    place_of = _assigned(shots, radius_m, apart_m)
    seen: dict[int, set[str]] = {}
    for shot, place in zip(shots, place_of, strict=True):
        seen.setdefault(place, set()).add(shot.traversal)
    kept = [place for place, drives in sorted(seen.items()) if place >= 0 and len(drives) > 1]
    if not kept:
        raise DatasetError(
            f"no two traversals of split '{SPLIT}' have images with poses within {radius_m:g} m and "
            f"{HEADING_DEG:g} degrees; expected drives along one road in one world",
            root,
        )
    number = {place: k for k, place in enumerate(kept)}
    traversals = {shot.traversal: dataset.traversal(shot.traversal) for shot in shots}
    images = tuple(
        PlaceImage(
            street_view(traversals[shot.traversal], shot.camera, shot.timestamp_ns),
            number[place],
            str(traversals[shot.traversal].condition),
        )
        for shot, place in zip(shots, place_of, strict=True)
        if place in number
    )
    return PlaceData(len(kept), images, ((dataset.name, dataset.fingerprint),))


def _shots(dataset: Dataset) -> Iterator[_Shot]:
    """The images with poses of the split's traversals and cameras, one drive after the other."""
    cameras: dict[str, set[str]] = {}
    for pair_set in dataset.pair_sets(SPLIT):
        for name, camera in zip((pair_set.reference, pair_set.query), pair_set.cameras, strict=True):
            cameras.setdefault(name, set()).add(camera)
    for name in sorted(cameras):
        traversal = dataset.traversal(name)
        for camera in sorted(cameras[name]):
            for time in traversal.timestamps(camera):
                if time in traversal.poses:
                    T_world_cam = traversal.T_world_cam(camera, time)
                    yield _Shot(name, camera, time, T_world_cam[:3, 3], T_world_cam[:3, 2])


def _assigned(shots: list[_Shot], radius_m: float, apart_m: float) -> list[int]:
    """The place of each image, by the number of its first image; -1 for none."""
    first: list[int] = []
    found = []
    same_way, apart = np.cos(np.radians(HEADING_DEG)), np.cos(np.radians(APART_DEG))
    for number, shot in enumerate(shots):
        distance = np.array([np.linalg.norm(shots[k].centre - shot.centre) for k in first])
        cosine = np.array([shots[k].axis @ shot.axis for k in first])
        shown = (distance <= radius_m) & (cosine >= same_way)
        if np.any(shown):
            found.append(first[int(np.argmin(np.where(shown, distance, np.inf)))])
        elif np.all((distance >= apart_m) | (cosine <= apart)):
            first.append(number)
            found.append(number)
        else:
            found.append(-1)
    return found
