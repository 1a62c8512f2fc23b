"""Visibility of a keyframe's surface points in a query.

A reference pixel with depth is unprojected, transformed by ``T_query_ref`` and projected (:func:`warp`). Whether the
query sees the point is decided by the best check that the available depth allows:

``both``
    The query has depth at that pixel. The point's depth must agree with it, and the query's own surface point,
    warped back to the reference, must agree with the reference's depth there.
``self``
    The query has none, but the reference depth is dense: when all surface points of the reference are drawn into the
    query's z-buffer, none may lie in front of the point. Surfaces that the reference never saw are not considered.
``none``
    A sparse reference and no query depth: the point lies in front of the query camera and within its image.

Two depths agree if they differ by at most ``3 sigma + 0.01 z``. Sigma is that of both depths combined (the camera's
``depth_sigma`` a + b z + c z^2, or the point's own); 1 % of the depth allows for interpolation between pixels and for
the rounding of stored depth. The z-buffer has the resolution of pixels, so there the surface's slope is added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.arrays import Array, Floats, Indices, Mask
from relocbench.geometry import Camera, apply, invert
from relocbench.tracking import Reference

Check = Literal["both", "self", "none"]

CHECKS: tuple[Check, ...] = ("both", "self", "none")
SIGMAS = 3.0
RELATIVE_TOLERANCE = 0.01
_ONE_SURFACE = 0.1
"""neighbouring depths within 10 % belong to one surface and may be interpolated"""
_ROUNDING = 1e-6
"""pixels; tolerance that keeps a border pixel within the image under the identity pose"""
_SPLAT_LIMIT = 3
"""pixels; greatest radius of a surface element in the z-buffer"""


@dataclass(frozen=True, eq=False)
class DepthView:
    """A camera and its depth, for visibility checks."""

    camera: Camera
    depth: Floats | None = None
    """(H, W) metres along z, 0 where unknown; None where there is no dense depth"""
    depth_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def sigma(self, z: Array) -> Array:
        """Standard deviation (metres) of dense depths z."""
        a, b, c = self.depth_sigma
        return a + b * z + c * z * z


@dataclass(frozen=True, eq=False)
class ReferencePoints:
    """The reference pixels with depth: all points of a sparse keyframe, or the known pixels of a dense depth image."""

    uv: Array
    """(N, 2)"""
    depth: Array
    """(N,) metres along z"""
    sigma: Array
    """(N,) metres"""

    @classmethod
    def of(cls, reference: Reference) -> ReferencePoints:
        """The points of a keyframe, sparse or dense."""
        points = reference.points
        depth = 1.0 / points.inverse_depth
        return cls(points.uv, depth, points.sigma * depth * depth)

    def take(self, rows: Indices | Mask) -> ReferencePoints:
        return ReferencePoints(self.uv[rows], self.depth[rows], self.sigma[rows])

    def __len__(self) -> int:
        return len(self.depth)


@dataclass(frozen=True, eq=False)
class Visibility:
    """Visibility of N reference points in the query."""

    uv_query: Array
    """(N, 2), NaN behind the camera"""
    inside: Mask
    """(N,) whether the point is in front of the camera and within its image"""
    visible: Mask
    """(N,) whether the query sees the point"""
    check: NDArray[np.int8]
    """(N,) index into :data:`CHECKS`"""


def lift(camera: Camera, pixels: ArrayLike, depth: ArrayLike) -> tuple[Array, Mask]:
    """Points (N, 3) in the camera's frame of pixels (N, 2) with depth (N,) along z, and whether they are valid (N,)."""
    rays, valid = camera.unproject(pixels)
    z = np.asarray(depth, dtype=np.float64)
    # Rays 90 degrees or more off the axis have no depth along z.
    valid = valid & np.isfinite(z) & (z > 0) & (np.abs(rays[..., 2] - 1.0) < 1e-9)
    return rays * z[..., None], valid


def warp(
    points: ArrayLike, camera_ref: Camera, camera_query: Camera, T_query_ref: ArrayLike
) -> tuple[Array, Array, Mask]:
    """Reference pixels with depth as pixels of the query: ``p' = pi(T_query_ref pi^-1(p, z))``.

    Args:
        points: (N, 3) of u, v (pixels) and depth along z (metres) in the reference.
        T_query_ref: (4, 4).

    Returns:
        pixels (N, 2), NaN where not valid; depth along z in the query (N,); and valid (N,): whether the point is in
        front of the query camera. Pixels are not clipped to the image.
    """
    p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    lifted, known = lift(camera_ref, p[:, :2], p[:, 2])
    moved = apply(T_query_ref, lifted)
    pixels, in_front = camera_query.project(moved)
    valid = known & in_front & (moved[:, 2] > 0)
    return np.where(valid[:, None], pixels, np.nan), moved[:, 2], valid


def see(points: ReferencePoints, T_query_ref: Array, reference: DepthView, query: DepthView) -> Visibility:
    """Determine which of the reference points the query sees."""
    stacked = np.column_stack([points.uv, points.depth])
    uv, z, valid = warp(stacked, reference.camera, query.camera, T_query_ref)
    inside = valid & query.camera.contains(uv, border=-_ROUNDING)
    check = np.full(len(points), CHECKS.index("none"), dtype=np.int8)
    visible = inside.copy()

    # sigma of the depth along the query's axis: dz'/dz = (R ray)_z
    rays, _ = reference.camera.unproject(points.uv)
    sigma = points.sigma * np.abs(np.nan_to_num(rays) @ T_query_ref[2, :3])

    rows = np.nonzero(inside)[0]
    if query.depth is not None:
        seen, known = agrees(query.depth, uv[rows], z[rows], sigma[rows], query)
        both, seen, rows = rows[known], seen[known], rows[~known]
        visible[both] = seen & _returns(points.take(both), uv[both], z[both], T_query_ref, reference, query)
        check[both] = CHECKS.index("both")
    if reference.depth is not None and rows.size:
        buffer = reference_z_buffer(T_query_ref, reference, query)
        u, v = np.rint(uv[rows]).astype(int).T
        reach, magnification = _reach(points.depth[rows], z[rows], reference.camera, query.camera)
        # A surface element is drawn with one depth, so over its extent a slanted surface deviates by the slope.
        slant = (reach + 1) * _slope(reference.depth, points.uv[rows]) / magnification
        visible[rows] = z[rows] <= buffer[v, u] + tolerance(z[rows], sigma[rows], sigma[rows]) + slant
        check[rows] = CHECKS.index("self")
    return Visibility(uv, inside, visible, check)


def tolerance(z: Array, sigma_a: Array, sigma_b: Array) -> Array:
    """Greatest difference (metres) of two depths near z that count as the same surface."""
    return SIGMAS * np.hypot(sigma_a, sigma_b) + RELATIVE_TOLERANCE * z


def agrees(depth: Floats, pixels: Array, z: Array, sigma: Array, view: DepthView) -> tuple[Mask, Mask]:
    """Whether depths z (N,) agree with a dense depth image at pixels (N, 2), and whether that depth is known (N,).

    If the four surrounding pixels are one surface, their inverse depth is interpolated, which is linear over a plane;
    at an edge it is enough if any of the four agrees.
    """
    found, around, known = sample_depth(depth, pixels)
    limit = tolerance(z, sigma, view.sigma(np.where(known, np.nan_to_num(found), 0.0)))
    with np.errstate(invalid="ignore"):
        smooth = np.isfinite(found)
        one_surface = np.abs(z - found) <= limit
        edge_limit = tolerance(z, sigma, view.sigma(z))
        edge = np.any(np.abs(around - z[:, None]) <= edge_limit[:, None], axis=1)
    return known & np.where(smooth, one_surface, edge), known


def sample_depth(depth: Floats, pixels: Array) -> tuple[Array, Array, Mask]:
    """Sample a depth image between pixels (N, 2).

    Returns:
        interpolated depth (N,), NaN at an edge or next to unknown depth; the four surrounding depths (N, 4), NaN where
        unknown; and known (N,): whether at least one of the four is known.
    """
    height, width = depth.shape
    u0 = np.clip(np.floor(pixels[:, 0]).astype(int), 0, max(width - 2, 0))
    v0 = np.clip(np.floor(pixels[:, 1]).astype(int), 0, max(height - 2, 0))
    u1, v1 = np.minimum(u0 + 1, width - 1), np.minimum(v0 + 1, height - 1)
    around = np.stack([depth[v0, u0], depth[v0, u1], depth[v1, u0], depth[v1, u1]], axis=1).astype(np.float64)
    around[~(around > 0)] = np.nan
    known = np.any(np.isfinite(around), axis=1)
    fu, fv = pixels[:, 0] - u0, pixels[:, 1] - v0
    weights = np.stack([(1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv, fu * fv], axis=1)
    with np.errstate(invalid="ignore"):
        interpolated = 1.0 / np.sum(weights / around, axis=1)
        low, high = np.min(around, axis=1), np.max(around, axis=1)
        one_surface = high - low <= _ONE_SURFACE * low
    return np.where(one_surface, interpolated, np.nan), around, known


def reference_z_buffer(T_query_ref: Array, reference: DepthView, query: DepthView) -> Array:
    """The reference's dense depth drawn into the query: nearest depth (H, W) along z, inf where there is none.

    A surface element that is nearer to the query covers more of its pixels; it is drawn that large, so that surfaces
    have no holes.
    """
    buffer = np.full((query.camera.height, query.camera.width), np.inf)
    if reference.depth is None:
        return buffer
    v, u = np.nonzero(reference.depth > 0)
    depth = reference.depth[v, u].astype(np.float64)
    uv, z, valid = warp(np.column_stack([u, v, depth]), reference.camera, query.camera, T_query_ref)
    valid &= query.camera.contains(uv, border=-float(_SPLAT_LIMIT))
    u, v = np.rint(uv[valid]).astype(int).T
    z = z[valid]
    reach, _ = _reach(depth[valid], z, reference.camera, query.camera)
    for r in range(_SPLAT_LIMIT + 1):
        spread = np.arange(-r, r + 1)
        x, y, depths = np.broadcast_arrays(
            u[reach == r, None, None] + spread, v[reach == r, None, None] + spread[:, None], z[reach == r, None, None]
        )
        on = (x >= 0) & (y >= 0) & (x < buffer.shape[1]) & (y < buffer.shape[0])
        np.minimum.at(buffer, (y[on], x[on]), depths[on])
    return buffer


def _reach(depth: Array, z: Array, camera_ref: Camera, camera_query: Camera) -> tuple[Indices, Array]:
    """Radius in pixels with which elements are drawn, and the number of query pixels per reference pixel."""
    magnification = depth / z * (camera_query.fx / camera_ref.fx)
    return np.clip(np.ceil((magnification - 1.0) / 2.0), 0, _SPLAT_LIMIT).astype(np.int64), magnification


def _slope(depth: Floats, pixels: Array) -> Array:
    """Greatest depth difference in metres between a pixel and its four neighbours on the same surface."""
    u, v = np.rint(pixels).astype(int).T
    height, width = depth.shape
    own = depth[v, u].astype(np.float64)
    steps = []
    for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        other = depth[np.clip(v + dv, 0, height - 1), np.clip(u + du, 0, width - 1)]
        step = np.abs(other - own)
        steps.append(np.where((other > 0) & (step <= _ONE_SURFACE * own), step, 0.0))
    return np.asarray(np.max(steps, axis=0))


def _returns(
    points: ReferencePoints, uv_query: Array, z_query: Array, T_query_ref: Array, reference: DepthView, query: DepthView
) -> Mask:
    """Whether the query's own surface at these pixels, warped back, agrees with the reference's depth there."""
    assert query.depth is not None
    found, around, _ = sample_depth(query.depth, uv_query)
    with np.errstate(invalid="ignore"):
        offset = np.where(np.isfinite(around), np.abs(around - z_query[:, None]), np.inf)
    nearest = np.take_along_axis(around, np.argmin(offset, axis=1)[:, None], axis=1)[:, 0]
    surface = np.where(np.isfinite(found), found, nearest)
    back, z, valid = warp(np.column_stack([uv_query, surface]), query.camera, reference.camera, invert(T_query_ref))
    valid &= reference.camera.contains(back, border=-_ROUNDING)
    sigma = np.hypot(query.sigma(surface), points.sigma)
    if reference.depth is None:
        return valid & (np.abs(z - points.depth) <= tolerance(z, sigma, np.zeros_like(sigma)))
    agreed, known = agrees(reference.depth, np.nan_to_num(back), z, query.sigma(surface), reference)
    return valid & (agreed | ~known)
