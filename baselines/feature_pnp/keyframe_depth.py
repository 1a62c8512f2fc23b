"""The inverse depth of a keyframe at arbitrary pixels."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Floats
from relocbench.tracking import Array, Reference

_CONTINUOUS = 0.05  # largest relative range of the four neighbours' inverse depths on one surface


def inverse_depth_at(reference: Reference, uv: Array, radius_px: float) -> tuple[Array, Array]:
    """Inverse depth and its standard deviation at arbitrary pixels.

    In a depth image it is interpolated where the four neighbouring pixels are on one surface. Elsewhere it is that of
    the nearest known pixel within a distance of 1, since the mean of two surfaces is on neither. In a sparse map it is
    that of the nearest point within ``radius_px``.

    Args:
        reference: the keyframe.
        uv: (N, 2) pixels.
        radius_px: largest distance of a point of a sparse map.

    Returns:
        The inverse depth (N,), 1/m, 0 where unknown, and its sigma (N,), 1/m.
    """
    if reference.sparse_points is None and reference.depth is not None:
        inverse = _dense(reference.depth, uv)
        a, b, c = reference.depth_sigma
        z = 1.0 / np.where(inverse > 0, inverse, 1.0)
        return inverse, np.where(inverse > 0, (a + b * z + c * z * z) / (z * z), 0.0)
    points = reference.points
    if len(points) == 0 or len(uv) == 0:
        return np.zeros(len(uv)), np.zeros(len(uv))
    distance, nearest = cKDTree(points.uv).query(uv, distance_upper_bound=np.nextafter(radius_px, np.inf))
    found = np.isfinite(distance)
    index = np.where(found, nearest, 0)
    inverse = np.where(found, points.inverse_depth[index], 0.0)
    inverse = np.where(np.isfinite(inverse) & (inverse > 0), inverse, 0.0)
    return inverse, np.where(inverse > 0, points.sigma[index], 0.0)


def _dense(depth: Floats, uv: Array) -> Array:
    """Interpolate the inverse depth bilinearly; on a plane it is a linear function of the pixel."""
    height, width = depth.shape
    u, v = uv[:, 0], uv[:, 1]
    u0 = np.clip(np.floor(u).astype(int), 0, max(width - 2, 0))
    v0 = np.clip(np.floor(v).astype(int), 0, max(height - 2, 0))
    u1, v1 = np.minimum(u0 + 1, width - 1), np.minimum(v0 + 1, height - 1)
    z = depth[np.stack([v0, v0, v1, v1]), np.stack([u0, u1, u0, u1])].astype(np.float64)  # (4, N)
    known = np.isfinite(z) & (z > 0)
    inverse = np.where(known, 1.0 / np.where(known, z, 1.0), 0.0)
    fu, fv = u - u0, v - v0
    weight = np.stack([(1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv, fu * fv])
    one_surface = known.all(axis=0) & (inverse.max(axis=0) <= (1 + _CONTINUOUS) * inverse.min(axis=0))
    du, dv = np.stack([fu, 1 - fu, fu, 1 - fu]), np.stack([fv, fv, 1 - fv, 1 - fv])
    distance = np.where(known, np.hypot(du, dv), np.inf)
    nearest = np.argmin(distance, axis=0)[None]
    nearest_inverse = np.take_along_axis(inverse, nearest, axis=0)[0]
    within_a_pixel = np.take_along_axis(distance, nearest, axis=0)[0] <= 1.0
    value = np.where(one_surface, np.sum(weight * inverse, axis=0), np.where(within_a_pixel, nearest_inverse, 0.0))
    inside = (u >= -0.5) & (v >= -0.5) & (u <= width - 0.5) & (v <= height - 0.5)
    return np.where(inside, value, 0.0)
