"""Points that two images of a camera share, and the motion between the images that they tell without any pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image, Indices
from relocbench.datasets.core.images import as_grey
from relocbench.datasets.core.traversal import Traversal
from relocbench.geometry import Camera, make_transform, rotation_angle, so3_exp

_WIDTH = 800
"""pixels; larger images are reduced to this width"""
_FEATURES = 1500
_RATIO = 0.8
"""of the distance to the second nearest descriptor (Lowe, IJCV 2004)"""
_INLIER_PX = 2.0
"""of the reduced image, by which a track may be off the epipolar line"""
_FEWEST = 40
"""tracks that a pair of images must have"""
_MOST = 200
_DEPTH_EDGE = 0.05
"""share of its depth by which the depths around a pixel may differ"""
_NEAR_PX = 2.0
"""pixels from a feature to a sparse point whose depth it takes"""


@dataclass(frozen=True, eq=False)
class Features:
    """SIFT features of an image."""

    rays: Array
    """(N, 2) X/Z and Y/Z in the camera's frame"""
    row: Array
    """(N,) where in the image they are, from -0.5 at the top to 0.5"""
    depth: Array
    """(N,) metres along z, NaN where unknown"""
    descriptors: Floats


@dataclass(frozen=True, eq=False)
class Tracks:
    """Points that the images ``first`` and ``second`` share, N of them."""

    first: int
    second: int
    x: Array
    """(N, 2) rays in the first image"""
    y: Array
    """(N, 2) in the second"""
    row_x: Array
    row_y: Array
    """(N,) as those of features"""
    depth: Array
    """(N,) metres in the first image, NaN where unknown"""


def features_of(traversal: Traversal, camera: str, timestamp_ns: int) -> Features:
    """The features of an image of a dataset. Raises DatasetError if the image or its depth is damaged."""
    model = traversal.camera(camera, timestamp_ns)
    image, dense = traversal.image(camera, timestamp_ns), traversal.depth(camera, timestamp_ns)
    uv, descriptors = _detect(image)
    rays, valid = model.unproject(uv)
    depth = np.full(len(uv), np.nan)
    if dense is not None:
        depth = _dense_depth(dense, uv)
    elif (points := traversal.points(camera, timestamp_ns)) is not None and len(points) and len(uv):
        from scipy.spatial import KDTree

        away, nearest = KDTree(points.uv).query(uv)
        depth = np.where(away <= _NEAR_PX, 1.0 / points.inverse_depth[nearest], np.nan)
    plain = rays[valid, :2] / rays[valid, 2:]
    return Features(plain, uv[valid, 1] / model.height - 0.5, depth[valid], descriptors[valid])


def _detect(image: Image) -> tuple[Array, Floats]:
    grey = as_grey(image)
    scale = min(1.0, _WIDTH / grey.shape[1])
    if scale < 1.0:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    detector = cv2.SIFT.create(nfeatures=_FEATURES, contrastThreshold=0.01, enable_precise_upscale=True)
    found, descriptors = detector.detectAndCompute(grey, None)
    if not found:
        return np.zeros((0, 2)), np.zeros((0, 128), dtype=np.float32)
    uv = (np.array([point.pt for point in found], dtype=np.float64) + 0.5) / scale - 0.5
    order = np.lexsort((uv[:, 0], uv[:, 1]))  # the detector's may depend on its threads
    return uv[order], np.asarray(descriptors, dtype=np.float32)[order]


def _dense_depth(depth: Floats, uv: Array) -> Array:
    """Depth (N,) at pixels where the surface is smooth."""
    height, width = depth.shape
    u, v = np.rint(uv.T).astype(int)
    u, v = np.clip(u, 1, width - 2), np.clip(v, 1, height - 2)
    around = np.stack([depth[v + down, u + right] for down in (-1, 0, 1) for right in (-1, 0, 1)]).astype(np.float64)
    middle = around[4]
    smooth = (around.min(axis=0) > 0) & (np.ptp(around, axis=0) <= _DEPTH_EDGE * middle)
    return np.where(smooth, middle, np.nan)


def match(first: int, a: Features, second: int, b: Features, camera: Camera) -> Tracks | None:
    """The tracks between two images that obey one epipolar geometry; None where they are too few."""
    if min(len(a.rays), len(b.rays)) < _FEWEST:
        return None
    forth, back = _nearest(a.descriptors, b.descriptors), _nearest(b.descriptors, a.descriptors)
    i = np.flatnonzero((forth >= 0) & (back[np.maximum(forth, 0)] == np.arange(len(forth))))
    j = forth[i]
    if len(i) < _FEWEST:
        return None
    scale = min(1.0, _WIDTH / camera.width)
    found: Any = cv2.findEssentialMat(
        a.rays[i], b.rays[j], np.eye(3), cv2.RANSAC, 0.999, _INLIER_PX / (camera.fx * scale)
    )
    essential, inliers = found
    if essential is None or inliers is None:
        return None
    kept = np.flatnonzero(np.ravel(inliers))
    if len(kept) < _FEWEST:
        return None
    kept = kept[np.unique(np.linspace(0, len(kept) - 1, _MOST).astype(int))]
    i, j = i[kept], j[kept]
    return Tracks(first, second, a.rays[i], b.rays[j], a.row[i], b.row[j], a.depth[i])


def _nearest(a: Floats, b: Floats) -> Indices:
    """(N,) the row of b that is clearly the nearest to each of a, -1 where none is."""
    out = np.full(len(a), -1, dtype=np.int64)
    for pair in cv2.BFMatcher(cv2.NORM_L2).knnMatch(a, b, k=2):
        if len(pair) == 2 and pair[0].distance < _RATIO * pair[1].distance:
            out[pair[0].queryIdx] = pair[0].trainIdx
    return out


def cross(a: Array, b: Array) -> Array:
    """Cross products (N, 3) of rows, (3,) or (N, 3); NumPy's takes ten times as long for few rows."""
    (a0, a1, a2), (b0, b1, b2) = a.T, b.T
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def epipolar_distances(x: Array, y: Array, rotation: Array, translation: Array) -> Array:
    """Distances (N,) of tracks x, y (N, 3) from epipolar lines, on the plane z = 1 (Sampson).

    Args:
        rotation: (3, 3) of the second camera from the first.
        translation: (3,) or (N, 3), of any length.
    """
    length = np.maximum(np.linalg.norm(translation, axis=-1, keepdims=True), 1e-12)
    t = np.broadcast_to(translation / length, x.shape)
    # y^T [t] R x: the triple product of y, t and R x.
    turned = x @ rotation.T
    line_y = cross(t, turned)
    line_x = cross(y, t) @ rotation
    norm = np.sqrt(np.sum(line_y[:, :2] ** 2, axis=1) + np.sum(line_x[:, :2] ** 2, axis=1))
    return np.asarray(np.sum(y * line_y, axis=1) / np.maximum(norm, 1e-12))


def homogeneous(rays: Array) -> Array:
    """(N, 3) with z = 1."""
    return np.column_stack([rays, np.ones(len(rays))])


def motion_by_depth(tracks: Tracks, x: Array, y: Array, fx: float) -> Array | None:
    """``T_second_first`` (4, 4) from tracks with depth, by perspective-n-point; None where too few have depth.

    Args:
        x, y: (N, 3) rays that take the place of those of the tracks.
    """
    known = np.isfinite(tracks.depth)
    if np.count_nonzero(known) < _FEWEST:
        return None
    points = x[known] / x[known, 2:] * tracks.depth[known, None]
    seen = y[known, :2] / y[known, 2:]
    found, turn, move, inliers = cv2.solvePnPRansac(
        points, seen, np.eye(3), None, reprojectionError=_INLIER_PX / fx, iterationsCount=500
    )
    if not found or inliers is None or len(inliers) < _FEWEST:
        return None
    chosen = np.ravel(inliers)
    turn, move = cv2.solvePnPRefineLM(points[chosen], seen[chosen], np.eye(3), None, turn, move)
    return make_transform(cv2.Rodrigues(turn)[0], np.ravel(move))


def rotation_by_lines(x: Array, y: Array, fx: float) -> Array | None:
    """The rotation (3, 3) between two images from rays (N, 3) alone, where their epipolar geometry tells it.

    The essential matrix is refined over the rotation and the direction of the translation by damped least squares of
    epipolar distances, with the loss of Huber.
    """
    plain_x, plain_y = x[:, :2] / x[:, 2:], y[:, :2] / y[:, 2:]
    essential, _ = cv2.findEssentialMat(plain_x, plain_y, np.eye(3), cv2.RANSAC, 0.999, _INLIER_PX / fx)
    if essential is None or essential.shape != (3, 3):
        return None
    *turns, direction = cv2.decomposeEssentialMat(essential)
    # The other one is half a turn away. A drive's next images are not.
    R: Array = min((np.asarray(turn, np.float64) for turn in turns), key=lambda turn: float(rotation_angle(turn)))
    t: Array = np.ravel(direction).astype(np.float64)
    residual = fx * epipolar_distances(x, y, R, t)
    damping = 1e-3
    for _ in range(20):
        across = np.linalg.svd(t[None])[2][1:]
        moved = [(so3_exp(1e-6 * axis) @ R, t) for axis in np.eye(3)] + [(R, t + 1e-6 * axis) for axis in across]
        J = np.column_stack([(fx * epipolar_distances(x, y, *one) - residual) / 1e-6 for one in moved])
        weight = 1.0 / np.maximum(1.0, np.abs(residual))
        H, g = J.T @ (J * weight[:, None]), J.T @ (weight * residual)
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H)) + 1e-9 * np.eye(5), g)
        R_new, t_new = so3_exp(step[:3]) @ R, t + step[3:] @ across
        new = fx * epipolar_distances(x, y, R_new, t_new)
        if _huber(new) < _huber(residual):
            small = _huber(residual) - _huber(new) < 1e-7 * _huber(residual)
            R, t, residual, damping = R_new, t_new / np.linalg.norm(t_new), new, damping / 5
            if small:
                break
        else:
            damping *= 5
            if damping > 1e4:
                break
    return R


def _huber(residual: Array) -> float:
    size = np.abs(residual)
    return float(np.sum(np.where(size < 1, size**2, 2 * size - 1)))
