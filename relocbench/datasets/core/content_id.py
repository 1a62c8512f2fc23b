"""The content id: a digest of what a dataset contains, independent of the bytes that it is stored in.

Processors differ in the last digits of floats. On another machine the same command renders images in which some pixels
differ by a grey level, and the fingerprint, which covers every byte, differs too. The content is the same:
the recipe, the rigs, the poses and the pairs. The content id covers these, with lengths rounded to a micrometre
and rotations to a millionth, so that results from both machines can be compared in one table.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import pose_numbers
from relocbench.datasets.core.schema import DatasetFile
from relocbench.datasets.core.traversal import Traversal
from relocbench.geometry import Camera

DECIMALS = 6
"""decimals of metres and of quaternion components"""
_NOT_ASKED = frozenset({"sources", "versions", "name", "licence", "copy_images"})
"""keys of a recipe that do not change the content: the sources, the software and the names"""


def content_id_of(file: DatasetFile, traversals: Mapping[str, Traversal], pair_sets: Mapping[str, PairSet]) -> str:
    """SHA-256 of what a dataset contains, the same on every processor.

    It covers the format's version, the splits, the recipe (without folders and versions), each traversal's condition,
    rig, poses and image times, and each pair with its ``T_query_ref``, whether it was accepted, and whether it is of
    different places. It does not cover pixels, depths and correspondences, whose last digits depend on the processor.

    Raises:
        DatasetError: a file of the dataset is bad.
    """
    content = {
        "format_version": file.format_version,
        "splits": file.splits,
        "recipe": recipe(file.made_by),
        "traversals": {name: _traversal(traversal) for name, traversal in traversals.items()},
        "pair_sets": {name: _pairs(pair_set) for name, pair_set in pair_sets.items()},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def recipe(values: Any) -> Any:
    """How a dataset was made, without sources, versions and names, and with rounded numbers."""
    if isinstance(values, Mapping):
        return {str(key): recipe(value) for key, value in values.items() if key not in _NOT_ASKED}
    if isinstance(values, list | tuple):
        return [recipe(value) for value in values]
    return _rounded([values])[0] if isinstance(values, float) else values


def _traversal(traversal: Traversal) -> dict[str, Any]:
    file = traversal.file.model_dump(mode="json", exclude={"source", "name", "clock"})
    for entry in file["cameras"].values():
        entry["T_rig_cam"] = _digest(_transform_fields(entry["T_rig_cam"]))
    for name, T_rig_frame in file.get("frames", {}).items():
        file["frames"][name] = _digest(_transform_fields(T_rig_frame))
    images = {name: traversal.layout.timestamps("images", name) for name in traversal.file.cameras}
    times = sorted(traversal.poses)
    content = {
        "file": recipe(file),
        "images": images,
        "poses": [times, _digest(_signed(pose_numbers([traversal.poses[time] for time in times])))],
    }
    own = {name: traversal.intrinsics(name) for name in traversal.file.cameras}
    # Traversals without intrinsics of single images keep the digest of earlier versions.
    if any(own.values()):
        content["intrinsics"] = {name: _cameras(cameras) for name, cameras in own.items()}
    return content


def _cameras(cameras: Mapping[int, Camera]) -> list[Any]:
    numbers = [[c.width, c.height, c.fx, c.fy, c.cx, c.cy] for c in cameras.values()]
    return [list(cameras), _digest(np.array(numbers, dtype=np.float64).reshape(-1, 6))]


def _transform_fields(values: Mapping[str, Any]) -> Array:
    """The numbers (1, 7) of a transform in ``traversal.yaml``."""
    return _signed(np.array([[*values["translation_m"], *values["quaternion_xyzw"]]], dtype=np.float64))


def _pairs(pair_set: PairSet) -> list[Any]:
    pairs = pair_set.all_pairs
    poses = np.zeros((len(pairs), 7))  # withheld ones stay so
    poses[[p.T_query_ref is not None for p in pairs]] = _signed(pose_numbers([p.T_query_ref for p in pairs]))
    pairs_content = [[[*p.key, p.accepted, p.T_query_ref is not None] for p in pairs], _digest(poses)]
    # Which pairs are of different places changes what is scored. Sets without any keep the digest of earlier versions.
    elsewhere = [[*p.key] for p in pairs if p.is_negative]
    return [*pairs_content, elsewhere] if elsewhere else pairs_content


def _signed(fields: Array) -> Array:
    """Poses (N, 7) whose quaternions have a positive largest component: q and -q are the same rotation."""
    quaternions = fields[:, 3:]
    place = np.argmax(np.round(np.abs(quaternions), DECIMALS), axis=1)
    negative = np.take_along_axis(quaternions, place[:, None], axis=1) < 0
    return np.concatenate([fields[:, :3], np.where(negative, -quaternions, quaternions)], axis=1)


def _digest(rows: Array) -> str:
    values = _rounded(rows)
    return hashlib.sha256(values.astype("<f8").tobytes()).hexdigest()


def _rounded(values: Any) -> Any:
    return np.round(np.asarray(values, dtype=np.float64), DECIMALS) + 0.0  # no negative zero
