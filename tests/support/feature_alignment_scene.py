"""Smooth features on the surfaces of the analytic scene."""

from __future__ import annotations

from functools import cache

import numpy as np
from alignment_scene import CAMERA, motion, render

from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.shared.pyramid import level_camera
from relocbench.arrays import Array, Floats
from relocbench.geometry import Camera, apply, invert
from relocbench.tracking import KeyframePoints

LEVELS = 4
WAVES = 4


def world_points(T_cam_world: Array, camera: Camera) -> Array:
    """What each pixel shows, (H, W, 3)."""
    depth = render(T_cam_world, camera)[1].astype(np.float64)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays, _ = camera.unproject(np.stack([u, v], axis=-1))
    points: Array = apply(invert(T_cam_world), (rays * depth[..., None]).reshape(-1, 3)).reshape(*depth.shape, 3)
    return points


def features(points: Array, level: int, channels: int = 8) -> Floats:
    """D smooth functions of world points (..., 3): sums of seeded waves, twice as long on each coarser level."""
    rng = np.random.default_rng(level)
    lengths = 1.0 * 2.0**level * np.exp(rng.uniform(0, np.log(4), (channels, WAVES)))
    directions = rng.normal(size=(channels, WAVES, 3))
    directions *= (2 * np.pi / lengths / np.linalg.norm(directions, axis=-1))[..., None]
    argument = points @ directions.reshape(-1, 3).T + rng.uniform(0, 2 * np.pi, channels * WAVES)
    waves = np.sin(argument).reshape(*points.shape[:-1], channels, WAVES)
    out: Floats = (waves.sum(axis=-1) / np.sqrt(WAVES)).astype(np.float32)
    return out


def feature_maps(T_cam_world: Array, channels: int = 8, levels: int = LEVELS) -> list[Floats]:
    cameras = [level_camera(CAMERA, level) for level in range(levels)]
    return [features(world_points(T_cam_world, camera), level, channels) for level, camera in enumerate(cameras)]


@cache
def pyramid(motion_of: tuple[float, ...] = (0, 0, 0, 0, 0, 0), channels: int = 8) -> FeaturePyramid:
    """The scene from a pose: translation (m) and rotation (degrees)."""
    T = motion(motion_of[:3], motion_of[3:])  # type: ignore[arg-type]
    return FeaturePyramid.from_maps(feature_maps(T, channels), CAMERA)


@cache
def keyframe_points(count: int = 600) -> KeyframePoints:
    """Random places of the keyframe, between pixels too, with their exact inverse depth."""
    uv = np.random.default_rng(1).uniform(5, [CAMERA.width - 6, CAMERA.height - 6], (count, 2))
    rays = CAMERA.unproject(uv)[0]
    # n . (ray z) = d of the two planes of the scene; the nearer one is seen.
    candidates = np.stack([rays @ n[:3] / n[3] for n in ([0.0, 0.0, 1.0, 9.0], [0.0, 1.0, 0.25, 3.0])])
    return KeyframePoints(uv, candidates.max(axis=0), np.zeros(count))
