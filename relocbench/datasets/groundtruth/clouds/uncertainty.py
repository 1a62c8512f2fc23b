"""The final fit of two clouds, and its covariance from the scatter of what the fit leaves, patch by patch of surface.

Points of both clouds are matched to planes of the other. Each product of normals has one factor of either cloud, so
that their noise does not count as information, as in :mod:`relocbench.datasets.groundtruth.pose_graph.block_fits`.
Errors on one patch of surface are correlated, whichever cloud's points they are measured with, and are summed before
they are squared, as in :mod:`relocbench.datasets.groundtruth.pose_graph.edge_information`. Patches are large, since the
distortions of real scans are smooth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.pose_graph.block_fits import Matches, match_points
from relocbench.datasets.groundtruth.pose_graph.edge_information import (
    minimum,
    nearest_semidefinite,
    sandwich_information,
    scatter_by_patch,
)
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys
from relocbench.geometry import adjoint, apply, invert, project_to_rotation, se3_exp

_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(9000,), near_m=(1e9,))
_PATCH_M = 8.0
"""size of the patches of surface on which errors are correlated"""
_LENGTH_M, _OPEN_SHARE = 10.0, 1e-5
"""characteristic length of rotations, and the share of the largest eigenvalue below which a direction is open"""
_ITERATIONS, _STILL_M = 8, 1e-4
_LEAST_SIGMA_M, _CORRELATION = 0.003, 4.0
"""least standard deviation of a distance, and the factor by which correlation multiplies its variance"""
_OPEN = 1e-4
"""information added to every direction, so that open ones have a sigma of 100 m or 100 rad, enlarged"""
_OUTSIDE = 1.5
"""factor of all standard deviations, found on simulated scans of streets and rooms with exact truth"""


_SHARED_M, _SHARED_RAD = 0.001, 5e-5
"""standard deviations, enlarged, of errors that all patches share, such as those of fitting planes"""


class FinePlanes:
    """The planes of one cloud at full density, for the final fit."""

    def __init__(self, submap: Submap) -> None:
        planes = PlaneMap(submap, _OPTIONS)
        self.planes, self.points = planes.level(0), planes.sample(0)


@dataclass(frozen=True, eq=False)
class FinalFit:
    """The pose at the minimum of the final fit."""

    T_ref_query: Array
    """(4, 4)"""
    information: Array
    """(6, 6) of xi = (rho, phi) in ``T_ref_query @ se3_exp(xi)``"""
    residuals: tuple[Array, Array]
    """distances of the query's points from the reference's planes, and of the reference's from the query's"""


@dataclass(frozen=True, eq=False)
class _Problem:
    H: Array
    g: Array
    by_points: Array
    by_planes: Array
    residuals: tuple[Array, Array]
    weights: Array
    patches: Indices


def final_fit(ref: FinePlanes, query: FinePlanes, T_ref_query: Array) -> FinalFit:
    """Refine a pose that is right to centimetres, and estimate its information."""
    T = np.array(T_ref_query, dtype=np.float64)
    problem = _problem(ref, query, T)
    for _ in range(_ITERATIONS):
        xi = minimum(problem.H, problem.g, _LENGTH_M, _OPEN_SHARE)
        if not np.isfinite(xi).all() or np.linalg.norm(xi[:3]) > 0.2 or np.linalg.norm(xi[3:]) > 0.02:
            break
        T = T @ se3_exp(xi)
        T[:3, :3] = project_to_rotation(T[:3, :3])
        problem = _problem(ref, query, T)
        if np.linalg.norm(xi[:3]) < _STILL_M and np.linalg.norm(xi[3:]) < _STILL_M / _LENGTH_M:
            break
    left = np.concatenate(problem.residuals)
    left = left + problem.by_planes @ minimum(problem.H, problem.g, _LENGTH_M, _OPEN_SHARE)
    scatter = scatter_by_patch((problem.weights * left)[:, None] * problem.by_points, problem.patches)
    information = sandwich_information(problem.H, scatter, _CORRELATION * _LEAST_SIGMA_M**2, _LENGTH_M)
    covariance = np.linalg.inv(information / _OUTSIDE**2 + _OPEN * np.eye(6))
    shared = np.diag(np.square(np.repeat([_SHARED_M, _SHARED_RAD], 3)))
    information = np.linalg.inv(covariance + shared)
    return FinalFit(T, (information + information.T) / 2, problem.residuals)


def _problem(ref: FinePlanes, query: FinePlanes, T_ref_query: Array) -> _Problem:
    """Both directions in xi of ``T_ref_query @ se3_exp(xi)``; ``T_query_ref`` changes by ``-Ad(T_ref_query) xi``."""
    there = match_points(ref.planes, query.points, T_ref_query)
    back = match_points(query.planes, ref.points, invert(T_ref_query))
    A = -adjoint(T_ref_query)
    by_points = np.concatenate([there.by_points, back.by_points @ A])
    by_planes = np.concatenate([there.by_planes, back.by_planes @ A])
    residuals, weights = (
        np.concatenate([getattr(m, name) for m in (there, back)]) for name in ("residuals", "weights")
    )
    H = nearest_semidefinite(by_points.T @ (weights[:, None] * by_planes), _LENGTH_M)
    g = by_points.T @ (weights * residuals)
    patches = np.concatenate([_patches(there, T_ref_query), _patches(back, np.eye(4))])
    return _Problem(H, g, by_points, by_planes, (there.residuals, back.residuals), weights, patches)


def _patches(matches: Matches, T_ref_points: Array) -> Indices:
    """(M,) number of the patch, in the reference's frame, of each matched point."""
    points = apply(T_ref_points, matches.points)
    facing = np.argmax(np.abs(matches.by_points[:, :3] @ T_ref_points[:3, :3].T), axis=1) if len(matches) else []
    return np.asarray(4 * voxel_keys(points, _PATCH_M) + np.asarray(facing, dtype=np.int64))
