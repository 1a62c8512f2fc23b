"""Pose of a camera from points and the pixels that see them: robust search, then refinement in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.geometry import Camera, apply, compose, hat, make_transform, se3_exp, so3_exp
from relocbench.tracking import Array

PIXEL_NOISE = 0.5  # standard deviation of a keypoint on the finest pyramid level, pixels
_HUBER = 2.0  # in units of that noise
_ROUNDS = 5  # re-selections of the inliers
_STEPS = 20  # Levenberg-Marquardt steps in each
_STEP = 1e-6  # relative, for the derivative of the projection
_STILL = 1e-9  # metres and radians
_UNHELD = np.diag(np.full(6, np.inf))


@dataclass(frozen=True, eq=False)
class Matches2D3D:
    """Points of the reference frame and the query pixels that see them."""

    points: Array
    """(N, 3) metres, reference camera frame"""
    pixels: Array
    """(N, 2) query pixels"""
    scale: Array
    """(N,) size of the coarser of the two keypoints' pyramid pixels, in image pixels, at least 1"""
    depth_direction: Array
    """(N, 3) metres: what one standard deviation of the point's depth does to it"""

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
    """Pose by minimal samples scored with MAGSAC (Barath et al., CVPR 2020), as in OpenCV's USAC.

    Pixels of a distorted camera are first moved to those of the pinhole camera with the same K. Where the matches are
    sorted, the likeliest to be right first (``best_first``), samples are drawn among the first ones at first (PROSAC:
    Chum and Matas, CVPR 2005).

    Returns:
        ``T_query_ref`` (4, 4), or None where none was found.
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
    """A pose at the minimum of the robust reprojection error, and how well it is held there."""

    T_query_ref: Array
    """(4, 4)"""
    inliers: NDArray[np.intp]
    """indices of the matches that agree with it"""
    rms_px: float
    """root mean square of the inliers' reprojection errors, each divided by its keypoint's scale"""
    covariance: Array
    """(6, 6) of a left twist (rho, phi) on the pose, metres and radians; infinite where the pose is not held"""

    @property
    def sigmas(self) -> tuple[float, float]:
        """Standard deviations of translation in metres and rotation in radians, each over its three axes together."""
        variance = np.diag(self.covariance)
        return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:].sum()))


def refine_pose(T_query_ref: Array, matches: Matches2D3D, camera: Camera, threshold_px: float) -> Refined:
    """Minimise the robust reprojection error, selecting the inliers anew after every minimisation.

    A match's covariance is that of its keypoint plus what the uncertainty of its depth does in the query image,
    ``S = sigma^2 I + j j^T``. A match is an inlier where ``sqrt(e^T S^-1 e)`` pixels stay below ``threshold_px``.
    The errors are true pixels, whatever the camera's distortion.
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
        return Refined(pose, inliers, np.nan, _UNHELD)
    normal, _, _ = _normal_equations(error, whitening, jacobian)
    scaled = np.linalg.norm(error, axis=-1) / kept.scale
    return Refined(pose, inliers, float(np.sqrt(np.mean(scaled**2))), _covariance(normal))


def _take(matches: Matches2D3D, index: NDArray[np.intp]) -> Matches2D3D:
    return Matches2D3D(
        matches.points[index], matches.pixels[index], matches.scale[index], matches.depth_direction[index]
    )


def _linearise(pose: Array, matches: Matches2D3D, camera: Camera) -> tuple[Array, Array, Array]:
    """Errors (N, 2) in pixels, whitenings W (N, 2, 2) with ``W^T W = S^-1``, and derivatives (N, 2, 6) by the twist.

    ``T <- exp(xi) T`` moves a point P of the query frame by ``[I, -P^] xi``. Errors are NaN where a point is not
    seen.
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
    """d pixel / d point (N, 2, 3), by central differences: right for every camera model."""
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
    return across[:, None, None] * np.eye(2) + (along - across)[:, None, None] * outer


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
    """Levenberg-Marquardt with Marquardt's scaling, which is indifferent to metres against radians."""
    error, whitening, jacobian = _linearise(pose, matches, camera)
    normal, gradient, cost = _normal_equations(error, whitening, jacobian)
    damping = 1e-4
    for _ in range(_STEPS):
        diagonal = np.diag(np.maximum(np.diag(normal), 1e-12))
        step = -np.linalg.solve(normal + damping * diagonal, gradient)
        candidate = compose(se3_exp(step), pose)
        error, _, jacobian = _linearise(candidate, matches, camera)
        # The whitening stays that of the start: were it to move, growing it would lower the cost.
        next_normal, next_gradient, next_cost = _normal_equations(error, whitening, jacobian)
        if not next_cost <= cost:  # also where a point left the view and the cost is NaN
            damping *= 10.0
            if damping > 1e8:
                break
            continue
        pose, normal, gradient, cost = candidate, next_normal, next_gradient, next_cost
        damping = max(damping / 10.0, 1e-9)
        if np.abs(step).max() < _STILL:
            break
    return pose


def _covariance(normal: Array) -> Array:
    """Inverse of the normal equations; infinite on the diagonal where they are singular to working precision."""
    scale = np.sqrt(np.diag(normal))
    if np.all(scale > 0):
        scaled = normal / np.outer(scale, scale)
        if np.linalg.eigvalsh(scaled)[0] > 1e-12:
            return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))
    return _UNHELD
