"""The information matrix of an edge between two blocks.

If all distances from planes had the same independent noise it would be ``H / sigma^2``. But the few surfaces that face
along the street are edges and recesses, which fit worse than facades, and errors on one surface are correlated. The
scatter of the gradient, summed patch by patch of surface, accounts for both (White, "A heteroskedasticity-consistent
covariance matrix estimator", Econometrica 1980; by clusters: Liang and Zeger, Biometrika 1986).

Rotations are compared with translations at a characteristic length of 10 m: a rotation counts as the translation that
it causes at this distance.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.voxels.voxels import distinct_keys, voxel_keys
from relocbench.kernels import njit

LENGTH_M = 10.0
"""the characteristic length"""
_SCALE = np.array([1.0, 1.0, 1.0, *[1.0 / LENGTH_M] * 3])
"""(6,) factors by which rotations in metres, at the characteristic length, become radians"""
_RIDGE = 1e-9
"""share of the trace that is added to the diagonal, so that open directions do not make a matrix singular"""


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_semidefinite(H: Array) -> Array:
    """(6, 6) the symmetric positive semidefinite matrix that is nearest to H (6, 6)."""
    scale = np.outer(_SCALE, _SCALE)
    values, vectors = np.linalg.eigh(scale * (H + H.T) / 2)
    nearest: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T / scale
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def minimum(H: Array, g: Array) -> Array:
    """``-H^+ g`` (6,): the step to the minimum, with no motion along the eigenvectors of small eigenvalues of H."""
    values, vectors = np.linalg.eigh(np.outer(_SCALE, _SCALE) * H)
    least = 1e-4 * max(values[-1], 1e-300)
    step = np.zeros(6)
    for k in range(6):
        if values[k] > least:
            step -= np.dot(vectors[:, k], _SCALE * g) / values[k] * vectors[:, k]
    return _SCALE * step


@njit(cache=True, nogil=True, error_model="numpy")
def patches_of(points: Array, normals: Array, size_m: float) -> Indices:
    """(M,) number of the patch of surface, ``size_m`` wide, that each point (M, 3) with a normal (M, 3) lies on.

    Patches are numbered from 0 in the order of their first points.
    """
    keys = 4 * voxel_keys(points, size_m)
    for i in range(len(points)):
        x, y, z = abs(normals[i, 0]), abs(normals[i, 1]), abs(normals[i, 2])
        keys[i] += 0 if x >= y and x >= z else (1 if y >= z else 2)
    return distinct_keys(keys)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def scatter_by_patch(gradients: Array, patch: Indices) -> Array:
    """(6, 6) sum over the patches of the outer product of each patch's gradient with itself.

    Args:
        gradients: (M, 6) of each point, at the minimum of the fit.
        patch: (M,) number of the patch of surface that each point lies on.
    """
    sums = np.zeros((patch.max() + 1 if len(patch) else 0, gradients.shape[1]))
    for i in range(len(patch)):
        for k in range(gradients.shape[1]):
            sums[patch[i], k] += gradients[i, k]
    return sums.T @ sums


@njit(cache=True, nogil=True, error_model="numpy")
def geman_mcclure(residuals: Array, surface: Array, scale_m: float) -> tuple[Array, Array]:
    """Weights (M,) of distances (M,), and the derivatives (M,) of the weighted distances by the distance, at least 0.

    Args:
        surface: (M,) weights by which both are multiplied.
        scale_m: of the kernel: a distance as large has a weight of 1/4.
    """
    weights, slopes = np.empty(len(residuals)), np.empty(len(residuals))
    for i in range(len(residuals)):
        square = (residuals[i] / scale_m) ** 2
        weights[i] = surface[i] / (1 + square) ** 2
        slopes[i] = surface[i] * max(1 - 3 * square, 0.0) / (1 + square) ** 3
    return weights, slopes


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    by_points: Array, by_planes: Array, residuals: Array, weights: Array, slopes: Array, patches: Indices
) -> tuple[Array, Array, Array]:
    """H (6, 6) and g (6,) of distances from planes, and the scatter (6, 6) of the gradient at the minimum of the fit.

    Args:
        by_points, by_planes: (M, 6) derivatives of the distances, by the points' own normals and by the planes'.
        weights, slopes: (M,) see :func:`geman_mcclure`.
        patches: (M,) number of the patch of surface that each point lies on.
    """
    product, g = np.zeros((6, 6)), np.zeros(6)
    for i in range(len(residuals)):
        for k in range(6):
            g[k] += weights[i] * residuals[i] * by_points[i, k]
            for m in range(6):
                product[k, m] += slopes[i] * by_points[i, k] * by_planes[i, m]
    H = nearest_semidefinite(product)
    step = minimum(H, g)
    gradients = np.empty((len(residuals), 6))
    for i in range(len(residuals)):
        left = residuals[i]
        for k in range(6):
            left += by_planes[i, k] * step[k]
        for k in range(6):
            gradients[i, k] = weights[i] * left * by_points[i, k]
    return H, g, scatter_by_patch(gradients, patches)


def sandwich_information(H: Array, scatter: Array, floor: float) -> Array:
    """(..., 6, 6) information ``H (S + floor H)^-1 H``, the inverse of the sandwich estimator of the covariance.

    Args:
        H: (..., 6, 6) of the fits.
        scatter: (..., 6, 6) S, the scatter of the gradient.
        floor: variance of a distance that is added, m^2.
    """
    scaled, spread = (_SCALE[:, None] * m * _SCALE for m in (H, scatter))
    spread = spread + floor * scaled
    size = np.maximum(np.trace(spread, axis1=-2, axis2=-1), 1e-300)
    spread = spread + _RIDGE * size[..., None, None] * np.eye(6)
    information = scaled @ np.linalg.solve(spread, scaled)
    return _symmetric(information / _SCALE[:, None] / _SCALE)


def with_block_distortion(information: Array, variance: Array) -> Array:
    """(..., 6, 6) information of edges whose blocks are not rigid: ``(information^-1 + diag(variance))^-1``.

    Args:
        variance: (6,) of the odometry inside both blocks.
    """
    return _symmetric(information @ np.linalg.inv(np.eye(6) + variance[:, None] * information))


def _symmetric(matrix: Array) -> Array:
    return np.asarray((matrix + np.swapaxes(matrix, -1, -2)) / 2)
