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

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Block
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.calibration.pairs import Measured
from relocbench.datasets.groundtruth.pose_graph.edge_information import geman_mcclure, normal_equations, patches_of
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalFit
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions, nearest_plane, wrenches
from relocbench.datasets.groundtruth.voxels.voxels import Grid
from relocbench.geometry import so3_exp
from relocbench.kernels import njit

REACHES_M = (0.8, 0.25)
"""largest distances of a match, coarse and fine"""
_OPTIONS = PlaneOptions(thinning_m=(0.2, 0.0), reach_m=REACHES_M, samples=(400, 800), near_m=(1e9, 1e9), rough=0.0)
_KEPT = 4096
"""blocks of single lidars in memory, each of some 100 KiB: all that are compared, so that none is prepared twice"""
_PATCH_M = 1.0
"""size of the patches of surface on which errors are correlated"""


@dataclass(frozen=True)
class Reach:
    """How far points may be from their planes."""

    level: int
    """number of the largest distance of a match, in :data:`REACHES_M`"""
    kernel_m: float
    """scale of Geman-McClure's kernel"""
    cosine: float = 0.8
    """cosine of the largest angle between the normals of a match"""


Correction = tuple[Array, Array]
"""rotation R (3, 3) and shift t (3,): what a lidar measured moves with the frame of the rig at the time of its beam,
``rig + R (p - rig) + t``"""


@dataclass(frozen=True, eq=False)
class CalibrationFit(LocalFit):
    """Distances from points of block b to planes of block a, linearised in xi = (rho, phi) of ``T_a_b @ se3_exp(xi)``:
    ``H xi + g = 0`` at the minimum."""

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

    def _make(self, which: Measured) -> PlaneMap:
        block = self._stores[which.drive].get(which.node)
        mine = slice(None) if block.lidar is None else block.lidar == which.lidar
        own = Block(*(getattr(block, name)[mine] for name in ("points", "normals", "origins", "surface", "steady")))
        # The rig was where the sensor is, less its lever arm; within a block it hardly turns.
        rig = own.origins - self._mounts[which.drive][which.lidar][:3, 3].astype(np.float32)
        return PlaneMap(replace(own, origins=rig), _OPTIONS)

    def fit(
        self, a: Measured, b: Measured, T_a_b: Array, corrections: tuple[Correction, Correction], reach: Reach
    ) -> CalibrationFit:
        """The fit at a pose of the nodes (4, 4), and with corrections of what the lidars measured.

        Raises DatasetError if a block is missing or damaged.
        """
        planes, points = self._maps(a).level(reach.level), self._maps(b).sample(reach.level)
        (R_a, t_a), (R_b, t_b) = corrections
        # Planes are sorted as they were measured, so they are found from where the points lie without the correction
        # of the planes, turned about the middle of where the rig was. Distances are from the corrected planes.
        middle = planes.lever_arms.mean(axis=0) if len(planes) else np.zeros(3)
        of_points = points.points, points.normals, points.weights, points.lever_arms
        of_planes = planes.points, planes.normals, planes.weights, planes.lever_arms
        return CalibrationFit(*_fit(
            *of_points, *of_planes, planes.grid, R_b, t_b, np.ascontiguousarray(T_a_b), R_a, t_a, middle,
            REACHES_M[reach.level], reach.cosine, reach.kernel_m,
        ))  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    points: Array, normals: Array, of_points: Array, rigs_b: Array, planes: Array, facing: Array, of_planes: Array,
    rigs_a: Array, grid: Grid, R_b: Array, t_b: Array, T_a_b: Array, R_a: Array, t_a: Array, middle: Array,
    reach: float, cosine: float, kernel: float,
) -> tuple[Array, Array, Array, int, Array, Array]:  # fmt: skip
    """What a :class:`CalibrationFit` holds."""
    moved, turned, back, back_turned = placed(points, normals, rigs_b, R_b, t_b, T_a_b, R_a, t_a, middle)
    rows, match, count = np.empty(len(points), np.int64), np.empty(len(points), np.int64), 0
    for i in range(len(points)):
        match[count] = nearest_plane(back[i], back_turned[i], planes, facing, grid, reach, cosine)
        rows[count] = i
        count += match[count] >= 0
    rows, match = rows[:count], match[:count]
    q, own = moved[rows], turned[rows]
    by_planes, residuals = distances(q, planes[match], facing[match], rigs_a[match], T_a_b, R_a, t_a)
    weights, slopes = geman_mcclure(residuals, np.minimum(of_planes[match], of_points[rows]), kernel)
    patches = patches_of(q, own, _PATCH_M)
    H, g, scatter = normal_equations(wrenches(own, q), by_planes, residuals, weights, slopes, patches)
    return H, g, scatter, count, _mean(rigs_a[match], weights), _mean(rigs_b[rows], weights)


@njit(cache=True, nogil=True, error_model="numpy")
def _mean(places: Array, weights: Array) -> Array:
    """(3,) weighted mean of places (M, 3)."""
    total = weights.sum()
    return weights @ places / total if total > 0 else np.zeros(3)


def corrections_of(u: Array) -> list[Correction]:
    """Corrections of twists (N, 6)."""
    return list(zip(so3_exp(u[:, 3:]), np.ascontiguousarray(u[:, :3]), strict=True))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _turn(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def placed(
    points: Array, normals: Array, rigs: Array, R_b: Array, t_b: Array, T_a_b: Array, R_a: Array, t_a: Array,
    middle: Array,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Points and normals (N, 3) of block b, corrected, in the frame of node b and in that of node a before the
    correction of block a: corrected points, corrected normals, points to search from, normals to search with."""
    n = len(points)
    moved, facing, back, back_facing = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    inverse, T = R_a.T.copy(), T_a_b
    for i in range(n):
        x, y, z = _turn(R_b, points[i, 0] - rigs[i, 0], points[i, 1] - rigs[i, 1], points[i, 2] - rigs[i, 2])
        x, y, z = x + rigs[i, 0] + t_b[0], y + rigs[i, 1] + t_b[1], z + rigs[i, 2] + t_b[2]
        moved[i, 0], moved[i, 1], moved[i, 2] = x, y, z
        x, y, z = _turn(T, x, y, z)
        x, y, z = x + T[0, 3] - t_a[0], y + T[1, 3] - t_a[1], z + T[2, 3] - t_a[2]
        x, y, z = _turn(inverse, x - middle[0], y - middle[1], z - middle[2])
        back[i, 0], back[i, 1], back[i, 2] = x + middle[0], y + middle[1], z + middle[2]
        x, y, z = _turn(R_b, normals[i, 0], normals[i, 1], normals[i, 2])
        facing[i, 0], facing[i, 1], facing[i, 2] = x, y, z
        x, y, z = _turn(T, x, y, z)
        x, y, z = _turn(inverse, x, y, z)
        back_facing[i, 0], back_facing[i, 1], back_facing[i, 2] = x, y, z
    return moved, facing, back, back_facing


@njit(cache=True, nogil=True, error_model="numpy")
def distances(
    q: Array, points: Array, normals: Array, rigs: Array, T_a_b: Array, R_a: Array, t_a: Array
) -> tuple[Array, Array]:
    """(M, 6) derivatives of the distances of points q (M, 3) from planes (M, 3) that are corrected, and these (M,)."""
    J, residuals, T = np.empty((len(q), 6)), np.empty(len(q)), T_a_b
    inverse = T[:3, :3].T.copy()
    for i in range(len(q)):
        x, y, z = _turn(R_a, points[i, 0] - rigs[i, 0], points[i, 1] - rigs[i, 1], points[i, 2] - rigs[i, 2])
        x, y, z = x + rigs[i, 0] + t_a[0], y + rigs[i, 1] + t_a[1], z + rigs[i, 2] + t_a[2]
        a, b, c = _turn(R_a, normals[i, 0], normals[i, 1], normals[i, 2])
        px, py, pz = _turn(T, q[i, 0], q[i, 1], q[i, 2])
        residuals[i] = a * (px + T[0, 3] - x) + b * (py + T[1, 3] - y) + c * (pz + T[2, 3] - z)
        a, b, c = _turn(inverse, a, b, c)
        J[i, 0], J[i, 1], J[i, 2] = a, b, c
        J[i, 3], J[i, 4], J[i, 5] = q[i, 1] * c - q[i, 2] * b, q[i, 2] * a - q[i, 0] * c, q[i, 0] * b - q[i, 1] * a
    return J, residuals
