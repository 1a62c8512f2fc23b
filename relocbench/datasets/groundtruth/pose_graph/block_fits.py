"""The fit of single blocks of two drives, from which the local edges of the pose graph are made.

Normals are noisy. In sums of their squares, a wall's thousand normals, each a few degrees off, look like a few
surfaces that face along the street: a bare wall would seem to fix the position along it, always at the present
estimate. The normals that two drives measured on the same surface have independent noise. Each product therefore has
one factor from either drive, the normals of one being instrumental variables for those of the other (Durbin, Errors in
variables, 1954), so that noise does not count as information.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.pose_graph.edge_information import (
    minimum,
    nearest_semidefinite,
    patches_of,
    scatter_by_patch,
)
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalFit
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions, Planes, Sample

_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(1500,), near_m=(1e9,))
_KEPT = 64
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

    The planes and points of the blocks used last are kept in memory.
    """

    def __init__(self, reference: BlockStore, query: BlockStore) -> None:
        self._stores = reference, query
        self._planes = lru_cache(maxsize=_KEPT)(self._make_planes)

    def __call__(self, ref: int, query: int, T_ref_query: Array, /) -> LocalFit:
        """The fit of two blocks, named by their nodes, at a pose ``T_ref_query`` (4, 4)."""
        planes, points = self._planes(0, ref).level(0), self._planes(1, query).sample(0)
        matches = match_points(planes, points, T_ref_query)
        of_patches = weights_of_patches(matches.residuals, matches.patches)
        weights = of_patches * matches.weights
        product = matches.by_points.T @ ((of_patches * matches.slopes)[:, None] * matches.by_planes)
        H = nearest_semidefinite(product)
        gradients = (weights * matches.residuals)[:, None] * matches.by_points
        g = gradients.sum(axis=0)
        # The scatter is that of the residuals which are left at the minimum of this fit.
        left = matches.residuals + matches.by_planes @ minimum(H, g)
        scatter = scatter_by_patch((weights * left)[:, None] * matches.by_points, matches.patches)
        return LocalFit(H, g, scatter, len(matches))

    def _make_planes(self, side: int, node: int) -> PlaneMap:
        return PlaneMap(self._stores[side].get(node), _OPTIONS)


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
    rotation, translation = T_ref_query[:3, :3], T_ref_query[:3, 3]
    moved = points.points @ rotation.T + translation
    match = planes.nearest(moved, points.normals @ rotation.T, _REACH_M, _COSINE)
    rows = np.flatnonzero(match >= 0)
    match, q = match[rows], points.points[rows]
    n = planes.normals[match]
    residuals = np.einsum("ni,ni->n", n, moved[rows] - planes.points[match])
    surface, square = np.minimum(planes.weights[match], points.weights[rows]), np.square(residuals / _SCALE_M)
    weights = surface / np.square(1 + square)
    slopes = surface * np.maximum(1 - 3 * square, 0.0) / (1 + square) ** 3
    by_planes, by_points = (np.hstack([m, np.cross(q, m)]) for m in (n @ rotation, points.normals[rows]))
    patches = patches_of(q, points.normals[rows], _PATCH_M)
    return Matches(by_planes, by_points, residuals, weights, slopes, patches, q)


def weights_of_patches(residuals: Array, patches: Indices) -> Array:
    """(M,) weights of points by the mean distance of the patch that they lie on (Geman-McClure).

    Noise moves the points of a patch to both sides of a plane. A patch that is off as a whole has moved between the
    drives: a windscreen of a car that is parked 6 cm off has not one point far enough off to be an outlier, but pulls a
    block by as many points as a facade has.

    Args:
        residuals: (M,) distances, metres.
        patches: (M,) number of the patch of surface that each point lies on.
    """
    _, patch, count = np.unique(patches, return_inverse=True, return_counts=True)
    mean = np.bincount(patch, residuals) / count
    square = np.square(mean) / (_MOVED_M**2 + _SCALE_M**2 / count)
    return np.asarray(1 / np.square(1 + square))[patch]
