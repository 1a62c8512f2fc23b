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
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys

LENGTH_M = 10.0
"""the characteristic length"""
_SCALE = np.array([1.0, 1.0, 1.0, *[1.0 / LENGTH_M] * 3])
"""(6,) factors by which rotations in metres, at the characteristic length, become radians"""
_RIDGE = 1e-9
"""share of the trace that is added to the diagonal, so that open directions do not make a matrix singular"""


def nearest_semidefinite(H: Array) -> Array:
    """(6, 6) the symmetric positive semidefinite matrix that is nearest to H (6, 6)."""
    values, vectors = np.linalg.eigh(_SCALE[:, None] * (H + H.T) / 2 * _SCALE)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(nearest / _SCALE[:, None] / _SCALE)


def minimum(H: Array, g: Array, open_share: float = 1e-4) -> Array:
    """``-H^+ g`` (6,): the step to the minimum, with no motion in open directions.

    Args:
        open_share: a direction with less than this share of the largest eigenvalue of H is open.
    """
    values, vectors = np.linalg.eigh(_SCALE[:, None] * H * _SCALE)
    known = values > open_share * max(values[-1], 1e-300)
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    return np.asarray(-_SCALE * (vectors @ (inverse * (vectors.T @ (_SCALE * g)))))


def patches_of(points: Array, normals: Array, size_m: float) -> Indices:
    """(M,) number of the patch of surface, ``size_m`` wide, that each point (M, 3) with a normal (M, 3) lies on."""
    return np.asarray(4 * voxel_keys(points, size_m) + np.argmax(np.abs(normals), axis=1))


def scatter_by_patch(gradients: Array, patch: Indices) -> Array:
    """(6, 6) sum over the patches of the outer product of each patch's gradient with itself.

    Args:
        gradients: (M, 6) of each point, at the minimum of the fit.
        patch: (M,) number of the patch of surface that each point lies on.
    """
    _, number = np.unique(patch, return_inverse=True)
    sums = np.zeros((int(number.max(initial=-1)) + 1, gradients.shape[1]))
    np.add.at(sums, number, gradients)
    return np.asarray(sums.T @ sums)


def sandwich_information(H: Array, scatter: Array, floor: float) -> Array:
    """(6, 6) information ``H (S + floor H)^-1 H``, the inverse of the sandwich estimator of the covariance.

    Args:
        H: (6, 6) of the fit.
        scatter: (6, 6) S, the scatter of the gradient.
        floor: variance of a distance that is added, m^2.
    """
    scaled, spread = (_SCALE[:, None] * m * _SCALE for m in (H, scatter))
    spread = spread + floor * scaled
    spread = spread + _RIDGE * max(float(np.trace(spread)), 1e-300) * np.eye(6)
    information = scaled @ np.linalg.solve(spread, scaled)
    return np.asarray((information + information.T) / 2 / _SCALE[:, None] / _SCALE)


def with_block_distortion(information: Array, variance: Array) -> Array:
    """(6, 6) information of an edge whose blocks are not rigid: ``(information^-1 + diag(variance))^-1``.

    Args:
        variance: (6,) of the odometry inside both blocks.
    """
    out = information @ np.linalg.inv(np.eye(6) + variance[:, None] * information)
    return np.asarray((out + out.T) / 2)
