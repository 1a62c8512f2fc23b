"""Ground-truth correspondences: which query pixel sees the surface point of a reference pixel.

How visibility is decided, and with which tolerances, is described in :mod:`relocbench.datasets.pairs.visibility`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image, Indices, Mask, Times
from relocbench.datasets.pairs.measures import PairMeasures, measured
from relocbench.datasets.pairs.visibility import CHECKS, DepthView, ReferencePoints, lift, see
from relocbench.geometry import Camera, apply, hat, invert
from relocbench.tracking import Reference

_CELLS = 24
"""cells along the longer side of the image, over which samples are spread"""
_SAMPLES = 8192
"""pixels that are sampled for the overlap of a pair of exact truth, which is then accurate to 0.006 (one sigma)"""
_OVERLAP_PIXELS = 60_000
"""pixels of a keyframe that are sampled for the overlap, which is then accurate to 0.002 (one sigma)"""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Rows of a correspondence file as arrays of equal length."""

    ref_timestamp_ns: Times
    query_timestamp_ns: Times
    uv_ref: Array
    """(N, 2) pixels"""
    depth_ref: Array
    """(N,) metres along z"""
    uv_query: Array
    """(N, 2) pixels, within the query's image"""
    visible: Mask
    """(N,) whether the query sees the point; otherwise something hides it"""
    check: tuple[str, ...]
    """how that was decided: both, self or none"""
    sigma_px: Array | None = None
    """(N,) one standard deviation of the query's pixel; None if the file has no such column"""

    def __len__(self) -> int:
        return len(self.depth_ref)


@dataclass(frozen=True, eq=False)
class PairCorrespondences:
    """The correspondences of one pair, in raster order of the reference pixels."""

    uv_ref: Array
    """(N, 2)"""
    depth_ref: Array
    """(N,) metres"""
    uv_query: Array
    """(N, 2)"""
    visible: Mask
    check: NDArray[np.int8]
    """(N,) index into CHECKS"""
    measures: PairMeasures
    sigma_px: Array | None = None
    """(N,) one standard deviation of the query's pixel, if that of the pose is known"""

    def __len__(self) -> int:
        return len(self.depth_ref)


def pair_correspondences(
    reference: Reference,
    T_query_ref: Array,
    query: DepthView,
    count: int,
    rng: np.random.Generator,
    sigma_pose: tuple[float, float] | None = None,
    query_image: Image | None = None,
) -> PairCorrespondences:
    """Up to ``count`` correspondences of a pair, spread over the reference image, and the pair's measures.

    They are sampled from the reference pixels whose points project into the query's image, visible there or hidden.

    Args:
        count: greatest number of correspondences.
        sigma_pose: one standard deviation of the pose per direction, metres and radians; gives pixels a sigma too.
        query_image: without it, the pair has no similarity.
    """
    points = ReferencePoints.of(reference)
    if len(points) > _OVERLAP_PIXELS:
        points = points.take(np.sort(rng.choice(len(points), _OVERLAP_PIXELS, replace=False)))
    view = DepthView(reference.camera, reference.depth, reference.depth_sigma)
    seen = see(points, T_query_ref, view, query)
    overlap = float(np.mean(seen.visible)) if len(points) else 0.0
    inside = np.nonzero(seen.inside)[0]
    rows = inside[spread_sample(points.uv[inside], reference.camera, count, rng)]
    chosen, sigma = points.take(rows), None
    if sigma_pose is not None:
        sigma = pixel_sigma(chosen, reference.camera, query.camera, T_query_ref, *sigma_pose)
    known = points.take(seen.visible)
    back = _overlap_of_query(view, T_query_ref, query)
    measures = measured(
        PairMeasures(overlap, back), known.uv, known.depth, reference, query.camera, T_query_ref, query_image
    )
    return PairCorrespondences(
        chosen.uv, chosen.depth, seen.uv_query[rows], seen.visible[rows], seen.check[rows], measures, sigma
    )


def _overlap_of_query(reference: DepthView, T_query_ref: Array, query: DepthView) -> float | None:
    """The share of the query's pixels with depth that the keyframe sees; None where no depth of the query is known."""
    if query.depth is None:
        return None
    v, u = np.nonzero(query.depth > 0)
    if not len(u):
        return None
    rows = np.linspace(0, len(u) - 1, min(len(u), _SAMPLES)).astype(np.int64)
    z = query.depth[v[rows], u[rows]].astype(np.float64)
    points = ReferencePoints(np.column_stack([u[rows], v[rows]]).astype(np.float64), z, query.sigma(z))
    return float(np.mean(see(points, invert(T_query_ref), query, reference).visible))


def spread_sample(pixels: Array, camera: Camera, count: int, rng: np.random.Generator) -> Indices:
    """Rows of up to ``count`` of the pixels (N, 2), sampled evenly over cells of the image, in increasing order.

    No cell gives a second pixel before every cell has given one.
    """
    if len(pixels) <= count:
        return np.arange(len(pixels))
    side = max(camera.size) / _CELLS
    row, column = np.floor(pixels[:, 1] / side).astype(int), np.floor(pixels[:, 0] / side).astype(int)
    cell = row * (_CELLS + 1) + column
    shuffled = rng.permutation(len(pixels))
    by_cell = shuffled[np.argsort(cell[shuffled], kind="stable")]
    counts = np.unique(cell, return_counts=True)[1]
    turn = np.empty(len(pixels), dtype=np.int64)
    turn[by_cell] = np.arange(len(pixels)) - np.repeat(np.cumsum(counts) - counts, counts)
    first = shuffled[np.argsort(turn[shuffled], kind="stable")[:count]]
    return np.sort(first)


def sampled_pixels(camera: Camera, count: int, rng: np.random.Generator) -> Array:
    """Pixels (N, 2) of an image in raster order, enough for a pair's overlap and ``count`` correspondences."""
    size = camera.width * camera.height
    drawn = np.sort(rng.choice(size, min(size, max(_SAMPLES, 4 * count)), replace=False))
    return np.column_stack([drawn % camera.width, drawn // camera.width]).astype(np.float64)


def exact_pair(
    reference: Reference,
    pixels: Array,
    depth: Array,
    uv_query: Array,
    inside: Mask,
    visible: Mask,
    count: int,
    rng: np.random.Generator,
    camera_query: Camera,
    T_query_ref: Array,
    overlap_query: float | None,
    query_image: Image,
) -> PairCorrespondences:
    """A pair whose truth is exact: what the query sees of all sampled pixels, and up to ``count`` of those ``inside``.

    Args:
        reference: the keyframe as methods get it; its depth may be worse than the truth.
        pixels, depth, uv_query: (N, 2), (N,) and (N, 2) of the sampled pixels that have depth.
        inside, visible: (N,) whether the query's image holds the point, and whether nothing hides it.
    """
    candidates = np.nonzero(inside)[0]
    rows = candidates[spread_sample(pixels[candidates], reference.camera, count, rng)]
    check = np.full(len(rows), CHECKS.index("both"), dtype=np.int8)
    overlaps = PairMeasures(float(np.mean(visible)) if len(visible) else 0.0, overlap_query)
    measures = measured(overlaps, pixels[visible], depth[visible], reference, camera_query, T_query_ref, query_image)
    return PairCorrespondences(pixels[rows], depth[rows], uv_query[rows], visible[rows], check, measures)


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
