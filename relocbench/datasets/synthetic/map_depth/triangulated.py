"""A sparse map, as SLAM and structure from motion make it: points at corners, whose depth was triangulated.

Two views with the baseline b see a point at the inverse depth rho with the parallax ``f b rho``. If the parallax has an
error of e pixels, that of rho is ``sigma = e / (f b)``, the same for all points.
"""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Floats, Image, Mask
from relocbench.datasets.core.images import as_grey
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

TRIANGULATION_BASELINE_M = 1.0
"""between the views that a point is triangulated from: drives go 0.8 m from one frame to the next, and visual odometry
makes a keyframe of every frame or two at such speeds"""
_FARTHEST = 0.25
"""greatest sigma of an inverse depth relative to it; maps drop points that they know worse"""
_LEAST_CORNER = 0.003
"""strength of the weakest corners relative to the strongest of the image"""
_SPREAD = 0.5
"""least distance of points relative to that of as many points on a regular grid"""


def triangulated_up_to(camera: Camera, error_px: float) -> float:
    """The depth in metres at which points end."""
    return _FARTHEST * camera.fx * TRIANGULATION_BASELINE_M / error_px


def triangulated_points(
    image: Image, depth: Floats, usable: Mask, camera: Camera, count: int, error_px: float, rng: np.random.Generator
) -> KeyframePoints:
    """Up to ``count`` points at corners of an image, spread over it.

    Args:
        image: (H, W) or (H, W, 3).
        depth: exact depth (H, W) in metres, 0 for none.
        usable: (H, W) pixels that may be points; a map has none on what moves.
        error_px: standard deviation of the parallax in pixels.
    """
    sigma = error_px / (camera.fx * TRIANGULATION_BASELINE_M)
    # By the exact depth: if it were by the drawn one, those would be left that are drawn too near.
    near = usable & (depth > 0) & (depth <= triangulated_up_to(camera, error_px))
    apart = _SPREAD * float(np.sqrt(depth.size / count))
    found = cv2.goodFeaturesToTrack(as_grey(image), count, _LEAST_CORNER, apart, mask=near.astype(np.uint8))
    uv = np.zeros((0, 2)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 2)
    u, v = np.rint(uv).astype(int).T
    inverse = 1.0 / depth[v, u].astype(np.float64) + sigma * rng.normal(size=len(uv))
    kept = inverse > 0
    return KeyframePoints(uv[kept], inverse[kept], np.full(np.count_nonzero(kept), sigma))
