"""Undistortion of images, depth and keyframe points to the pinhole camera with the same K."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints


def undistort(image: NDArray[Any], camera: Camera, nearest: bool = False) -> NDArray[Any]:
    """The image (H, W) or (H, W, 3) that ``camera.pinhole()`` would have taken; 0 outside the camera's view.

    That of a pinhole camera is returned as it is.

    Args:
        nearest: take the nearest pixel instead of interpolating, which would mix depths across an edge.
    """
    if camera.model == "pinhole":
        return image
    u, v = _undistortion_map(camera)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR))


def undistort_points(points: KeyframePoints, camera: Camera) -> KeyframePoints:
    """Points of a distorted image in that of ``camera.pinhole()``, without those whose ray is unknown.

    A wide lens sees more than the pinhole camera with the same K and size: points outside its image are left out too.
    """
    pinhole = camera.pinhole()
    pixels, valid = camera.undistort(points.uv, pinhole)
    valid &= pinhole.contains(pixels, border=-0.5)
    return KeyframePoints(pixels[valid], points.inverse_depth[valid], points.sigma[valid])


@lru_cache(maxsize=8)
def _undistortion_map(camera: Camera) -> tuple[Floats, Floats]:
    return camera.undistortion_map()
