"""Images as a pinhole camera shows them, and coloured points of keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Image
from relocbench.datasets.core.images import as_rgb
from relocbench.datasets.pairs.correspondences import spread_sample
from relocbench.datasets.pairs.visibility import ReferencePoints, lift
from relocbench.geometry import Camera
from relocbench.tracking import Reference

_WIDTH = 320
"""pixels; frusta in the world have images of at most this width"""


@dataclass(frozen=True, eq=False)
class ColouredPoints:
    """Points of a keyframe in its camera's frame."""

    positions: Array
    """(N, 3) metres"""
    colours: Image
    """(N, 3) RGB"""


def as_pinhole(image: Image, camera: Camera) -> Image:
    """The image as the undistorted camera with the same K and size sees it; black where nothing is known."""
    if camera.model == "pinhole":
        return image
    u, v = camera.undistortion_map()
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), dtype=np.uint8)


def reduced(camera: Camera) -> Camera:
    """The undistorted camera of an image that is at most 320 pixels wide: enough within a view of the world."""
    return camera.pinhole().scaled(min(1.0, _WIDTH / camera.width))


def keyframe_points(reference: Reference, most: int, seed: int = 0) -> ColouredPoints:
    """Up to ``most`` points of a keyframe, from its depth or sparse points, spread over its image."""
    points = ReferencePoints.of(reference)
    rng = np.random.default_rng([seed, (reference.timestamp_ns or 0) % 2**64])
    points = points.take(spread_sample(points.uv, reference.camera, most, rng))
    positions, valid = lift(reference.camera, points.uv, points.depth)
    u, v = np.rint(points.uv[valid]).astype(int).T
    rgb = as_rgb(reference.image)
    height, width = rgb.shape[:2]
    return ColouredPoints(positions[valid], rgb[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)])
