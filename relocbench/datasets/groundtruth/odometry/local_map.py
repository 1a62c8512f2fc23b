"""A local map of the last scans, to which the next scan is fitted point to plane.

Point-to-point ICP errs by centimetres a step, since the rings of a spinning lidar move along with it over flat ground.
A distance from a plane does not depend on where the plane was hit. Chen and Medioni, Object modelling by registration
of multiple range images, IVC 1992.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.geometry import apply, make_transform, so3_exp

_VOXEL_M = 0.4
_FARTHEST_M = 60.0
_NEIGHBOURS = 12
_REACH_M = (1.0, 0.6, 0.4, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3)
"""greatest distance between a point and the plane that it is fitted to, by iteration"""
_SIGMA_M = 0.03
"""scale of the Cauchy kernel: larger residuals count less and less"""
_FLATNESS = 0.1
"""largest ratio of thickness to breadth, both as standard deviations, of neighbours that form a plane"""
_STILL_M, _STILL_RAD = 1e-5, 1e-6
_PRIOR_M, _PRIOR_RAD = 0.2, 0.02
"""standard deviations of the start; they hold directions that no plane constrains"""
_KEPT_SCANS = 30
_KEY_STEP_M = 0.5
_KEY_TURN_RAD = 0.1


class LocalMap:
    """Points with normals of the last key scans, in the fixed frame of the first scan."""

    def __init__(self) -> None:
        self._scans: deque[tuple[Array, Array]] = deque(maxlen=_KEPT_SCANS)
        self._last_key: Array | None = None
        self._tree: cKDTree | None = None
        self._points = np.empty((0, 3))
        self._normals = np.empty((0, 3))

    def fit(self, points: Array, T_map_lidar: Array) -> Array:
        """(4, 4) pose of a scan (N, 3), by robust Gauss-Newton from a pose that is right to decimetres."""
        if self._tree is None:
            return T_map_lidar
        source = _thinned(points)
        pose = T_map_lidar
        total = np.zeros(6)
        prior = np.repeat([1 / _PRIOR_M**2, 1 / _PRIOR_RAD**2], 3)
        for reach in _REACH_M:
            placed = apply(pose, source)
            distance, nearest = map(np.asarray, self._tree.query(placed, distance_upper_bound=reach, workers=1))
            near = np.isfinite(distance)
            normal, on_plane = self._normals[nearest[near]], self._points[nearest[near]]
            residual = np.sum(normal * (placed[near] - on_plane), axis=1)
            jacobian = np.hstack([normal, np.cross(placed[near] - pose[:3, 3], normal)])
            weight = 1.0 / (_SIGMA_M**2 + residual**2)
            # Unlike a matrix product, einsum adds in the same order for any number of threads.
            hessian = np.einsum("n,ni,nj->ij", weight, jacobian, jacobian) + np.diag(prior)
            gradient = np.einsum("n,ni,n->i", weight, jacobian, residual) + prior * total
            step = -np.linalg.solve(hessian, gradient)
            total += step
            pose = make_transform(so3_exp(step[3:]) @ pose[:3, :3], pose[:3, 3] + step[:3])
            if np.linalg.norm(step[:3]) < _STILL_M and np.linalg.norm(step[3:]) < _STILL_RAD:
                break
        return pose

    def insert(self, points: Array, T_map_lidar: Array) -> None:
        """Add a scan to the map if the lidar has moved or turned since the last one that was added."""
        if self._last_key is not None:
            moved = np.linalg.norm(T_map_lidar[:3, 3] - self._last_key[:3, 3])
            turned = np.arccos(np.clip((np.trace(self._last_key[:3, :3].T @ T_map_lidar[:3, :3]) - 1) / 2, -1, 1))
            if moved < _KEY_STEP_M and turned < _KEY_TURN_RAD:
                return
        self._last_key = T_map_lidar
        dense = apply(T_map_lidar, _thinned(points, _VOXEL_M / 2))
        placed = apply(T_map_lidar, _thinned(points))
        normals, flat = plane_normals(placed, np.concatenate([dense, self._points]))
        self._scans.append((placed[flat], normals[flat]))
        everything = np.concatenate([scan[0] for scan in self._scans])
        kept = first_in_voxels(everything, _VOXEL_M / 2)
        self._points = everything[kept]
        self._normals = np.concatenate([scan[1] for scan in self._scans])[kept]
        self._tree = cKDTree(self._points)


def _thinned(points: Array, voxel_m: float = _VOXEL_M) -> Array:
    """The first point in each voxel, of the points (N, 3) near the lidar."""
    near = points[np.sum(points**2, axis=1) < _FARTHEST_M**2]
    out: Array = near[first_in_voxels(near, voxel_m)]
    return out


def plane_normals(points: Array, around: Array) -> tuple[Array, Mask]:
    """Unit normals (N, 3), of either sign, of planes through the neighbours of points (N, 3); and (N,) where one fits.

    Args:
        around: (M, 3) the points among which neighbours are sought.
    """
    count = min(_NEIGHBOURS, len(around))
    _, neighbours = cKDTree(around).query(points, k=count, workers=1)
    group = around[np.asarray(neighbours).reshape(len(points), count)]
    centred = group - group.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    # Neighbours along one ring lie on a line, through which there are many planes.
    flat = (spread[:, 0] < _FLATNESS**2 * spread[:, 1]) & (spread[:, 1] > 0.01 * spread[:, 2])
    return axes[:, :, 0], flat
