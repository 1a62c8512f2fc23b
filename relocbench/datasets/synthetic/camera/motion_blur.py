"""Motion blur: the mean of the light over the exposure time, from the camera's motion and the depth."""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.geometry import Camera

_LEAST_PX = 0.25
"""blur that is too short to be seen"""
_STEP_PX = 0.8
_MOST_TAPS = 33


def image_velocity(depth: Floats, camera: Camera, twist: Array) -> Floats:
    """Velocity (H, W, 2) of what each pixel shows, in pixels per second, where the scene stands still.

    By Longuet-Higgins and Prazdny (1980): for a camera with velocity v and angular velocity w in its own axes, a point
    at normalised coordinates (x, y) and depth Z moves by
    ``x' = (x vz - vx) / Z + x y wx - (1 + x^2) wy + y wz`` and
    ``y' = (y vz - vy) / Z + (1 + y^2) wx - x y wy - x wz``.

    Args:
        depth: (H, W) metres along z; 0 is infinitely far.
        twist: (6,) v in m/s and w in rad/s.
    """
    height, width = depth.shape
    x = ((np.arange(width) - camera.cx) / camera.fx).astype(np.float32)[None]
    y = ((np.arange(height) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    vx, vy, vz, wx, wy, wz = (np.float32(part) for part in twist)
    nearness = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    u = (x * vz - vx) * nearness + x * y * wx - (1 + x**2) * wy + y * wz
    v = (y * vz - vy) * nearness + (1 + y**2) * wx - x * y * wy - x * wz
    return np.stack([camera.fx * u, camera.fy * v], axis=-1).astype(np.float32)


def blur_along(light: Floats, path: Floats) -> Floats:
    """The mean of the light (H, W, 3) along a line through each pixel.

    The line is centred at the pixel and sampled at the same distances on both sides, so that an edge spreads equally to
    both.

    Args:
        path: (H, W, 2) from one end of the line to the other in pixels.
    """
    longest = float(np.sqrt((path**2).sum(axis=-1).max()))
    if longest < _LEAST_PX:
        return light
    taps = min(2 * round(longest / _STEP_PX / 2) + 3, _MOST_TAPS)
    height, width = light.shape[:2]
    u = np.arange(width, dtype=np.float32)[None]
    v = np.arange(height, dtype=np.float32)[:, None]
    total = np.zeros_like(light)
    for k in range(taps):
        at = np.float32((k + 0.5) / taps - 0.5)
        total += cv2.remap(
            light, u + at * path[..., 0], v + at * path[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return total / np.float32(taps)


def motion_blur(light: Floats, depth: Floats, camera: Camera, twist: Array, exposure_s: float) -> Floats:
    """The light (H, W, 3) as a camera sees it whose shutter is open from half of ``exposure_s`` before to half after.

    An approximation in the image: what a pixel shows moves along a straight line at constant speed, and nothing appears
    from behind something else. Other cars are blurred as if they stood still.
    """
    if exposure_s <= 0:
        return light
    path = image_velocity(depth, camera, twist) * np.float32(exposure_s)
    return blur_along(light, _shorter(path, 0.15 * light.shape[1]))


def _shorter(path: Floats, most_px: float) -> Floats:
    """Paths (H, W, 2) no longer than ``most_px``; those of points almost at the camera have no bound."""
    length = np.sqrt((path**2).sum(axis=-1, keepdims=True))
    return np.asarray(path * np.minimum(1, most_px / np.maximum(length, np.float32(1e-6))), dtype=np.float32)
