"""A street of a few boxes to record in, importable by worker processes."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.geometry import Camera


def quads(corners: Array, material: Material, instance: int = 0) -> Mesh:
    """Mesh of quadrilaterals (N, 4, 3)."""
    n = len(corners)
    rows = np.arange(n)[:, None] * 4
    triangles = np.concatenate([rows + np.array([0, 1, 2]), rows + np.array([0, 2, 3])]).astype(np.uint32)
    t = 2 * n
    return Mesh(
        corners.reshape(-1, 3).astype(np.float32),
        triangles,
        np.zeros((t, 3, 2), np.float32),
        np.full(t, material, np.uint8),
        np.full(t, Semantic.BUILDING, np.uint8),
        np.full(t, instance, np.uint32),
        np.zeros(t, np.uint32),
        np.zeros(t, np.float32),
    )


def box(low: Sequence[float], high: Sequence[float], material: Material, instance: int = 0) -> Mesh:
    """The six faces of a box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    faces = [
        [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)],
        [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
        [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
        [(x0, y1, z0), (x1, y1, z0), (x1, y1, z1), (x0, y1, z1)],
        [(x0, y0, z0), (x0, y1, z0), (x0, y1, z1), (x0, y0, z1)],
        [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
    ]
    return quads(np.array(faces, dtype=np.float64), material, instance)


@dataclass(frozen=True, eq=False)
class Street:
    """Ground, and houses of different depth on both sides of a road along x."""

    seed: int = 4

    @property
    def lamps(self) -> Array:
        return np.zeros((0, 3))


def street_mesh(street: Street, factors: Factors) -> Mesh:
    rng = np.random.default_rng(street.seed)
    ground = np.array([[(-60, -60, 0), (240, -60, 0), (240, 60, 0), (-60, 60, 0)]], dtype=np.float64)
    parts = [quads(ground, Material.ASPHALT)]
    for k, x in enumerate(np.arange(-40.0, 220.0, 6.0)):
        near, height = rng.uniform(6.0, 9.0, size=2), rng.uniform(4.0, 9.0, size=2)
        parts.append(box((x, near[0], 0), (x + 6, 20, height[0]), Material.BRICK, 1 + 2 * k))
        parts.append(box((x, -20, 0), (x + 6, -near[1], height[1]), Material.PLASTER, 2 + 2 * k))
    return merge(parts)


@dataclass(frozen=True)
class StraightRoad:
    """A route along x."""

    length: float = 200.0
    other_lane_m: float = 3.2

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
        pose[:2, 3] = s - 40.0, lateral_m
        return pose


class SolidTexture:
    """Renders what a ray meets as a smooth pattern in space, so that stereo finds the same pattern in both images."""

    def __init__(self, mesh: Mesh, factors: Factors, lamps: Array, seed: int) -> None:
        self._mesh = mesh
        self._scene = LidarScene(mesh)
        rng = np.random.default_rng(seed)
        self._waves = rng.normal(size=(3, 24)) * 3.0
        phases = rng.uniform(0, 2 * np.pi, size=(3, 24))
        # sin(a + b) = sin(a) cos(b) + cos(a) sin(b): one sine and one cosine of a wave serve all three channels.
        self._mixing = np.concatenate([np.cos(phases), np.sin(phases)], axis=1).T.astype(np.float32)

    def with_moving(self, mesh: Mesh) -> SolidTexture:
        other = copy(self)
        other._scene = LidarScene(merge([self._mesh, mesh]))
        return other

    def render(self, camera: Camera, T_world_cam: Array, frame_seed: int, /) -> SimpleNamespace:
        v, u = np.mgrid[: camera.height, : camera.width]
        rays, _ = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float64))
        directions = rays @ T_world_cam[:3, :3].T
        origins = np.broadcast_to(T_world_cam[:3, 3], directions.shape)
        z = self._scene.hits(origins, directions).range
        met = np.isfinite(z)
        points = origins + np.where(met, z, 0.0)[:, None] * directions
        phase = (points @ self._waves).astype(np.float32)
        grey = 127 + 18 * (np.concatenate([np.sin(phase), np.cos(phase)], axis=1) @ self._mixing)
        grey[~met] = 200
        noise = np.random.default_rng(frame_seed).normal(size=grey.shape)
        rgb = np.clip(grey + noise, 0, 255).astype(np.uint8).reshape(camera.height, camera.width, 3)
        return SimpleNamespace(rgb=rgb, depth=np.where(met, z, 0).reshape(camera.height, camera.width))
