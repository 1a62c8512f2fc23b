"""The pose of a camera from 2-D to 3-D matches: a robust search, then refinement of the reprojection error."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.geometry import Camera, apply, compose, hat, make_transform, se3_exp, so3_exp

PIXEL_NOISE = 0.5  # standard deviation of a keypoint on the finest pyramid level, pixels
_HUBER = 2.0  # in units of this noise
_ROUNDS = 5  # largest number of selections of inliers
_STEPS = 20  # largest number of Levenberg-Marquardt steps in each round
_STEP = 1e-6  # relative step of the numerical derivative of the projection
_CONVERGED = 1e-9  # metres and radians
_RIVAL_REACH = 3.0  # in units of the inlier threshold
_RIVAL_ITERATIONS = 1000
_RIVAL_CONFIDENCE = 0.999
_UNCONSTRAINED = np.diag(np.full(6, np.inf))


@dataclass(frozen=True, eq=False)
class Matches2D3D:
    """Points of the reference frame and the query pixels that see them."""

    points: Array
    """(N, 3) metres, reference camera frame"""
    pixels: Array
    """(N, 2) query pixels"""
    scale: Array
    """(N,) size, in image pixels, of a pyramid pixel of the coarser of the two keypoints; at least 1"""
    depth_direction: Array
    """(N, 3) metres; the displacement of the point by one standard deviation of its depth"""
    reference_pixels: Array | None = None
    """(N, 2) pixels of the keyframe that the points come from, where they are told; nothing is computed from them"""

    def __len__(self) -> int:
        return len(self.points)


def ransac_pose(
    matches: Matches2D3D,
    camera: Camera,
    threshold_px: float,
    max_iterations: int,
    confidence: float,
    seed: int,
    best_first: bool = False,
) -> Array | None:
    """Find the pose by RANSAC with MAGSAC scores (Barath et al., CVPR 2020), as in OpenCV's USAC.

    Pixels of a distorted camera are first undistorted to the pinhole camera with the same K. If the matches are sorted
    with the most reliable ones first (``best_first``), early samples are drawn among these (PROSAC: Chum and Matas,
    CVPR 2005).

    Returns:
        ``T_query_ref`` (4, 4), or None if no pose is found.
    """
    pinhole = camera.pinhole()
    pixels, valid = camera.undistort(matches.pixels)
    usable = np.flatnonzero(valid)
    if len(usable) < 4:
        return None
    parameters = cv2.UsacParams()
    parameters.threshold = threshold_px
    parameters.maxIterations = max_iterations
    parameters.confidence = confidence
    parameters.randomGeneratorState = seed % 2**31
    parameters.isParallel = False
    if best_first:
        parameters.sampler = cv2.SAMPLING_PROSAC
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.final_polisher = cv2.MAGSAC
    parameters.final_polisher_iterations = 3
    found, _, rotation_vector, translation, _ = cv2.solvePnPRansac(
        matches.points[usable], pixels[usable], pinhole.matrix, None, params=parameters
    )
    if not found or rotation_vector is None or not np.all(np.isfinite([rotation_vector, translation])):
        return None
    return make_transform(so3_exp(rotation_vector[:, 0]), translation[:, 0])


@dataclass(frozen=True, eq=False)
class Refined:
    """A pose at the minimum of the robust reprojection error, and its uncertainty."""

    T_query_ref: Array
    """(4, 4)"""
    inliers: Indices
    """indices of the matches that agree with it"""
    rms_px: float
    """root mean square of the inliers' reprojection errors, each divided by its keypoint's scale"""
    covariance: Array
    """(6, 6) of a left twist (rho, phi) on the pose, metres and radians; infinite if the pose is not determined"""

    @property
    def sigmas(self) -> tuple[float, float]:
        """The standard deviations of translation (m) and rotation (rad), each over all three axes."""
        variance = np.diag(self.covariance)
        return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:].sum()))


def refine_pose(T_query_ref: Array, matches: Matches2D3D, camera: Camera, threshold_px: float) -> Refined:
    """Minimise the robust reprojection error, and select the inliers anew after each minimisation.

    The covariance of a match is that of its keypoint plus the projected uncertainty of its depth,
    ``S = sigma^2 I + j j^T``. A match is an inlier if ``sqrt(e^T S^-1 e)``, in pixels, is at most ``threshold_px``.
    Errors are measured in the original, possibly distorted image.
    """
    pose, inliers = T_query_ref, np.zeros(0, dtype=np.intp)
    for _ in range(_ROUNDS):
        error, whitening, _ = _linearise(pose, matches, camera)
        distance = np.linalg.norm(np.einsum("nij,nj->ni", whitening, error), axis=-1)
        selected = np.flatnonzero(distance <= threshold_px)
        if np.array_equal(selected, inliers) or len(selected) < 4:
            inliers = selected
            break
        inliers = selected
        pose = _minimise(pose, _take(matches, inliers), camera)
    kept = _take(matches, inliers)
    error, whitening, jacobian = _linearise(pose, kept, camera)
    if len(kept) == 0 or not np.all(np.isfinite(error)):
        return Refined(pose, inliers, np.nan, _UNCONSTRAINED)
    normal, _, _ = _normal_equations(error, whitening, jacobian)
    scaled = np.linalg.norm(error, axis=-1) / kept.scale
    return Refined(pose, inliers, float(np.sqrt(np.mean(scaled**2))), _covariance(normal))


def rival_inliers(T_query_ref: Array, matches: Matches2D3D, camera: Camera, threshold_px: float, seed: int) -> int:
    """The number of matches that agree with the best other pose: the one found from those that are far from this pose.

    Where a street repeats itself, a wrong pose may have many inliers, but then others have as many. Errors are in units
    of the keypoints' scales; matches within three thresholds of the pose are left out, since they would give it again.
    """
    far = _take(matches, np.flatnonzero(~(_scaled_errors(T_query_ref, matches, camera) <= _RIVAL_REACH * threshold_px)))
    other = ransac_pose(far, camera, threshold_px, _RIVAL_ITERATIONS, _RIVAL_CONFIDENCE, seed)
    return 0 if other is None else int(np.count_nonzero(_scaled_errors(other, far, camera) <= threshold_px))


def _scaled_errors(T_query_ref: Array, matches: Matches2D3D, camera: Camera) -> Array:
    """Reprojection errors (N,), each divided by its keypoint's scale; NaN where a point is not visible."""
    pixels, _ = camera.project(apply(T_query_ref, matches.points))
    out: Array = np.linalg.norm(pixels - matches.pixels, axis=-1) / matches.scale
    return out


def _take(matches: Matches2D3D, index: Indices) -> Matches2D3D:
    return Matches2D3D(
        matches.points[index], matches.pixels[index], matches.scale[index], matches.depth_direction[index]
    )


def _linearise(pose: Array, matches: Matches2D3D, camera: Camera) -> tuple[Array, Array, Array]:
    """Errors (N, 2) in pixels, whitening W (N, 2, 2) with ``W^T W = S^-1``, and derivatives (N, 2, 6) by the twist.

    ``T <- exp(xi) T`` moves a point P of the query frame by ``[I, -P^] xi``. The error of a point that is not visible
    is NaN.
    """
    in_query = apply(pose, matches.points)
    pixels, _ = camera.project(in_query)
    d_projection = _projection_derivative(in_query, camera)
    d_point = np.concatenate([np.broadcast_to(np.eye(3), (len(in_query), 3, 3)), -hat(in_query)], axis=-1)
    by_depth = np.einsum("nij,jk,nk->ni", d_projection, pose[:3, :3], matches.depth_direction)
    jacobian = d_projection @ d_point
    differentiable = np.all(np.isfinite(jacobian), axis=(1, 2))
    error = np.where(differentiable[:, None], pixels - matches.pixels, np.nan)
    return error, _whitening(matches.scale, by_depth), jacobian


def _projection_derivative(points: Array, camera: Camera) -> Array:
    """The derivative d pixel / d point (N, 2, 3), by central differences, which suit every camera model."""
    step = _STEP * np.linalg.norm(points, axis=-1)
    columns = []
    for axis in np.eye(3):
        shift = step[:, None] * axis
        ahead, behind = camera.project(points + shift)[0], camera.project(points - shift)[0]
        columns.append((ahead - behind) / (2 * step[:, None]))
    return np.stack(columns, axis=-1)


def _whitening(scale: Array, by_depth: Array) -> Array:
    """``S^-1/2`` of ``S = scale^2 I + j j^T``, in units of one pixel.

    j is ``by_depth`` over the pixel noise of the finest scale. S has the eigenvalues scale^2 + |j|^2 along j and
    scale^2 across it.
    """
    j = by_depth / PIXEL_NOISE
    length = np.linalg.norm(j, axis=-1)
    direction = j / np.where(length > 0, length, 1.0)[:, None]
    across, along = 1.0 / scale, 1.0 / np.hypot(scale, length)
    outer = direction[:, :, None] * direction[:, None, :]
    out: Array = across[:, None, None] * np.eye(2) + (along - across)[:, None, None] * outer
    return out


def _normal_equations(error: Array, whitening: Array, jacobian: Array) -> tuple[Array, Array, float]:
    """``J^T W J`` (6, 6), ``J^T W e`` (6,) and the Huber cost, in units of the pixel noise."""
    e = np.einsum("nij,nj->ni", whitening, error) / PIXEL_NOISE
    j = whitening @ jacobian / PIXEL_NOISE
    distance = np.linalg.norm(e, axis=-1)
    weight = np.minimum(1.0, _HUBER / np.maximum(distance, 1e-12))
    cost = float(np.sum(np.where(distance <= _HUBER, 0.5 * distance**2, _HUBER * (distance - 0.5 * _HUBER))))
    weighted = weight[:, None, None] * j
    return np.einsum("nki,nkj->ij", weighted, j), np.einsum("nki,nk->i", weighted, e), cost


def _minimise(pose: Array, matches: Matches2D3D, camera: Camera) -> Array:
    """Minimise by Levenberg-Marquardt with Marquardt's scaling, which does not depend on the units."""
    error, whitening, jacobian = _linearise(pose, matches, camera)
    normal, gradient, cost = _normal_equations(error, whitening, jacobian)
    damping = 1e-4
    for _ in range(_STEPS):
        diagonal = np.diag(np.maximum(np.diag(normal), 1e-12))
        step = -np.linalg.solve(normal + damping * diagonal, gradient)
        candidate = compose(se3_exp(step), pose)
        error, _, jacobian = _linearise(candidate, matches, camera)
        # The whitening is kept: if it followed the pose, larger uncertainties would lower the cost.
        next_normal, next_gradient, next_cost = _normal_equations(error, whitening, jacobian)
        if not next_cost <= cost:  # also true if a point left the view and the cost is NaN
            damping *= 10.0
            if damping > 1e8:
                break
            continue
        pose, normal, gradient, cost = candidate, next_normal, next_gradient, next_cost
        damping = max(damping / 10.0, 1e-9)
        if np.abs(step).max() < _CONVERGED:
            break
    return pose


def _covariance(normal: Array) -> Array:
    """The inverse of the normal equations; infinite on the diagonal if they are numerically singular."""
    scale = np.sqrt(np.diag(normal))
    if np.all(scale > 0):
        scaled = normal / np.outer(scale, scale)
        if np.linalg.eigvalsh(scaled)[0] > 1e-12:
            return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))
    return _UNCONSTRAINED
