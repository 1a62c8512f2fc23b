"""How much an edge between two blocks is worth.

Were every distance from a plane as noisy as any other, it would be ``H / sigma^2``. They are not: the few surfaces that
face along the street are edges and recesses, which fit worse than facades, and neighbours on one surface err together.
The scatter of the gradient, taken patch of surface by patch, holds both (White, "A heteroskedasticity-consistent
covariance matrix estimator", Econometrica 1980; by patches: Liang and Zeger, Biometrika 1986).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_RIDGE = 1e-9
"""of the largest eigenvalue, so that directions that nothing holds stay solvable"""


def nearest_semidefinite(H: Array, characteristic_length_m: float) -> Array:
    """(6, 6) the nearest matrix that is symmetric and holds no direction less than not at all.

    Args:
        lever_m: at which rotations are weighed against translations.
    """
    scale = np.array([1.0, 1.0, 1.0, *[1.0 / characteristic_length_m] * 3])
    values, vectors = np.linalg.eigh(scale[:, None] * (H + H.T) / 2 * scale)
    nearest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(nearest / scale[:, None] / scale)


def minimum(H: Array, g: Array, characteristic_length_m: float, open_share: float) -> Array:
    """``-H^+ g`` (6,): the step to the minimum, without the directions that the block leaves open.

    Args:
        lever_m: at which rotations are weighed against translations when directions are called open.
        open_share: a direction with so little of the strongest one's information is open.
    """
    scale = np.array([1.0, 1.0, 1.0, *[1.0 / characteristic_length_m] * 3])
    values, vectors = np.linalg.eigh(scale[:, None] * H * scale)
    known = values > open_share * max(values[-1], 1e-300)
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    return np.asarray(-scale * (vectors @ (inverse * (vectors.T @ (scale * g)))))


def scatter_by_patch(gradients: Array, patch: NDArray[np.int64]) -> Array:
    """(6, 6) sum over patches of the outer product of their gradients.

    Args:
        gradients: (M, 6) of each point, at the fit's own minimum.
        patch: (M,) which patch of surface each point lies on.
    """
    _, number = np.unique(patch, return_inverse=True)
    sums = np.zeros((int(number.max(initial=-1)) + 1, gradients.shape[1]))
    np.add.at(sums, number, gradients)
    return np.asarray(sums.T @ sums)


def sandwich_information(H: Array, scatter: Array, floor: float, characteristic_length_m: float) -> Array:
    """(6, 6) information ``H (S + floor H)^-1 H``.

    Args:
        H: (6, 6) of the fit.
        scatter: (6, 6) S, of the fit's gradient.
        floor: m^2, variance of a distance that is assumed on top.
        lever_m: at which rotations are weighed against translations.
    """
    scale = np.array([1.0, 1.0, 1.0, *[1.0 / characteristic_length_m] * 3])
    scaled, spread = (scale[:, None] * m * scale for m in (H, scatter))
    spread = spread + floor * scaled
    spread = spread + _RIDGE * max(float(np.trace(spread)), 1e-300) * np.eye(6)
    information = scaled @ np.linalg.solve(spread, scaled)
    return np.asarray((information + information.T) / 2 / scale[:, None] / scale)


def with_block_distortion(information: Array, variance: Array) -> Array:
    """(6, 6) information of an edge whose ends are not rigid: ``(information^-1 + diag(variance))^-1``.

    Args:
        variance: (6,) of the odometry inside both blocks.
    """
    out = information @ np.linalg.inv(np.eye(6) + variance[:, None] * information)
    return np.asarray((out + out.T) / 2)
