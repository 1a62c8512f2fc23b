"""The fit of single blocks of two drives, from which the local edges of the pose graph are made.

Normals are noisy. In sums of their squares, a wall's thousand normals, each a few degrees off, look like a few
surfaces that face along the street: a bare wall would seem to fix the position along it, always at the present
estimate. The normals that two drives measured on the same surface have independent noise. Each product therefore has
one factor from either drive, the normals of one being instrumental variables for those of the other (Durbin, Errors in
variables, 1954), so that noise does not count as information.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Generic, TypeVar

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.pose_graph.edge_information import geman_mcclure, normal_equations, patches_of
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalFit
from relocbench.datasets.groundtruth.submaps.planes import (
    PlaneMap,
    PlaneOptions,
    Planes,
    Sample,
    nearest_plane,
    wrenches,
)
from relocbench.datasets.groundtruth.voxels.voxels import Grid
from relocbench.kernels import njit

_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(1500,), near_m=(1e9,))
_KEPT = 16
"""blocks that neighbours of a block are tied to"""
_MOST_POINTS = 1_000_000
"""of each drive that are kept in memory, some 130 bytes each"""
Points = TypeVar("Points", bound=Sample)
_SCALE_M = 0.05
_REACH_M = 0.2
_COSINE = 0.8
"""cosine of the largest angle between the normals of a match"""
_PATCH_M = 1.0
"""size of the patches of surface on which errors are correlated"""
_MOVED_M = 0.015
"""mean distance of a patch, of very many points, at which its points have a weight of 1/4"""


class BlockFits:
    """Computes the distances from points of a query block to planes of a reference block, linearised.

    Planes and points are kept in memory as far as there is room.
    """

    def __init__(self, reference: BlockStore, query: BlockStore) -> None:
        self._planes = _Kept(lambda node: PlaneMap(reference.get(node), _OPTIONS).level(0))
        self._samples = _Kept(lambda node: PlaneMap(query.get(node), _OPTIONS).sample(0))

    def __call__(self, ref: int, query: int, T_ref_query: Array, /) -> LocalFit:
        """The fit of two blocks, named by their nodes, at a pose ``T_ref_query`` (4, 4)."""
        planes, points = self._planes(ref), self._samples(query)
        m = match_points(planes, points, T_ref_query)
        of_patches = weights_of_patches(m.residuals, m.patches)
        return LocalFit(
            *normal_equations(
                m.by_points, m.by_planes, m.residuals, of_patches * m.weights, of_patches * m.slopes, m.patches
            ),
            len(m),
        )


class _Kept(Generic[Points]):
    """Points of blocks. Each iteration asks for all of them in the same order, so that what was made first is kept."""

    def __init__(self, make: Callable[[int], Points]) -> None:
        self._recent = lru_cache(maxsize=_KEPT)(make)
        self._first: dict[int, Points] = {}
        self._room = _MOST_POINTS

    def __call__(self, node: int) -> Points:
        if node in self._first:
            return self._first[node]
        points = self._recent(node)
        if len(points) <= self._room:
            self._first[node] = points
            self._room -= len(points)
        return points


@dataclass(frozen=True, eq=False)
class Matches:
    """Points of a query block that are matched to planes of a reference block."""

    by_planes: Array
    """(M, 6) derivative of the distances by xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)``"""
    by_points: Array
    """(M, 6) the same, with the normals of the points in place of those of the planes"""
    residuals: Array
    """(M,) distances, metres"""
    weights: Array
    """(M,) weights by surface, static score and distance (Geman-McClure)"""
    slopes: Array
    """(M,) derivatives of the weighted distances by the distance, at least 0; they stand for the weights in H"""
    patches: Indices
    """(M,) number of the patch of surface that each point lies on"""
    points: Array
    """(M, 3) the points, in the query's frame"""

    def __len__(self) -> int:
        return len(self.residuals)


def match_points(planes: Planes, points: Sample, T_ref_query: Array) -> Matches:
    """Match points to planes.

    The residual of a point q with the plane (p, n) is ``r = n^T (R q + t - p)``, and its derivative is ``(m, q x m)``
    with m = R^T n, or with the point's own normal as m.
    """
    R, t = np.ascontiguousarray(T_ref_query[:3, :3]), np.ascontiguousarray(T_ref_query[:3, 3])
    return Matches(*_matched(
        points.points, points.normals, points.weights, planes.points, planes.normals, planes.weights, planes.grid, R, t
    ))  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _matched(
    points: Array, normals: Array, weights: Array, planes: Array, facing: Array, of_planes: Array, grid: Grid,
    R: Array, t: Array,
) -> tuple[Array, Array, Array, Array, Array, Indices, Array]:  # fmt: skip
    rows, match = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    moved, turned = np.empty(3), np.empty(3)
    count = 0
    for i in range(len(points)):
        for k in range(3):
            moved[k] = R[k, 0] * points[i, 0] + R[k, 1] * points[i, 1] + R[k, 2] * points[i, 2] + t[k]
            turned[k] = R[k, 0] * normals[i, 0] + R[k, 1] * normals[i, 1] + R[k, 2] * normals[i, 2]
        match[count] = nearest_plane(moved, turned, planes, facing, grid, _REACH_M, _COSINE)
        rows[count] = i
        count += match[count] >= 0
    q, own, m = points[rows[:count]], normals[rows[:count]], np.empty((count, 3))
    residuals, surface = np.empty(count), np.empty(count)
    for i in range(count):
        j, n = match[i], facing[match[i]]
        residuals[i] = 0.0
        for k in range(3):
            there = R[k, 0] * q[i, 0] + R[k, 1] * q[i, 1] + R[k, 2] * q[i, 2] + t[k]
            residuals[i] += n[k] * (there - planes[j, k])
            m[i, k] = R[0, k] * n[0] + R[1, k] * n[1] + R[2, k] * n[2]
        surface[i] = min(of_planes[j], weights[rows[i]])
    robust, slopes = geman_mcclure(residuals, surface, _SCALE_M)
    return wrenches(m, q), wrenches(own, q), residuals, robust, slopes, patches_of(q, own, _PATCH_M), q


@njit(cache=True, nogil=True, error_model="numpy")
def weights_of_patches(residuals: Array, patches: Indices) -> Array:
    """(M,) weights of points by the mean distance of the patch that they lie on (Geman-McClure).

    Noise moves the points of a patch to both sides of a plane. A patch that is off as a whole has moved between the
    drives: a windscreen of a car that is parked 6 cm off has not one point far enough off to be an outlier, but pulls a
    block by as many points as a facade has.

    Args:
        residuals: (M,) distances, metres.
        patches: (M,) number of the patch of surface that each point lies on.
    """
    size = patches.max() + 1 if len(patches) else 0
    sums, counts = np.zeros(size), np.zeros(size)
    for i in range(len(patches)):
        sums[patches[i]] += residuals[i]
        counts[patches[i]] += 1
    weights = np.empty(len(patches))
    for i in range(len(patches)):
        count = counts[patches[i]]
        square = (sums[patches[i]] / count) ** 2 / (_MOVED_M**2 + _SCALE_M**2 / count)
        weights[i] = 1 / (1 + square) ** 2
    return weights
