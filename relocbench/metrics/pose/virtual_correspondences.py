"""The virtual correspondence reprojection error (VCRE): how far off things are drawn into the query's image.

Arnold et al., "Map-free Visual Relocalization: Metric Pose Relative to a Single Image", ECCV 2022. A grid V of virtual
points stands in front of the true query camera, v in its frame. The estimated pose draws each of them elsewhere::

    VCRE = 1/|V| sum over v of || pi(v) - pi(T_pred T_gt^-1 v) ||

with ``pi`` the projection by the query's K, moved to the nearest point of the image where it falls outside, as in the
authors' evaluation. Three things are decided here. A point that is not in front of the estimated camera is as far off
as the image allows, by its diagonal: the authors divide by its negative depth, which draws it upside down. The error
is divided by the diagonal, 900 px in their data, so that images of different sizes compare. Of a camera with
distortion only K is used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array
from relocbench.geometry import Camera, apply, invert
from relocbench.metrics.pose.failure_policy import answered_pairs, infinite_where_failed

STEP_M = 0.3
"""between neighbouring points of the grid"""
COUNTS = (7, 4, 7)
"""points along x, y and z"""
NEAREST_M = 1.8
"""depth of the nearest points"""
_CHUNK = 2048
"""pairs that are projected at once"""


def virtual_points() -> Array:
    """The grid V in the query camera's frame, (196, 3) metres: centred on the optical axis, from 1.8 to 3.6 m deep."""
    x, y, z = (np.arange(count) * STEP_M for count in COUNTS)
    grid = np.meshgrid(x - x.mean(), y - y.mean(), z + NEAREST_M, indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


def reprojection_errors(T_pred: ArrayLike, T_gt: ArrayLike, camera: Camera, answered: ArrayLike | None = None) -> Array:
    """The VCRE of pairs whose queries have one camera, as shares of its image's diagonal.

    Args:
        T_pred, T_gt, answered: as of :func:`relocbench.metrics.pose_errors`.

    Returns:
        (N,) in 0..1; inf without an answer.

    Raises:
        ValueError: the shapes do not fit.
    """
    pred, gt = np.asarray(T_pred, dtype=np.float64), np.asarray(T_gt, dtype=np.float64)
    valid = answered_pairs(pred, answered)
    if gt.shape != pred.shape:
        raise ValueError(f"true poses must have the shape {pred.shape} of the predicted ones, got {gt.shape}")
    out = np.full(len(pred), np.inf)
    rows = np.flatnonzero(valid)
    for start in range(0, len(rows), _CHUNK):
        chosen = rows[start : start + _CHUNK]
        with np.errstate(over="ignore", invalid="ignore"):  # a pose that is absurdly far off overflows
            out[chosen] = _errors(pred[chosen] @ invert(gt[chosen]), camera.pinhole())
    return infinite_where_failed(out, valid)


def _errors(T_pred_gt: Array, camera: Camera) -> Array:
    """The errors (N,) where the true query camera is at ``T_pred_gt`` (N, 4, 4) in the frame of the estimated one."""
    points = virtual_points()
    diagonal = float(np.hypot(*camera.size))
    true, _ = camera.project(points)
    drawn, in_front = camera.project(apply(T_pred_gt, points))
    distance = np.linalg.norm(_on_image(drawn, camera) - _on_image(true, camera), axis=-1)
    out: Array = np.mean(np.where(in_front, distance / diagonal, 1.0), axis=1)
    return out


def _on_image(pixels: Array, camera: Camera) -> Array:
    """The nearest points (..., 2) of the image, whose pixels reach half a pixel beyond their centres."""
    return np.clip(pixels, -0.5, np.array(camera.size) - 0.5)
