"""Keyframes and queries made of a photograph: each pixel is the mean of four places, found exactly.

Both are made alike, so that a query that has not moved is the keyframe, but for rounding. A photograph of much higher
resolution is first reduced to two pixels for each of theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.moved_views.drawing import Crop, Keyframe, grid
from relocbench.datasets.moved_views.surfaces import seen_at

_OVERSAMPLED = 2.0
"""pixels of the reduced photograph along each side of one of a view"""
_PLACES = [(u, v) for v in (-0.25, 0.25) for u in (-0.25, 0.25)]
"""of the four samples of a pixel"""


@dataclass(frozen=True, eq=False)
class Reduced:
    """A photograph at a resolution that suits the views of a keyframe."""

    image: Floats
    """(H, W, 3) float32"""
    ratio: tuple[float, float]
    """its pixels for each of the photograph's, along u and v"""

    @classmethod
    def of(cls, photograph: Image, crop: Crop) -> Reduced:
        """Reduce a photograph (H, W, 3)."""
        height, width = photograph.shape[:2]
        wanted = min(_OVERSAMPLED * crop.scale, 1.0)
        size = round(width * wanted), round(height * wanted)
        small = photograph if wanted == 1.0 else cv2.resize(photograph, size, interpolation=cv2.INTER_AREA)
        return cls(np.asarray(small, dtype=np.float32), (small.shape[1] / width, small.shape[0] / height))

    def at(self, pixels: Array) -> Floats:
        """Values (H, W, 3) at pixels (H, W, 2) of the photograph, between pixels by cubic interpolation."""
        at = ((pixels + 0.5) * self.ratio - 0.5).astype(np.float32)
        u, v = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
        return np.asarray(cv2.remap(self.image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def view_of(photograph: Reduced, keyframe: Keyframe, T_query_ref: Array | None = None) -> Image:
    """What the camera sees (H, W, 3) after a motion (4, 4), or as the keyframe without one."""
    camera = keyframe.camera
    total = np.zeros((camera.height, camera.width, 3), dtype=np.float32)
    for place in _PLACES:
        pixels = grid(camera) + place
        if T_query_ref is not None:
            pixels = seen_at(keyframe.surface, camera, camera, T_query_ref, pixels.reshape(-1, 2)).reshape(pixels.shape)
        total += photograph.at(keyframe.crop.to_photograph(pixels))
    return np.clip(np.rint(total / len(_PLACES)), 0, 255).astype(np.uint8)
