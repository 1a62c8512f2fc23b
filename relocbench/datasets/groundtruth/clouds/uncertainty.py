"""The final fit of two clouds, and its covariance from the scatter of what the fit leaves, patch by patch of surface.

Points of both clouds are matched to planes of the other. Each product of normals has one factor of either cloud, so
that their noise does not count as information, as in :mod:`relocbench.datasets.groundtruth.pose_graph.block_fits`.
The fit is the root of the gradient g, so that its covariance is ``J^-1 S J^-T`` with the derivative J of g and its
scatter S (Huber, Robust Statistics, 1981).

J is measured: the pose is moved by about the noise of the points, in either direction of each of its parameters, and
matched anew. The products of normals that lead to the minimum would be larger than J. The second derivative of a robust
kernel is smaller than its weights, and nearest points are chosen, so that distances follow a motion by a part of it.

S sums the gradient over patches of surface before it is squared, since errors on one patch are correlated, whichever
cloud's points they are measured with. The fit bends towards the few patches that decide a direction, and leaves too
little of their errors. Each patch therefore counts as if the fit had been made without it (the jackknife over clusters:
Bell and McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey
Methodology 2002). Errors of real scans, which the motion of the sensor distorts, are correlated over larger patches as
well. S is therefore multiplied by the growth of the scatter from patches of 4 m to those of 8 and 16 m, on average over
all directions, since the scatter of few patches is uncertain in each of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.clouds.open_directions import OpenDirections, open_directions
from relocbench.datasets.groundtruth.pose_graph.block_fits import match_points
from relocbench.datasets.groundtruth.pose_graph.edge_information import (
    LENGTH_M,
    nearest_semidefinite,
    patches_of,
    scatter_by_patch,
)
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.geometry import adjoint, apply, invert, project_to_rotation, se3_exp

_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(9000,), near_m=(1e9,))
_PATCH_M, _LARGER_M = 4.0, (8.0, 16.0)
"""size of the patches of surface on which errors are correlated, and sizes on which they may be as well"""
_ITERATIONS, _STILL_M = 8, 1e-4
_KERNEL_M = 0.05
"""scale of Geman-McClure's kernel, which the weights of matches have"""
_MOVE_M = 0.02
"""by how much the pose is moved to measure the derivative of the gradient, about the noise of points"""
_RIDGE = 1e-6
"""share of the trace that is added where the derivative is inverted patch by patch"""
_LEAST_SHARE = 1e-9
"""share of the trace that is added to the diagonal of a matrix before it is inverted"""
_LEAST_SIGMA_M = 0.003
"""least standard deviation of a distance"""
OPEN = 1e-4
"""information of every direction at least, so that open ones have a sigma of 100 m or 100 rad, enlarged"""


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
    open: OpenDirections
    """the motions that the surfaces cannot tell, of which nothing is known"""


@dataclass(frozen=True, eq=False)
class _Problem:
    H: Array
    g: Array
    by_points: Array
    by_planes: Array
    residuals: tuple[Array, Array]
    weights: Array
    points: Array
    """(M, 3) in the reference's frame"""
    normals: Array
    """(M, 3)"""

    def patches(self, size_m: float) -> Indices:
        """(M,) number of the patch of surface that each point lies on."""
        return patches_of(self.points, self.normals, size_m)

    @property
    def gradients(self) -> Array:
        """(M, 6) of each distance; g is their sum."""
        return np.asarray((self.weights * np.concatenate(self.residuals))[:, None] * self.by_points)

    @cached_property
    def slopes(self) -> Array:
        """(M,) of the kernel's weights ``w / (1 + square)^2``, their second derivative, at least 0."""
        square = np.square(np.concatenate(self.residuals) / _KERNEL_M)
        return np.asarray(self.weights * np.maximum(1 - 3 * square, 0.0) / (1 + square))

    @cached_property
    def open(self) -> OpenDirections:
        return open_directions(self.by_planes, self.by_points, self.weights)

    @property
    def step(self) -> Array:
        """(6,) xi to the minimum, without any motion in open directions."""
        closed = self.open.closed
        H = closed.T @ self.H @ closed
        return np.asarray(-closed @ np.linalg.solve(H + _ridge(H), closed.T @ self.g))


def final_fit(ref: FinePlanes, query: FinePlanes, T_ref_query: Array) -> FinalFit:
    """Refine a pose that is right to centimetres, and estimate its information."""
    T = np.array(T_ref_query, dtype=np.float64)
    problem = _problem(ref, query, T)
    for _ in range(_ITERATIONS):
        xi = problem.step
        if not np.isfinite(xi).all() or np.linalg.norm(xi[:3]) > 0.2 or np.linalg.norm(xi[3:]) > 0.02:
            break
        T = T @ se3_exp(xi)
        T[:3, :3] = project_to_rotation(T[:3, :3])
        problem = _problem(ref, query, T)
        if np.linalg.norm(xi[:3]) < _STILL_M and np.linalg.norm(xi[3:]) < _STILL_M / LENGTH_M:
            break
    J = _derivative(ref, query, T)
    by_patch = _jackknifed(problem)
    information = _sandwich(J, _growth(problem, J) * by_patch.T @ by_patch, problem.open)
    return FinalFit(T, information + OPEN * np.eye(6), problem.residuals, problem.open)


def _sandwich(J: Array, scatter: Array, directions: OpenDirections) -> Array:
    """(6, 6) information ``J (S + floor J)^-1 J`` of what is told, and none in open directions."""
    closed = directions.closed
    J, scatter = (closed.T @ m @ closed for m in (J, scatter))
    spread = scatter + _LEAST_SIGMA_M**2 * J
    information = J @ np.linalg.solve(spread + _ridge(spread), J)
    return directions.lifted((information + information.T) / 2)


def _growth(problem: _Problem, J: Array) -> float:
    """By how much the scatter of the gradient grows where it is summed over larger patches; at least 1."""
    gradients, closed = problem.gradients, problem.open.closed

    def scatter(size_m: float) -> Array:
        return np.asarray(closed.T @ scatter_by_patch(gradients, problem.patches(size_m)) @ closed)

    small = scatter(_PATCH_M) + _LEAST_SIGMA_M**2 * closed.T @ J @ closed
    small = small + _ridge(small)
    growth = [float(np.trace(np.linalg.solve(small, scatter(size_m)))) / len(small) for size_m in _LARGER_M]
    return max(1.0, *growth) if len(small) else 1.0


def _ridge(matrix: Array) -> Array:
    return _LEAST_SHARE * max(float(np.trace(matrix)), 1e-300) * np.eye(len(matrix))


def _derivative(ref: FinePlanes, query: FinePlanes, T: Array) -> Array:
    """(6, 6) J: the derivative of the gradient by xi of ``T @ se3_exp(xi)``, with points matched anew."""
    columns = []
    for move in np.diag(np.repeat([_MOVE_M, _MOVE_M / LENGTH_M], 3)):
        forward, backward = (_problem(ref, query, T @ se3_exp(sign * move)).g for sign in (1, -1))
        columns.append((forward - backward) / (2 * move.max()))
    return nearest_semidefinite(np.array(columns))


def _jackknifed(problem: _Problem) -> Array:
    """(P, 6) gradients of the patches, as large as if the fit had been made without each: ``(I - H_p H^-1)^-1 g_p``.

    H is the analytic derivative, since a patch's share of it matters, which noise would drown in a measured one.
    """
    _, patch = np.unique(problem.patches(_PATCH_M), return_inverse=True)
    count = int(patch.max(initial=-1)) + 1
    sums, shares = np.zeros((count, 6)), np.zeros((count, 6, 6))
    np.add.at(sums, patch, problem.gradients)
    for k in range(6):
        np.add.at(shares[:, k], patch, (problem.slopes * problem.by_points[:, k])[:, None] * problem.by_planes)
    shares = (shares + shares.transpose(0, 2, 1)) / 2
    scale = np.repeat([1.0, LENGTH_M], 3)
    H = nearest_semidefinite(shares.sum(axis=0))
    H = H + _RIDGE * max(float(np.trace(H)), 1e-300) * np.diag(scale**2)
    return np.asarray(np.linalg.solve(np.eye(6) - shares @ np.linalg.inv(H), sums[:, :, None])[:, :, 0])


def _problem(ref: FinePlanes, query: FinePlanes, T_ref_query: Array) -> _Problem:
    """Both directions in xi of ``T_ref_query @ se3_exp(xi)``; ``T_query_ref`` changes by ``-Ad(T_ref_query) xi``."""
    forward = match_points(ref.planes, query.points, T_ref_query)
    backward = match_points(query.planes, ref.points, invert(T_ref_query))
    A = -adjoint(T_ref_query)
    by_points = np.concatenate([forward.by_points, backward.by_points @ A])
    by_planes = np.concatenate([forward.by_planes, backward.by_planes @ A])
    residuals = forward.residuals, backward.residuals
    weights = np.concatenate([forward.weights, backward.weights])
    H = nearest_semidefinite(by_points.T @ (weights[:, None] * by_planes))
    g = by_points.T @ (weights * np.concatenate(residuals))
    points = np.concatenate([apply(T_ref_query, forward.points), backward.points])
    normals = np.concatenate([forward.by_points[:, :3] @ T_ref_query[:3, :3].T, backward.by_points[:, :3]])
    return _Problem(H, g, by_points, by_planes, residuals, weights, points, normals)
