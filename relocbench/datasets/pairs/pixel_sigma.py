"""Uncertainty of a correspondence's query pixel, propagated from the depth and the pose."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.pairs.visibility import ReferencePoints, lift
from relocbench.geometry import Camera, apply, hat

_STEP = 1e-4
"""step of the numerical derivative relative to the depth, small enough for a projection to be linear"""


def pixel_sigma(
    points: ReferencePoints,
    camera_ref: Camera,
    camera_query: Camera,
    T_query_ref: Array,
    sigma_translation_m: float = 0.0,
    sigma_rotation_rad: float = 0.0,
) -> Array:
    """One standard deviation (N,) in pixels of ``p' = pi(T_query_ref pi^-1(p, z))`` in its least certain direction.

    To first order ``C = J (s_z^2 d d^T + s_t^2 I + s_r^2 [x] [x]^T) J^T``, where x is the point in the query's frame,
    ``d = R ray`` its derivative by the depth, and J the Jacobian of the query's projection.

    Args:
        sigma_translation_m, sigma_rotation_rad: sigma of the pose per direction, in the query's frame.

    Returns:
        (N,) pixels, nan for points that are not in front of the query.
    """
    lifted, known = lift(camera_ref, points.uv, points.depth)
    x = apply(T_query_ref, np.where(known[:, None], lifted, 1.0))
    rays = lifted / points.depth[:, None]
    d = np.where(known[:, None], rays, 0.0) @ T_query_ref[:3, :3].T
    J = np.empty((len(x), 2, 3))
    step = _STEP * np.maximum(np.abs(x[:, 2]), 1e-3)
    valid = known & (x[:, 2] > 0)
    for axis in range(3):
        offset = step[:, None] * np.eye(3)[axis]
        ahead, in_front = camera_query.project(x + offset)
        back, behind = camera_query.project(x - offset)
        valid &= in_front & behind
        J[:, :, axis] = np.where(valid[:, None], (ahead - back) / (2 * step[:, None]), 0.0)
    by_depth = np.einsum("nij,nj->ni", J, d) * points.sigma[:, None]
    by_rotation = J @ hat(x) * sigma_rotation_rad
    C = by_depth[:, :, None] * by_depth[:, None, :] + sigma_translation_m**2 * J @ np.swapaxes(J, 1, 2)
    C = C + by_rotation @ np.swapaxes(by_rotation, 1, 2)
    return np.where(valid, np.sqrt(np.maximum(np.linalg.eigvalsh(C)[:, 1], 0.0)), np.nan)
