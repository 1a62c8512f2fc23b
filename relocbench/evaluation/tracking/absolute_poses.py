"""Absolute poses of queries, and what every export of them needs.

A relative pose becomes an absolute one by the map's pose of its keyframe:
``T_world_query = T_world_ref @ inv(T_query_ref)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PoseLine
from relocbench.datasets.core.traversal import Traversal
from relocbench.errors import PredictionError
from relocbench.geometry import apply, invert


@dataclass(frozen=True, eq=False)
class QueryPose:
    """The absolute pose of a query camera, in the world frame of the reference traversal."""

    query_timestamp_ns: int
    ref_timestamp_ns: int
    """the keyframe of the relative pose"""
    T_world_query: Array
    """(4, 4)"""


def query_poses(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine]) -> list[QueryPose]:
    """The absolute poses of a pair set's queries, in time order.

    Of several answers for one query, the one that is nearest to its own keyframe is taken.

    Raises:
        PredictionError: a pair that is not in the set, or none with a pose.
        DatasetError: the map has no pose of a keyframe.
    """
    chosen = dataset.pair_set(pair_set)
    best: dict[int, PoseLine] = {}
    for line in answered_lines(chosen, predictions):
        known = best.get(line.query_timestamp_ns)
        if known is None or _reach(line) < _reach(known):
            best[line.query_timestamp_ns] = line
    if not best:
        raise PredictionError(f"no pair of '{pair_set}' has a pose: there is nothing to export")
    reference = dataset.traversal(chosen.reference)
    return [
        QueryPose(
            time,
            line.ref_timestamp_ns,
            reference.T_world_cam(chosen.reference_camera, line.ref_timestamp_ns) @ invert(_pose(line)),
        )
        for time, line in sorted(best.items())
    ]


def answered_lines(pair_set: PairSet, predictions: Sequence[PoseLine]) -> list[PoseLine]:
    """The predictions with a pose, of pairs of one place. Raises PredictionError for a pair that is not in the set."""
    for line in predictions:
        if line.key not in pair_set.by_key:
            raise PredictionError(f"pair {line.key[0]} {line.key[1]} is not in the pair set '{pair_set.name}'")
    return [line for line in predictions if line.T_query_ref is not None and not pair_set.by_key[line.key].is_negative]


def points_in_world(traversal: Traversal, camera: str, time: int, T_world_cam: Array) -> tuple[Array, Array]:
    """The sparse points (N, 3) of a keyframe in the world, and their pixels (N, 2); none where depth is dense."""
    points = traversal.points(camera, time)
    if points is None or not len(points):
        return np.zeros((0, 3)), np.zeros((0, 2))
    rays, valid = traversal.camera(camera, time).unproject(points.uv)
    valid = valid & (rays[:, 2] > 0)
    rays = rays[valid] / rays[valid][:, 2:]
    return apply(T_world_cam, rays / points.inverse_depth[valid, None]), points.uv[valid]


def digits(value: float) -> str:
    """A float in the fewest digits that read back as the same number."""
    return repr(float(value) + 0.0)


def _pose(line: PoseLine) -> Array:
    assert line.T_query_ref is not None
    return line.T_query_ref


def _reach(line: PoseLine) -> float:
    """The predicted distance in metres from the keyframe to the query."""
    return float(np.linalg.norm(_pose(line)[:3, 3]))
