"""A rolling shutter: rows are exposed one after the other, from the camera's motion and the depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.geometry import Camera, se3_exp

_ROUNDS = 8
"""of the fixed-point iteration; each makes the error smaller by the share that the motion is of the distance"""
_FAR_M = 1e6
"""depth of the sky"""


@dataclass(frozen=True, eq=False)
class Readout:
    """How the rows of one image are read while the camera moves."""

    seconds: float
    """from the first row to the last; the middle of the image is exposed at the time of the pose"""
    twist: Array
    """(6,) velocity of the camera in its own axes: m/s, then rad/s"""


def row_poses(height: int, readout: Readout) -> Array:
    """``T_cam_row`` (H, 4, 4): the camera at the time of each row, in the axes that it has at the time of the pose."""
    after_s = readout.seconds * (np.arange(height) / max(height - 1, 1) - 0.5)
    return np.asarray(se3_exp(after_s[:, None] * readout.twist))


def sources(depth: Floats, camera: Camera, readout: Readout) -> Floats:
    """Where (H, W, 2) a global shutter's image shows what each pixel of the rolling one shows.

    The place s of a pixel p of row r solves ``project(T_row_cam X(s)) = p``, where X(s) is the point at the depth that
    the global image has there. What the global image does not show, from behind something nearer, is not found: the
    iteration then stays at the nearer or the farther side.

    Args:
        depth: (H, W) metres along z of the global image; 0 is infinitely far.
    """
    height, width = depth.shape
    inverse = np.linalg.inv(row_poses(height, readout))
    v, u = (axis.astype(np.float64) for axis in np.mgrid[:height, :width])
    far = np.where(depth > 0, depth, _FAR_M).astype(np.float64)
    s_u, s_v = u.copy(), v.copy()
    for _ in range(_ROUNDS):
        column, row = (np.clip(np.rint(s), 0, n - 1).astype(int) for s, n in ((s_u, width), (s_v, height)))
        z = far[row, column]
        point = np.stack([(s_u - camera.cx) / camera.fx * z, (s_v - camera.cy) / camera.fy * z, z], axis=-1)
        moved = np.einsum("hij,hwj->hwi", inverse[:, :3, :3], point) + inverse[:, None, :3, 3]
        ahead = np.maximum(moved[..., 2], 1e-3)
        s_u += u - (camera.fx * moved[..., 0] / ahead + camera.cx)
        s_v += v - (camera.fy * moved[..., 1] / ahead + camera.cy)
    return np.stack([s_u, s_v], axis=-1).astype(np.float32)


def rolling(light: Floats, depth: Floats, camera: Camera, readout: Readout) -> tuple[Floats, Floats]:
    """Light (H, W, 3) and depth (H, W) of a global shutter's image as a rolling shutter sees them.

    An approximation in the image: what is outside of the image repeats its border, and other cars stand still.
    """
    at = sources(depth, camera, readout)
    border = cv2.BORDER_REPLICATE
    seen = cv2.remap(light, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=border)
    far = cv2.remap(depth, at[..., 0], at[..., 1], cv2.INTER_NEAREST, borderMode=border)
    return np.asarray(seen, dtype=np.float32), np.asarray(far, dtype=np.float32)
