"""How single blocks of two drives fit each other: what the local edges of the graph are made of.

Normals are noisy. The square of a wall's thousand normals, each a few degrees off, looks like a few surfaces that face
along the street; so a bare wall would claim to know where along it one is, and always: just here. What two drives
measured of the same surface errs independently, so the normals of one stand in for those of the other in one factor of
each product: they are its instrument (Durbin, Errors in variables, 1954), and noise no longer counts as knowledge.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.pose_graph.edge_information import minimum, nearest_semidefinite, scatter_by_patch
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalFit
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions, Planes, Sample
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys
from relocbench.geometry import robust_sigma

Array = NDArray[np.float64]

_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(1500,), near_m=(1e9,))
_KEPT = 64
_SCALE_M = 0.05
_REACH_M = 0.2
_COSINE = 0.8
"""of the largest angle between normals that may meet"""
_PATCH_M = 1.0
"""side of the patches of surface on which points err alike"""
_CHARACTERISTIC_LENGTH_M, _OPEN_SHARE = 10.0, 1e-4
"""see :class:`relocbench.datasets.groundtruth.pose_graph.local_edges.LocalOptions`"""


class BlockFits:
    """Distances from points of a query's block to planes of a reference's block.

    Each block's planes and points are made once and kept while neighbours ask for them.
    """

    def __init__(self, reference: BlockStore, query: BlockStore) -> None:
        self._stores = reference, query
        self._kept: OrderedDict[tuple[int, int], PlaneMap] = OrderedDict()

    def __call__(self, ref: int, query: int, T_ref_query: Array, /) -> LocalFit:
        """The fit at a pose ``T_ref_query`` (4, 4), node to node."""
        planes, points = self._planes(0, ref).level(0), self._planes(1, query).sample(0)
        met = match_points(planes, points, T_ref_query)
        H = nearest_semidefinite(met.by_points.T @ (met.weights[:, None] * met.by_planes), _CHARACTERISTIC_LENGTH_M)
        gradients = (met.weights * met.residuals)[:, None] * met.by_points
        g = gradients.sum(axis=0)
        sigma = robust_sigma(met.residuals, met.weights) if len(met) else 0.0
        # Where the fit of this block alone would lie, its points say how far they disagree.
        left = met.residuals + met.by_planes @ minimum(H, g, _CHARACTERISTIC_LENGTH_M, _OPEN_SHARE)
        scatter = scatter_by_patch((met.weights * left)[:, None] * met.by_points, met.patches)
        return LocalFit(H, g, sigma, len(met), scatter)

    def _planes(self, side: int, node: int) -> PlaneMap:
        key = side, node
        if key in self._kept:
            self._kept.move_to_end(key)
        else:
            self._kept[key] = PlaneMap(as_submap(self._stores[side], node), _OPTIONS)
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return self._kept[key]


@dataclass(frozen=True, eq=False)
class Matches:
    """Points of a query's block that lie near a plane of a reference's block."""

    by_planes: Array
    """(M, 6) derivative of the distance by xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)``"""
    by_points: Array
    """(M, 6) the same with the point's normal in place of the plane's"""
    residuals: Array
    """(M,) distances, metres"""
    weights: Array
    """(M,) by surface, steadiness and distance (Geman-McClure)"""
    patches: NDArray[np.int64]
    """(M,) points on the same metre of surface have the same number"""

    def __len__(self) -> int:
        return len(self.residuals)


def match_points(planes: Planes, points: Sample, T_ref_query: Array) -> Matches:
    """The residual of a point q with the plane (p, n) is ``r = n^T (R q + t - p)``, its derivative ``(m, q x m)`` with
    m = R^T n, or the point's own normal."""
    rotation, translation = T_ref_query[:3, :3], T_ref_query[:3, 3]
    there = points.points @ rotation.T + translation
    match = planes.nearest(there, points.normals @ rotation.T, _REACH_M, _COSINE)
    rows = np.flatnonzero(match >= 0)
    match, q = match[rows], points.points[rows]
    n = planes.normals[match]
    residuals = np.einsum("ni,ni->n", n, there[rows] - planes.points[match])
    weights = np.minimum(planes.weights[match], points.weights[rows]) / np.square(1 + np.square(residuals / _SCALE_M))
    by_planes, by_points = (np.hstack([m, np.cross(q, m)]) for m in (n @ rotation, points.normals[rows]))
    facing = np.argmax(np.abs(points.normals[rows]), axis=1) if len(rows) else rows
    return Matches(by_planes, by_points, residuals, weights, 4 * voxel_keys(q, _PATCH_M) + facing)


def as_submap(store: BlockStore, node: int) -> Submap:
    """One block on its own."""
    block = store.get(node)
    numbers = np.full(len(block), node, dtype=np.int32)
    return Submap(node, block.points, block.normals, block.origins, block.surface, block.steady, numbers)
