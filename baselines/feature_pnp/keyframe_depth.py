"""The inverse depth of a keyframe at arbitrary pixels, and the points that they see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Array, Floats, Indices
from relocbench.tracking import KeyframePoints, Reference

_CONTINUOUS = 0.05  # largest relative range of the four neighbours' inverse depths on one surface
_NEIGHBOURS = 16  # points of a sparse map that a plane is fitted to; 13 lie within the usual reach on average
_FLAT = 0.02  # largest relative residual of points on one plane
_CELL_PX = 32  # side of the cells that tell which part of the image a sparse map covers
_SPACINGS = 2.0  # reach, in units of the mean distance of the points of a sparse map
_LEAST_REACH_PX, _MOST_REACH = 2.0, 1 / 64  # of pixels; of the image's longer side


def inverse_depth_at(reference: Reference, uv: Array, radius_px: float | None = None) -> tuple[Array, Array]:
    """Inverse depth and its standard deviation at arbitrary pixels.

    In a depth image it is interpolated where the four neighbouring pixels are on one surface. Elsewhere it is that of
    the nearest known pixel within a distance of 1, since the mean of two surfaces is on neither. In a sparse map it is
    that of the plane through the sixteen nearest points within ``radius_px``, where they surround the pixel and lie on
    one plane; a plane's inverse depth is a linear function of the pixel. Elsewhere it is that of the nearest of them.

    Args:
        reference: the keyframe.
        uv: (N, 2) pixels.
        radius_px: largest distance of a point of a sparse map; None: see :func:`reach_of`.

    Returns:
        The inverse depth (N,), 1/m, 0 where unknown, and its sigma (N,), 1/m.
    """
    if reference.sparse_points is None and reference.depth is not None:
        inverse = _dense(reference.depth, uv)
        a, b, c = reference.depth_sigma
        z = 1.0 / np.where(inverse > 0, inverse, 1.0)
        return inverse, np.where(inverse > 0, (a + b * z + c * z * z) / (z * z), 0.0)
    points = reference.points
    known = np.flatnonzero(np.isfinite(points.inverse_depth) & (points.inverse_depth > 0))
    if len(known) == 0 or len(uv) == 0:
        return np.zeros(len(uv)), np.zeros(len(uv))
    if radius_px is None:
        radius_px = reach_of(points.uv[known], (reference.camera.width, reference.camera.height))
    return _sparse(KeyframePoints(points.uv[known], points.inverse_depth[known], points.sigma[known]), uv, radius_px)


@dataclass(frozen=True, eq=False)
class Lifted:
    """The pixels of a keyframe that have a depth, as points of its frame."""

    index: Indices
    """(N,) of these among the pixels that were asked for, ascending"""
    points: Array
    """(N, 3) metres, reference camera frame"""
    depth_direction: Array
    """(N, 3) metres; the displacement of the point by one standard deviation of its depth"""


def lift(reference: Reference, uv: Array, radius_px: float | None = None) -> Lifted:
    """The points that pixels (M, 2) of a keyframe see; see :func:`inverse_depth_at` for the arguments."""
    inverse_depth, sigma = inverse_depth_at(reference, uv, radius_px)
    rays, valid = reference.camera.unproject(uv)
    # Depth is along z, so that rays parallel to the image or backwards have none.
    index = np.flatnonzero(valid & (inverse_depth > 0) & (rays[:, 2] > 0))
    inverse_depth, sigma, rays = inverse_depth[index], sigma[index], rays[index]
    points = rays / inverse_depth[:, None]
    # z = 1/rho, and therefore |dz| = z sigma_rho / rho.
    return Lifted(index, points, points * (sigma / inverse_depth)[:, None])


def reach_of(uv: Array, size: tuple[int, int]) -> float:
    """The distance, in pixels, up to which points (N, 2) of a sparse map tell the depth of other pixels.

    It is twice the mean distance of the points in the part of the image that they cover, at least 2 pixels and at most
    1/64 of the image's longer side: a lidar's rings leave gaps that grow with the image.
    """
    cells = len(np.unique(np.floor(uv / _CELL_PX), axis=0))
    spacing = float(np.sqrt(cells * _CELL_PX**2 / len(uv)))
    return max(_LEAST_REACH_PX, min(_SPACINGS * spacing, _MOST_REACH * max(size)))


def _sparse(points: KeyframePoints, uv: Array, radius_px: float) -> tuple[Array, Array]:
    """Fit planes to the points around each pixel by least squares."""
    count = min(_NEIGHBOURS, len(points))
    near = cKDTree(points.uv).query(uv, k=[*range(1, count + 1)], distance_upper_bound=np.nextafter(radius_px, np.inf))
    found = np.isfinite(near[0])  # (N, K), the nearest first
    index = np.where(found, near[1], 0)
    inverse, sigma = points.inverse_depth[index], points.sigma[index]
    # rho = rho_0 + g . (u - u_0): the row (1, u - u_0) of a neighbour, in units of the radius, 0 where there is none.
    rows = np.concatenate(
        [np.ones((*found.shape, 1)), (points.uv[index] - uv[:, None]) / max(radius_px, 1e-9)], axis=-1
    )
    rows = np.where(found[..., None], rows, 0.0)
    normal = np.einsum("nki,nkj->nij", rows, rows) + 1e-9 * np.eye(3)
    plane = np.linalg.solve(normal, np.einsum("nki,nk->ni", rows, np.where(found, inverse, 0.0))[..., None])[..., 0]
    at_pixel, residual = plane[:, 0], np.where(found, inverse - np.einsum("nki,ni->nk", rows, plane), 0.0)
    # The variance of rho_0 if those of the points were 1: above 1, the pixel lies beside the points, not among them.
    leverage = np.linalg.inv(normal)[:, 0, 0]
    flat = np.abs(residual).max(axis=1) <= _FLAT * np.where(found, inverse, np.inf).min(axis=1)
    planar = (found.sum(axis=1) >= 4) & (leverage <= 1.0) & flat & (at_pixel > 0)
    value = np.where(planar, at_pixel, np.where(found[:, 0], inverse[:, 0], 0.0))
    # Errors of neighbours are mostly common to them, so that their mean is no better than one of them.
    mean_sigma = np.where(found, sigma, 0.0).sum(axis=1) / np.maximum(found.sum(axis=1), 1)
    return value, np.where(value > 0, np.where(planar, mean_sigma, sigma[:, 0]), 0.0)


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
