"""The fit of what two lidars measured: points of one block, by one lidar, to planes of another block, by another lidar.

The two blocks may be of different drives or of the same one. As in
:mod:`relocbench.datasets.groundtruth.pose_graph.block_fits`, the normals of points and of planes are instrumental
variables for each other. The Hessian is that of the robust kernel itself, whose second derivative is smaller than the
weights that lead to its minimum (Huber, Robust Statistics, 1981): with the weights in its place a fit would seem more
certain than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.blocks import Block
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.calibration.pairs import Measured
from relocbench.datasets.groundtruth.pose_graph.edge_information import minimum, nearest_semidefinite, scatter_by_patch
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions, Planes, Sample, grid_planes
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys
from relocbench.geometry import so3_exp

CHARACTERISTIC_LENGTH_M, OPEN_SHARE = 10.0, 1e-4
"""see :mod:`relocbench.datasets.groundtruth.pose_graph.edge_information`"""
_SAMPLES = 800
_KEPT = 256
_PATCH_M = 1.0
"""size of the patches of surface on which errors are correlated"""


@dataclass(frozen=True)
class Reach:
    """How far points may be from their planes."""

    reach_m: float
    """largest distance of a match"""
    kernel_m: float
    """scale of Geman-McClure's kernel"""
    cosine: float = 0.8
    """cosine of the largest angle between the normals of a match"""


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """Distances from points of block b to planes of block a, linearised in xi = (rho, phi) of ``T_a_b @ se3_exp(xi)``:
    ``H xi + g = 0`` at the minimum."""

    H: Array
    """(6, 6)"""
    g: Array
    """(6,)"""
    scatter: Array
    """(6, 6) of the gradient over patches of surface"""
    count: int
    """number of matched points"""
    rig_a: Array
    """(3,) mean position of the rig when it measured the matched planes, in the frame of node a"""
    rig_b: Array
    """(3,) the same of the matched points, in the frame of node b"""


class LidarFits:
    """Computes fits of the blocks of two drives, whose points are kept in memory for a while."""

    def __init__(self, stores: tuple[BlockStore, BlockStore], T_rig_lidar: Sequence[Sequence[Array]]) -> None:
        """
        Args:
            T_rig_lidar: of each drive, (4, 4) extrinsics of each lidar as they are given.
        """
        self._stores, self._mounts = stores, T_rig_lidar
        self._maps = lru_cache(maxsize=_KEPT)(self._make)

    def _make(self, which: Measured, reach_m: float) -> PlaneMap:
        block = self._stores[which.drive].get(which.node)
        mine = slice(None) if block.lidar is None else block.lidar == which.lidar
        own = Block(*(getattr(block, name)[mine] for name in ("points", "normals", "origins", "surface", "steady")))
        # The rig was where the sensor is, less its lever arm; within a block it hardly turns.
        rig = own.origins - self._mounts[which.drive][which.lidar][:3, 3].astype(np.float32)
        options = PlaneOptions(thinning_m=(0.0,), reach_m=(reach_m,), samples=(_SAMPLES,), near_m=(1e9,), rough=0.0)
        return PlaneMap(replace(own, origins=rig), options)

    def fit(self, a: Measured, b: Measured, T_a_b: Array, u: tuple[Array, Array], reach: Reach) -> CalibrationFit:
        """The fit at a pose of the nodes (4, 4), and with corrections ``u`` = (u_a, u_b), each (6,), of what the lidars
        measured. Raises DatasetError if a block is missing or damaged."""
        planes = moved_planes(self._maps(a, reach.reach_m).level(0), u[0])
        points = moved(self._maps(b, reach.reach_m).sample(0), u[1])
        R = T_a_b[:3, :3]
        there = points.points @ R.T + T_a_b[:3, 3]
        match = planes.nearest(there, points.normals @ R.T, reach.reach_m, reach.cosine)
        rows = np.flatnonzero(match >= 0)
        match, q, own, n = match[rows], points.points[rows], points.normals[rows], planes.normals[match[rows]]
        residuals = np.einsum("ni,ni->n", n, there[rows] - planes.points[match])
        square = np.square(residuals / reach.kernel_m)
        surface = np.minimum(planes.weights[match], points.weights[rows])
        weights = surface / np.square(1 + square)
        slopes = surface * np.maximum(1 - 3 * square, 0.0) / (1 + square) ** 3
        by_planes, by_points = np.hstack([n @ R, np.cross(q, n @ R)]), np.hstack([own, np.cross(q, own)])
        H = nearest_semidefinite((slopes[:, None] * by_points).T @ by_planes, CHARACTERISTIC_LENGTH_M)
        g = by_points.T @ (weights * residuals)
        left = residuals + by_planes @ minimum(H, g, CHARACTERISTIC_LENGTH_M, OPEN_SHARE)
        scatter = scatter_by_patch((weights * left)[:, None] * by_points, _patches(q, own))
        rig_a, rig_b = (_mean(arms, weights) for arms in (planes.lever_arms[match], points.lever_arms[rows]))
        return CalibrationFit(H, g, scatter, len(rows), rig_a, rig_b)


def _patches(points: Array, normals: Array) -> Indices:
    """(M,) number of the patch of surface that each point lies on."""
    facing = np.argmax(np.abs(normals), axis=1) if len(normals) else np.zeros(0, dtype=np.int64)
    return np.asarray(4 * voxel_keys(points, _PATCH_M) + facing)


def _mean(places: Array, weights: Array) -> Array:
    total = float(weights.sum())
    return np.asarray(weights @ places / total) if total > 0 else np.zeros(3)


def moved(sample: Sample, u: Array) -> Sample:
    """Points as they lie after a correction u (6,): each moves with the frame of the rig at the time of its beam.

    The lever arms are the rig's positions.
    """
    if not u.any():
        return sample
    R = so3_exp(u[3:])
    points = sample.lever_arms + (sample.points - sample.lever_arms) @ R.T + u[:3]
    return Sample(points, sample.normals @ R.T, sample.weights, sample.lever_arms)


def moved_planes(planes: Planes, u: Array) -> Planes:
    """Planes as they lie after a correction u (6,), sorted anew."""
    if not u.any():
        return planes
    there = moved(planes, u)
    return grid_planes(there.points, there.normals, there.weights, there.lever_arms, planes.grid.size_m)
