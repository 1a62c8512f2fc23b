"""Predictions by image name: the absolute poses that hloc and visuallocalization.net write, against keyframes.

An absolute pose becomes a relative one by the map's pose of the keyframe:
``T_query_ref = T_query_world @ T_world_ref``.
"""

from __future__ import annotations

from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import read_named_poses, read_words
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError, quoted

_FIELDS = 8


def is_named(path: Path) -> bool:
    """Whether the first line of a prediction file has a name and a pose, as opposed to a pair and a pose."""
    first = next(iter(read_words(path, "predictions", PredictionError)), None)
    return first is not None and len(first[1]) == _FIELDS


def read_named_predictions(path: Path, dataset: Dataset, pair_set: PairSet) -> dict[PairKey, Array]:
    """``T_query_ref`` (4, 4) by pair, from lines ``name qw qx qy qz tx ty tz``, camera from world.

    A query is named as in the recording, or by the last part of its name where this is no other query's. All pairs of
    a query get its pose. Poses are in the unit of the model that the dataset was imported from.

    Raises:
        PredictionError: with file and line: a line that cannot be read; a name that no query has, or several; or the
            dataset's images have no names.
    """
    names = dataset.traversal(pair_set.query).names
    if not names:
        raise PredictionError(
            f"names images, and those of {dataset.name} have no names; expected lines 'ref_ts query_ts [tx ty tz qx qy "
            "qz qw]'",
            path,
        )
    by_name = {name: time for time, name in names.items()}
    by_last: dict[str, list[int]] = {}
    for time, name in names.items():
        by_last.setdefault(name.rpartition("/")[2], []).append(time)
    options = dataset.file.made_by.get("options")
    metres = float(options.get("metres_per_unit", 1.0)) if isinstance(options, dict) else 1.0
    poses: dict[int, Array] = {}
    for name, T_query_world in read_named_poses(path, PredictionError).items():
        times = [by_name[name]] if name in by_name else by_last.get(name, [])
        if len(times) != 1:
            raise PredictionError(f"{quoted(name)} names {len(times) or 'no'} queries of '{pair_set.name}'", path)
        if times[0] in poses:
            raise PredictionError(f"{quoted(name)} names a query for the second time", path)
        scaled = T_query_world.copy()
        scaled[:3, 3] *= metres
        poses[times[0]] = scaled
    reference = dataset.traversal(pair_set.reference)
    return {
        pair.key: poses[pair.query_timestamp_ns] @ reference.T_world_cam(pair_set.camera, pair.ref_timestamp_ns)
        for pair in pair_set.evaluated
        if pair.query_timestamp_ns in poses
    }
