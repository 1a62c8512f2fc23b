"""How hard a pair is to answer, measured at its true pose: what its images share, at which scale, how alike it looks.

All of it follows from the true pose, the keyframe's depth and the two images, for rendered and recorded datasets alike.
:mod:`relocbench.metrics.pose.tiers` sorts pairs by these measures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from relocbench.arrays import Array, Image
from relocbench.datasets.core.images import as_grey
from relocbench.datasets.pairs.visibility import ReferencePoints, lift, warp
from relocbench.geometry import Camera, apply
from relocbench.tracking import Reference

_WIDTH = 256
"""pixels; images are reduced to about this width before patches are compared, so that noise counts the same"""
_PATCH = 11
"""pixels; side of a patch"""
_PATCHES = 400
"""patches that are compared at most"""
_FEWEST = 10
"""patches, without which nothing is said"""
_ONE_SURFACE = 0.2
"""depths within 20 % of the one in the middle of a patch belong to its surface"""
_LEAST_CONTRAST = 8.0
"""smallest standard deviation of a keyframe's patch in grey levels, well above the noise of a camera"""


@dataclass(frozen=True)
class PairMeasures:
    """The measures of one pair, as its table keeps them; None where one is not known."""

    overlap: float | None = None
    """share of the keyframe's pixels with depth that the query sees"""
    overlap_query: float | None = None
    """share of the query's pixels with depth that the keyframe sees"""
    scale_change: float | None = None
    """median change of scale of what the query sees of the keyframe, 1 or more"""
    depth_error: float | None = None
    """median sigma of the keyframe's depths within the query's image, relative to the depth"""
    similarity: float | None = None
    """median correlation, -1 to 1, of patches of the keyframe with what the query shows there"""


def measured(
    overlaps: PairMeasures,
    pixels: Array,
    depth: Array,
    reference: Reference,
    query_camera: Camera,
    T_query_ref: Array,
    query_image: Image | None,
) -> PairMeasures:
    """The measures of a pair whose overlaps are known.

    Args:
        pixels, depth: (N, 2) and (N,) metres along z, of the keyframe's pixels that the query sees.
        T_query_ref: (4, 4) the true pose.
        query_image: without it, the pair has no similarity.
    """
    cameras = reference.camera, query_camera
    alike = None
    if query_image is not None:
        alike = similarity(reference, query_camera, query_image, T_query_ref, pixels, depth)
    return replace(
        overlaps,
        scale_change=scale_change(pixels, depth, *cameras, T_query_ref),
        depth_error=depth_error(reference, query_camera, T_query_ref),
        similarity=alike,
    )


def scale_change(
    pixels: Array, depth: Array, camera_ref: Camera, camera_query: Camera, T_query_ref: Array
) -> float | None:
    """The median change of scale of surface points between keyframe and query.

    A patch at the distance d from a camera of focal length f (the geometric mean of fx and fy) is seen at the scale
    f / d. With ``s = (f_query / d_query) / (f_ref / d_ref)`` of each point it is ``exp(median |log s|)``: the same
    whether the query is nearer or farther by a factor, and whichever of the two images is the keyframe. Distances are
    those from the camera's centre, so that a camera that only turns changes no scale.

    Args:
        pixels, depth: (N, 2) and (N,) metres along z, of the points that both cameras see.

    Returns:
        1 or more; None without points.
    """
    points, known = lift(camera_ref, pixels, depth)
    if not known.any():
        return None
    before = np.linalg.norm(points[known], axis=1)
    after = np.linalg.norm(apply(T_query_ref, points[known]), axis=1)
    focal = np.sqrt((camera_query.fx * camera_query.fy) / (camera_ref.fx * camera_ref.fy))
    return float(np.exp(np.median(np.abs(np.log(focal * before / after)))))


def depth_error(reference: Reference, query_camera: Camera, T_query_ref: Array) -> float | None:
    """The median of sigma(z) / z over the keyframe's pixels with depth that lie within the query's image.

    Sigma is what the map states of its depth. None without such a pixel.
    """
    points = ReferencePoints.of(reference)
    stacked = np.column_stack([points.uv, points.depth])
    uv, _, valid = warp(stacked, reference.camera, query_camera, T_query_ref)
    rows = valid & query_camera.contains(np.nan_to_num(uv))
    return round(float(np.median(points.sigma[rows] / points.depth[rows])), 6) if rows.any() else None


def similarity(
    reference: Reference, query_camera: Camera, query_image: Image, T_query_ref: Array, pixels: Array, depth: Array
) -> float | None:
    """The median zero-mean normalised cross-correlation of patches around points that the query sees.

    Each pixel of a patch is taken to the query by its own depth, where the keyframe has dense depth, or by that of the
    patch's middle, so that a change of viewpoint alone lowers nothing. Patches without contrast in the keyframe are
    left out; one that is uniform in the query has no correlation, 0.

    Args:
        pixels, depth: (N, 2) and (N,) metres along z, of the keyframe's pixels that the query sees.

    Returns:
        -1 to 1; None with fewer than ten patches.
    """
    if len(depth) < _FEWEST:
        return None
    grey_ref, grey_query = as_grey(reference.image), as_grey(query_image)
    step_ref = max(1, round(grey_ref.shape[1] / _WIDTH))
    step_query = max(1, round(grey_query.shape[1] / _WIDTH))
    rows = np.linspace(0, len(depth) - 1, min(len(depth), _PATCHES)).astype(np.int64)
    centres, middle = pixels[rows], depth[rows, None]
    half = step_ref * (_PATCH // 2)
    dv, du = np.mgrid[-half : half + 1 : step_ref, -half : half + 1 : step_ref].reshape(2, -1)
    u, v = centres[:, :1] + du, centres[:, 1:] + dv
    z = np.broadcast_to(middle, u.shape)
    inside = (u >= 0) & (v >= 0) & (u <= grey_ref.shape[1] - 1) & (v <= grey_ref.shape[0] - 1)
    if reference.depth is not None:
        own = reference.depth[
            np.clip(np.rint(v), 0, grey_ref.shape[0] - 1).astype(int),
            np.clip(np.rint(u), 0, grey_ref.shape[1] - 1).astype(int),
        ].astype(np.float64)
        # A pixel of another surface has a depth of its own, which the query need not see there.
        z = np.where((own > 0) & (np.abs(own - middle) < _ONE_SURFACE * middle), own, middle)
    uv, _, valid = warp(np.column_stack([u.ravel(), v.ravel(), z.ravel()]), reference.camera, query_camera, T_query_ref)
    inside &= (valid & query_camera.contains(np.nan_to_num(uv))).reshape(u.shape)
    here = _sampled(grey_ref, u, v, step_ref)
    keep = inside.all(axis=1) & (here.std(axis=1) >= _LEAST_CONTRAST)
    if np.count_nonzero(keep) < _FEWEST:
        return None
    x, y = np.nan_to_num(uv).T
    there = _sampled(grey_query, x.reshape(u.shape), y.reshape(u.shape), step_query)
    a, b = (k[keep] - k[keep].mean(axis=1, keepdims=True) for k in (here, there))
    norm = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    correlations = np.where(norm > 0, np.sum(a * b, axis=1) / np.maximum(norm, 1e-12), 0.0)
    return round(float(np.median(correlations)), 4)


def _sampled(grey: Image, u: Array, v: Array, step: int) -> Array:
    """Grey levels at pixels (N, K), each the mean over ``step`` x ``step`` pixels around it."""
    smooth = grey if step == 1 else cv2.blur(grey, (step, step))
    # The mean over an even number of pixels is that of a place half a pixel before the one where it is stored.
    x, y = (np.asarray(k + 0.5 * (step % 2 == 0), np.float32) for k in (u, v))
    out = cv2.remap(smooth.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return out.astype(np.float64)
