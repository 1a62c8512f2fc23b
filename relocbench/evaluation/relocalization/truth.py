"""The true pose of a query against any keyframe of the reference traversal.

A dataset's ground truth is that of its pairs. Against a keyframe k that is not paired with the query, the true pose is
that of the query's paired keyframe r nearest to k, transferred along the reference traversal's own poses:
``T_query_k = T_query_r @ T_r_world @ T_world_k``. The query traversal's poses are never used, so that the two drives
need not share a world frame.

An answer can be judged if its keyframe is paired with the query, or if both the keyframe and one paired with the query
have a pose in their traversal. An answer against any other keyframe counts as wrong.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import distances_and_angles
from relocbench.geometry import invert, rotation_angle

_ROUNDING = 1 + 1e-9


class MapTruth:
    """The true poses of the queries of one pair set in the map.

    Args:
        pair_set: a pair set with ground truth.
        query_times, keyframe_times: timestamps of queries and of the gallery's keyframes, nanoseconds.
    """

    def __init__(self, dataset: Dataset, pair_set: PairSet, query_times: list[int], keyframe_times: list[int]) -> None:
        self.pair_set = pair_set
        self.query_times = query_times
        self.keyframe_times = keyframe_times
        traversal = dataset.traversal(pair_set.reference)
        unknown = np.full((4, 4), np.nan)
        known = traversal.poses
        self._T_world_ref = np.array(
            [traversal.T_world_cam(pair_set.reference_camera, t) if t in known else unknown for t in keyframe_times]
        ).reshape(-1, 4, 4)
        place = {time: index for index, time in enumerate(keyframe_times)}
        self._paired: dict[int, list[tuple[int, Array]]] = {time: [] for time in query_times}
        for pair in pair_set.pairs:
            assert pair.T_query_ref is not None
            self._paired[pair.query_timestamp_ns].append((place[pair.ref_timestamp_ns], pair.T_query_ref))

    def relative(self, query: int) -> Array:
        """(G, 4, 4) true ``T_query_ref`` of a query (by index) against every keyframe; NaN where it is not known."""
        paired = self._paired[self.query_times[query]]
        out = np.full((len(self.keyframe_times), 4, 4), np.nan)
        posed = [(row, T) for row, T in paired if np.isfinite(self._T_world_ref[row]).all()]
        to = np.flatnonzero(np.isfinite(self._T_world_ref).all(axis=(1, 2)))
        if posed and to.size:
            rows = np.array([row for row, _ in posed])
            centres = self._T_world_ref[:, :3, 3]
            away = centres[to, None] - centres[None, rows]
            nearest = np.linalg.norm(away, axis=-1).argmin(axis=1)
            T_query_world = np.stack([T @ invert(self._T_world_ref[row]) for row, T in posed])
            out[to] = T_query_world[nearest] @ self._T_world_ref[to]
        for row, T_query_ref in paired:
            out[row] = T_query_ref
        return out

    @cached_property
    def reach(self) -> tuple[float, float]:
        """The largest distance (metres) and the largest angle (degrees) of a pair: how far the tracker must reach."""
        between = distances_and_angles(self.pair_set.pairs)
        return max(d for d, _ in between if d is not None), max(a for _, a in between if a is not None)

    def oracle(self, query: int, count: int) -> list[int]:
        """The keyframes ranked by the true pose.

        Those within the :attr:`reach` come first, nearest first; the others follow, nearest first.
        """
        T_query_ref = self.relative(query)
        metres, degrees = distance_and_angle(T_query_ref)
        known = np.flatnonzero(np.isfinite(metres))
        far = ~inside(metres[known], degrees[known], self.reach)
        out: list[int] = known[np.lexsort((metres[known], far))][:count].tolist()
        return out

    @cached_property
    def spread(self) -> Array:
        """(M,) metres by which the pairs of a query disagree about its position, for each query with several pairs.

        It is the largest distance between the camera centre by any pair and that by the first pair.
        """
        out = []
        for paired in self._paired.values():
            posed = [self._T_world_ref[row] @ invert(T) for row, T in paired]
            centres = np.array([T[:3, 3] for T in posed if np.isfinite(T).all()])
            if len(centres) > 1:
                out.append(float(np.linalg.norm(centres - centres[0], axis=1).max()))
        return np.array(out)


def distance_and_angle(T_query_ref: Array) -> tuple[Array, Array]:
    """Metres between the cameras and degrees between their orientations. (N, 4, 4) -> (N,), (N,); NaN stays NaN."""
    metres = np.linalg.norm(T_query_ref[:, :3, 3], axis=1)
    degrees = np.full(len(T_query_ref), np.nan)
    known = np.isfinite(metres)
    degrees[known] = np.degrees(rotation_angle(T_query_ref[known, :3, :3]))
    return metres, degrees


def inside(metres: Array, degrees: Array, limits: tuple[float, float]) -> Mask:
    """Whether both values are at most their limits; NaN is not."""
    return np.asarray((metres <= limits[0] * _ROUNDING) & (degrees <= limits[1] * _ROUNDING), dtype=np.bool_)
