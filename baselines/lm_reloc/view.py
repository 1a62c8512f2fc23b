"""Images as a camera of one fixed focal length sees them, whatever camera took them.

A network that regresses a pose learns how many pixels a metre or a degree is, which depends on the focal length. Images
are therefore resampled to those of one pinhole camera, the network's own, at the same place. A camera that sees less
leaves a part of its image empty, which the network is told; one that sees more is cut. A turn of the network's camera
against the real one is exact too, since it moves pixels alike at all depths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image, Mask
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

_EMPTY = 115
"""grey level of what the camera does not see, about the mean of street images"""
_LEAST_SEEN = 0.5
"""share of a place that the camera must see"""


@dataclass(frozen=True, eq=False)
class View:
    """What the network's camera sees."""

    image: Image
    """(S, S, 3)"""
    seen: Mask
    """(S, S) pixels that lie on the image it was made from"""


def network_camera(side: int, focal: float) -> Camera:
    """The network's camera: square images with the principal point in the middle."""
    return Camera("pinhole", side, side, focal, focal, (side - 1) / 2, (side - 1) / 2)


def view_of(image: Image, camera: Camera, seen_by: Camera, R_seen_camera: Array | None = None) -> View:
    """Resample an image to that of another camera at the same place.

    The image is first brought to about the other's focal length by averaging pixels, so that nothing aliases.

    Args:
        image: (H, W) grey or (H, W, 3) RGB.
        camera: that took it, of any model.
        seen_by: the other camera.
        R_seen_camera: (3, 3) its rotation against the first; by default none.
    """
    small, taken_by = _shrunk(image, camera, seen_by)
    v, u = np.mgrid[: seen_by.height, : seen_by.width]
    rays, _ = seen_by.unproject(np.stack([u, v], axis=-1).astype(np.float64))
    pixels, valid = taken_by.project(rays if R_seen_camera is None else rays @ R_seen_camera)
    pixels = np.where(valid[..., None], pixels, -10.0)
    # Half a pixel beyond the outermost centres is still on the image.
    seen = valid & taken_by.contains(pixels, border=-0.5)
    at = np.clip(pixels, 0.0, np.array(taken_by.size) - 1.0).astype(np.float32)
    warped = cv2.remap(small, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    colour = warped if warped.ndim == 3 else np.repeat(warped[..., None], 3, axis=-1)
    return View(np.where(seen[..., None], colour, np.uint8(_EMPTY)), seen)


def seen_places(seen: Mask, places: int) -> Mask:
    """Which of ``places`` x ``places`` equal parts of a view are mostly seen; (places, places)."""
    return np.asarray(_parts(seen.astype(np.float32), places).mean(axis=(1, 3)) >= _LEAST_SEEN)


def inverse_depth_of_places(
    points: KeyframePoints, camera: Camera, seen_by: Camera, places: int, R_seen_camera: Array | None = None
) -> Floats:
    """The mean inverse depth in each of ``places`` x ``places`` equal parts of a view.

    Args:
        points: pixels of the first camera with inverse depth.
        camera, seen_by, R_seen_camera: as in :func:`view_of`.
        places: parts along each side.

    Returns:
        (2, places, places): the inverse depth in 1/m along the axis of ``seen_by``, 0 where unknown; and 1 where known.
    """
    out = np.zeros((2, places, places), dtype=np.float32)
    rays, valid = camera.unproject(points.uv)
    known = valid & (points.inverse_depth > 0) & np.isfinite(points.inverse_depth)
    rays, inverse_depth = rays[known], points.inverse_depth[known]
    rays = rays if R_seen_camera is None else rays @ R_seen_camera.T
    pixels, valid = seen_by.project(rays)
    valid &= seen_by.contains(pixels, border=-0.5)
    if not valid.any():
        return out
    inverse_depth = inverse_depth[valid] / rays[valid, 2]
    at = ((pixels[valid] + 0.5) * places / np.array(seen_by.size)).astype(np.intp).clip(0, places - 1)
    of_part = at[:, 1] * places + at[:, 0]
    count = np.bincount(of_part, minlength=places * places)
    total = np.bincount(of_part, weights=inverse_depth, minlength=places * places)
    out[0] = (total / np.maximum(count, 1)).reshape(places, places)
    out[1] = (count > 0).reshape(places, places)
    return out


def _shrunk(image: Image, camera: Camera, seen_by: Camera) -> tuple[Image, Camera]:
    """The image averaged to about the focal length of another camera, unless it is shorter, and its camera."""
    width = min(max(round(camera.width * seen_by.fx / camera.fx), 1), camera.width)
    height = min(max(round(camera.height * seen_by.fy / camera.fy), 1), camera.height)
    if (width, height) == camera.size:
        return np.ascontiguousarray(image), camera
    sx, sy = width / camera.width, height / camera.height
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    of_small = replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=(camera.cx + 0.5) * sx - 0.5,
        cy=(camera.cy + 0.5) * sy - 0.5,
    )
    return np.asarray(small, dtype=np.uint8), of_small


def _parts(values: Floats, places: int) -> Floats:
    """(places, S / places, places, S / places) of (S, S)."""
    part = values.shape[0] // places
    return values.reshape(places, part, places, part)
