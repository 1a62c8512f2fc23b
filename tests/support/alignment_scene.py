"""An analytic scene for the alignment tests."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.geometry import Camera, invert, make_transform, so3_exp

CAMERA = Camera("pinhole", 320, 256, 260.0, 270.0, 158.0, 128.5)
PLANES = (np.array([0.0, 0.0, 1.0, 9.0]), np.array([0.0, 1.0, 0.25, 3.0]))  # n . X = d: a wall and a slanted floor


def texture(points: Array) -> Array:
    """Smooth grey levels of points (..., 3), continuous across the crease: there is no edge to alias."""
    rng = np.random.default_rng(0)
    value = np.zeros(points.shape[:-1])
    for wavelength in (0.9, 1.0, 1.2, 1.5, 2.0, 2.7, 3.6, 4.8):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        value += np.sin(2 * np.pi / wavelength * (points @ direction) + rng.uniform(0, 2 * np.pi)) * wavelength**0.5
    return 128 + 15 * value  # no wave is shorter than five pixels: bilinear look-up stays honest


def render(T_cam_world: Array, camera: Camera = CAMERA) -> tuple[Array, Floats]:
    """Grey levels (H, W) and depth (H, W) of the scene."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays, _ = camera.unproject(np.stack([u, v], axis=-1))
    T_world_cam = invert(T_cam_world)
    directions, origin = rays @ T_world_cam[:3, :3].T, T_world_cam[:3, 3]
    with np.errstate(divide="ignore"):
        distances = [(p[3] - origin @ p[:3]) / (directions @ p[:3]) for p in PLANES]
    distances = [np.where(d > 0, d, np.inf) for d in distances]
    depth = np.minimum(*distances)
    points = origin + directions * depth[..., None]
    return texture(points), depth.astype(np.float32)


def to_image(grey: Array, gain: float = 1.0, offset: float = 0.0) -> Image:
    return np.clip(np.rint(gain * grey + offset), 0, 255).astype(np.uint8)


def motion(translation: tuple[float, float, float], rotation_deg: tuple[float, float, float]) -> Array:
    return make_transform(so3_exp(np.deg2rad(rotation_deg)), np.array(translation))
