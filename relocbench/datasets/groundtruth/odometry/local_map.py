"""A short memory of a lidar's surroundings, to which a scan is fitted point to plane.

Scan matching point to point leaves centimetres a step, since the rings of a spinning lidar move with it over flat
ground. Planes do not care where on them they were hit. Chen and Medioni, Object modelling by registration of multiple
range images, IVC 1992.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from relocbench.geometry import apply, make_transform, so3_exp

Array = NDArray[np.float64]

_VOXEL_M = 0.4
_FARTHEST_M = 60.0
_NEIGHBOURS = 12
_REACH_M = (1.0, 0.6, 0.4, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3)
"""farthest plane a point is fitted to, by iteration"""
_SIGMA_M = 0.03
"""residuals beyond count less and less (Cauchy)"""
_FLATNESS = 0.1
"""of a neighbourhood that makes a plane: its thickness over its breadth, as standard deviations"""
_STILL_M, _STILL_RAD = 1e-5, 1e-6
_PRIOR_M, _PRIOR_RAD = 0.2, 0.02
"""how far the start may be off, for directions that no plane fixes"""
_KEPT_SCANS = 30
_KEY_STEP_M = 0.5
_KEY_TURN_RAD = 0.1


class LocalMap:
    """Points with normals of the last key scans, in a frame that does not move."""

    def __init__(self) -> None:
        self._scans: deque[tuple[Array, Array]] = deque(maxlen=_KEPT_SCANS)
        self._last_key: Array | None = None
        self._tree: cKDTree | None = None
        self._points = np.empty((0, 3))
        self._normals = np.empty((0, 3))

    def fit(self, points: Array, T_map_lidar: Array) -> Array:
        """(4, 4) refined pose of a scan (N, 3), robust Gauss-Newton from a start that is right to decimetres."""
        if self._tree is None:
            return T_map_lidar
        source = thinned(points)
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
            # einsum adds in one order, whatever the number of threads of a matrix product.
            hessian = np.einsum("n,ni,nj->ij", weight, jacobian, jacobian) + np.diag(prior)
            gradient = np.einsum("n,ni,n->i", weight, jacobian, residual) + prior * total
            step = -np.linalg.solve(hessian, gradient)
            total += step
            pose = make_transform(so3_exp(step[3:]) @ pose[:3, :3], pose[:3, 3] + step[:3])
            if np.linalg.norm(step[:3]) < _STILL_M and np.linalg.norm(step[3:]) < _STILL_RAD:
                break
        return pose

    def insert(self, points: Array, T_map_lidar: Array) -> None:
        """Remember a scan, if the lidar has gone on or turned since the last one that was kept."""
        if self._last_key is not None:
            moved = np.linalg.norm(T_map_lidar[:3, 3] - self._last_key[:3, 3])
            turned = np.arccos(np.clip((np.trace(self._last_key[:3, :3].T @ T_map_lidar[:3, :3]) - 1) / 2, -1, 1))
            if moved < _KEY_STEP_M and turned < _KEY_TURN_RAD:
                return
        self._last_key = T_map_lidar
        dense = apply(T_map_lidar, thinned(points, _VOXEL_M / 2))
        placed = apply(T_map_lidar, thinned(points))
        normals, flat = plane_normals(placed, np.concatenate([dense, self._points]))
        self._scans.append((placed[flat], normals[flat]))
        everything = np.concatenate([scan[0] for scan in self._scans])
        kept = _first_of_voxels(everything, _VOXEL_M / 2)
        self._points = everything[kept]
        self._normals = np.concatenate([scan[1] for scan in self._scans])[kept]
        self._tree = cKDTree(self._points)


def thinned(points: Array, voxel_m: float = _VOXEL_M) -> Array:
    """The first point of each voxel, of those near enough."""
    near = points[np.sum(points**2, axis=1) < _FARTHEST_M**2]
    return near[_first_of_voxels(near, voxel_m)]


def _first_of_voxels(points: Array, voxel_m: float) -> NDArray[np.int64]:
    """Indices, in order."""
    cells = np.floor(points / voxel_m).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    span = cells.max(axis=0, initial=0) + 1
    # One number a voxel sorts many times faster than three.
    _, first = np.unique((cells[:, 0] * span[1] + cells[:, 1]) * span[2] + cells[:, 2], return_index=True)
    return np.sort(first)


def plane_normals(points: Array, around: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Unit normals (N, 3), of either sign, of planes through the neighbours of points (N, 3), and where there are any.

    Args:
        around: (M, 3) among which neighbours are sought.
    """
    count = min(_NEIGHBOURS, len(around))
    _, neighbours = cKDTree(around).query(points, k=count, workers=1)
    group = around[np.asarray(neighbours).reshape(len(points), count)]
    centred = group - group.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    # Neighbours along one ring make a line, which lies in many planes.
    flat = (spread[:, 0] < _FLATNESS**2 * spread[:, 1]) & (spread[:, 1] > 0.01 * spread[:, 2])
    return axes[:, :, 0], flat
