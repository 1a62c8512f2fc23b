"""A lens that bends straight lines, and the rectification of its images to a pinhole camera.

Recorded images were taken through such lenses and resampled, which softens them most where the lens compressed them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeVar, cast

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.geometry import Camera

Picture = TypeVar("Picture", Image, Floats)


@dataclass(frozen=True)
class RadialLens:
    """The lens by which the images of a pinhole camera were taken.

    By Brown ("Close-range camera calibration", 1971) a point that is seen at a distance d from the centre, in units of
    the focal length, is imaged by a pinhole at ``d (1 + bend d^2)``.
    """

    camera: Camera
    """pinhole camera of the rectified images"""
    distortion: float
    """share of their distance from the centre by which corners are moved, from -0.3 (barrel) to 0.3 (pincushion)"""

    @cached_property
    def bend(self) -> float:
        """The coefficient of d^2 such that the farthest corner at distance r is seen at ``d = r (1 + distortion)``."""
        c = self.camera
        x, y = max(c.cx, c.width - 1 - c.cx) / c.fx, max(c.cy, c.height - 1 - c.cy) / c.fy
        return -self.distortion / ((1 + self.distortion) ** 3 * (x**2 + y**2))

    @cached_property
    def taken(self) -> Camera:
        """Size, focal length and centre of the image that is taken.

        The focal length is the longest by which the image that is taken holds the whole rectified image.
        """
        c = self.camera
        border = np.ones((c.height, c.width), dtype=bool)
        border[1:-1, 1:-1] = False
        seen = self._seen()[border]
        scale = float((1 + self.bend * (seen**2).sum(axis=-1)).min())
        return Camera("pinhole", c.width, c.height, scale * c.fx, scale * c.fy, c.cx, c.cy)

    def rectified(self, image: Picture) -> Picture:
        """The image (H, W) or (H, W, 3) as the pinhole camera would have taken it, by linear interpolation."""
        u, v = _maps(self)
        return cast(Picture, cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _seen(self) -> Array:
        """Where the lens shows each pixel of the rectified image: (H, W, 2) from the centre, in focal lengths."""
        c = self.camera
        inverse = Camera("radtan", c.width, c.height, c.fx, c.fy, c.cx, c.cy, (self.bend, 0.0, 0.0, 0.0))
        rays, _ = inverse.unproject(np.stack(np.meshgrid(np.arange(c.width), np.arange(c.height)), axis=-1))
        return rays[..., :2]


@lru_cache(maxsize=8)
def _maps(lens: RadialLens) -> tuple[Floats, Floats]:
    """For each pixel of the rectified image the column and the row (H, W) of the image that is taken."""
    seen, c = lens._seen(), lens.taken
    u, v = c.fx * seen[..., 0] + c.cx, c.fy * seen[..., 1] + c.cy
    return u.astype(np.float32), v.astype(np.float32)
