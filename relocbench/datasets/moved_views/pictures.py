"""Keyframes and queries made of photographs: each pixel is the mean of four places, found exactly.

Both are made alike, so that a query that has not moved is the keyframe, but for rounding. Photographs of much higher
resolution are first reduced to two pixels for each of a view's. Pixels that show nothing of them are black.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.moved_views.drawing import Keyframe, View, grid
from relocbench.datasets.moved_views.faces import Face, located
from relocbench.datasets.moved_views.surfaces import points_seen
from relocbench.datasets.moved_views.weather import Sight
from relocbench.geometry import invert

_OVERSAMPLED = 2.0
"""pixels of the reduced photograph along each side of one of a view"""
_PLACES = [(u, v) for v in (-0.25, 0.25) for u in (-0.25, 0.25)]
"""of the four samples of a pixel"""


@dataclass(frozen=True, eq=False)
class Reduced:
    """Photographs at a resolution that suits a view."""

    faces: tuple[Face, ...]
    """as they were before"""
    images: tuple[Floats, ...]
    """(H, W, 3) float32 of each face"""

    @classmethod
    def of(cls, faces: tuple[Face, ...], photographs: Sequence[Image], focal_px: float) -> Reduced:
        """Reduce the photograph (H, W, 3) of each face for views of this focal length."""
        return cls(faces, tuple(_reduced(*both, focal_px) for both in zip(faces, photographs, strict=True)))

    def at(self, directions: Array) -> tuple[Floats, Array]:
        """Values (H, W, 3) in directions (H, W, 3), between pixels by cubic interpolation, and whether there is one."""
        number, pixels = located(self.faces, directions)
        values = np.zeros(directions.shape, dtype=np.float32)
        for k, image in enumerate(self.images):
            shown = number == k
            if not shown.any():
                continue
            ratio = np.array(image.shape[1::-1]) / self.faces[k].camera.size
            at = np.where(shown[..., None], (pixels + 0.5) * ratio - 0.5, 0.0).astype(np.float32)
            u, v = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
            values[shown] = cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)[shown]
        return values, (number >= 0)[..., None].astype(np.float64)


def _reduced(face: Face, photograph: Image, focal_px: float) -> Floats:
    wanted = min(_OVERSAMPLED * focal_px / face.camera.fx, 1.0)
    size = round(face.camera.width * wanted), round(face.camera.height * wanted)
    small = photograph if wanted == 1.0 else cv2.resize(photograph, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def view_of(photographs: Reduced, keyframe: Keyframe, view: View | None = None) -> Image:
    """What the camera of a view sees (H, W, 3), or that of the keyframe without one."""
    camera = view.camera if view else keyframe.camera
    total = np.zeros((camera.height, camera.width, 3), dtype=np.float32)
    count = np.zeros((camera.height, camera.width, 1))
    for place in _PLACES:
        pixels = grid(camera) + place
        if view is None:
            directions, _ = camera.unproject(pixels)
        else:
            directions = points_seen(keyframe.surface, camera, view.T_query_ref, pixels)
        values, shown = photographs.at(directions)
        total += values
        count += shown
    return np.clip(np.rint(total / np.maximum(count, 1)), 0, 255).astype(np.uint8)


def sight_of(keyframe: Keyframe, view: View) -> Sight:
    """What a view sees of the keyframe's surface, and how it stands to the horizon."""
    points = points_seen(keyframe.surface, view.camera, view.T_query_ref, grid(view.camera))
    return Sight((points - invert(view.T_query_ref)[:3, 3]) @ keyframe.faces[0].R_face_ref.T, view.camera.fx)
