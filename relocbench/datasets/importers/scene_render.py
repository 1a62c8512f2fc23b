"""Ray-cast images and exact depth of the street, under a given light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from relocbench.datasets.importers.scene_world import TEXELS, TILE, Texture, World, build_world
from relocbench.geometry import Camera

Array = NDArray[np.float64]

_SUPERSAMPLES = 2
"""rays along each side of a pixel"""
_ROW = 256
"""samples are reshaped to rows of this length: cv2.remap takes images of at most 32767 rows"""


@dataclass(frozen=True)
class Light:
    """What falls on the street, and the camera that records it."""

    sun: tuple[float, float, float]
    """direction towards the sun (y is down)"""
    sun_strength: float
    ambient: float
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    sky: tuple[float, float, float] = (0.6, 0.75, 0.95)
    gain: float = 1.0
    bias: float = 0.0
    """of the full scale"""
    gamma: float = 0.6
    vignetting: float = 0.0
    """loss of light in the image's corners"""
    noise: float = 0.005
    """standard deviation at full scale: shot noise grows with the root of the light"""


def render(seed: int, camera: Camera, T_world_cam: Array, light: Light, rng: np.random.Generator) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of the street of a seed.

    Each pixel is the mean of several rays, each of which takes its texture at the resolution of its own footprint
    (mip mapping), so that nothing shimmers.
    """
    world = build_world(seed)
    directions = _camera_rays(camera, _SUPERSAMPLES) @ T_world_cam[:3, :3].T
    radiance = _radiance(world, seed, T_world_cam[:3, 3], directions, camera.fx * _SUPERSAMPLES, light)
    shape = (camera.height, _SUPERSAMPLES, camera.width, _SUPERSAMPLES, 3)
    return expose(radiance.reshape(shape).mean(axis=(1, 3)), light, rng)


def render_depth(seed: int, camera: Camera, T_world_cam: Array) -> NDArray[np.float32]:
    """(H, W) metres along z through the pixel centres, 0 where there is sky."""
    directions = _camera_rays(camera, 1) @ T_world_cam[:3, :3].T
    hits = _caster(seed).cast_rays(_rays(T_world_cam[:3, 3], directions))
    # Directions have z = 1 in the camera: the ray's parameter is the depth.
    depth = hits["t_hit"].numpy().reshape(camera.height, camera.width)
    return np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)


def expose(radiance: NDArray[np.float32], light: Light, rng: np.random.Generator) -> NDArray[np.uint8]:
    """What the sensor makes of linear light (H, W, 3): vignetting, shot noise, gain, gamma, bias, eight bits."""
    height, width = radiance.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    falling = (1.0 - light.vignetting * (x * x + y * y) / 2)[..., None]
    seen = np.maximum(radiance * falling, 0.0)
    seen = seen + rng.normal(size=seen.shape) * light.noise * np.sqrt(np.maximum(seen, 0.01))
    encoded = np.clip(light.gain * seen, 0.0, 1.0) ** light.gamma + light.bias
    return np.rint(255.0 * np.clip(encoded, 0.0, 1.0)).astype(np.uint8)


@lru_cache(maxsize=2)
def _caster(seed: int) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    for box in build_world(seed).boxes:
        mesh = o3d.t.geometry.TriangleMesh.create_box(*box.size)
        corners = (mesh.vertex.positions.numpy().astype(np.float64) - box.size / 2) @ box.rotation.T + box.centre
        scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(corners, dtype=np.float32)),
            o3d.core.Tensor.from_numpy(mesh.triangle.indices.numpy().astype(np.uint32)),
        )
    return scene


@lru_cache(maxsize=4)
def _camera_rays(camera: Camera, samples: int) -> Array:
    """(N, 3) with z = 1: ``samples`` along each side of every pixel, row by row."""
    offsets = (np.arange(samples) - (samples - 1) / 2) / samples
    u = (np.arange(camera.width)[:, None] + offsets).ravel()
    v = (np.arange(camera.height)[:, None] + offsets).ravel()
    rays, _ = camera.unproject(np.stack(np.meshgrid(u, v), axis=-1))
    return rays.reshape(-1, 3)


def _rays(origins: Array, directions: Array) -> o3d.core.Tensor:
    rays = np.empty((len(directions), 6), dtype=np.float32)
    rays[:, :3], rays[:, 3:] = origins, directions
    return o3d.core.Tensor.from_numpy(rays)


def _radiance(
    world: World, seed: int, centre: Array, directions: Array, focal: float, light: Light
) -> NDArray[np.float32]:
    """(N, 3) linear light along rays; ``focal`` is that of the rays' grid, in rays."""
    caster = _caster(seed)
    hits = caster.cast_rays(_rays(centre, directions))
    depth = hits["t_hit"].numpy().astype(np.float64)
    hit = np.nonzero(np.isfinite(depth))[0]
    normals = hits["primitive_normals"].numpy()[hit].astype(np.float64)
    towards = _dot(normals, directions[hit])
    normals *= np.where(towards > 0, -1.0, 1.0)[:, None]
    points = centre + directions[hit] * depth[hit, None]

    sun = np.array(light.sun) / np.linalg.norm(light.sun)
    lambert = np.maximum(normals @ sun, 0.0)
    lit = np.nonzero(lambert > 0)[0]
    if light.sun_strength > 0:
        start = points[lit] + 2e-3 * normals[lit]
        blocked = caster.test_occlusions(_rays(start, np.broadcast_to(sun, start.shape))).numpy()
        lambert[lit[blocked]] = 0.0
    # Of the sky a surface that looks up sees most (y is down), and little close to the ground.
    sky_light = light.ambient * (0.75 - 0.25 * normals[:, 1]) * (1.0 - 0.35 * np.exp(points[:, 1] / 0.6))
    length = np.sqrt(_dot(directions, directions))
    cosine = np.abs(towards) / length[hit]
    footprint = depth[hit] / focal / np.sqrt(np.maximum(cosine, 0.05))
    albedo = _albedo(world, hits["geometry_ids"].numpy()[hit].astype(int), points, normals, footprint)
    shade = (sky_light + light.sun_strength * lambert)[:, None] * np.array(light.colour)
    out = np.empty((len(directions), 3), dtype=np.float32)
    up = np.clip(-directions[:, 1] / length, 0, 1)[:, None]
    out[:] = np.array(light.sky) * (1.0 - 0.35 * up)
    out[hit] = albedo * shade
    return out


def _dot(a: Array, b: Array) -> Array:
    """(N,) products of rows."""
    return np.asarray(np.einsum("ni,ni->n", a, b))


def _albedo(world: World, box: NDArray[np.int64], points: Array, normals: Array, footprint: Array) -> Array:
    """(N, 3) of points on boxes; the texture lies on each face along the box's own axes."""
    centre, rotation, material, tint, offset = _box_table(world)
    local = np.einsum("nji,nj->ni", rotation[box], points - centre[box])
    axis = np.argmax(np.abs(np.einsum("nji,nj->ni", rotation[box], normals)), axis=1)
    # Faces across x show (z, y), across y (x, z), across z (x, y).
    across = np.where(axis == 0, local[:, 2], local[:, 0]) + offset[box, 0]
    along = np.where(axis == 1, local[:, 2], local[:, 1]) + offset[box, 1]
    level = np.clip(np.log2(np.maximum(footprint * TEXELS / TILE, 1.0)), 0, len(world.textures[0]) - 1.001)
    out = np.empty((len(points), 3))
    finer = np.floor(level).astype(int)
    for m, textures in enumerate(world.textures):
        of_material = np.nonzero(material[box] == m)[0]
        for fine in np.unique(finer[of_material]):
            rows = of_material[finer[of_material] == fine]
            weight = (level[rows] - fine)[:, None]
            a = _sample(textures[fine], across[rows], along[rows])
            b = _sample(textures[fine + 1], across[rows], along[rows])
            out[rows] = (1 - weight) * a + weight * b
    return out * tint[box]


def _sample(texture: Texture, across: Array, along: Array) -> Array:
    """(N, 3) of a tileable texture, bilinear, at metres."""
    side = texture.shape[0]
    x, y = ((np.mod(c / TILE, 1.0) * side - 0.5) for c in (across, along))
    count = len(x)
    padding = -count % _ROW
    grid_x, grid_y = (np.pad(c, (0, padding)).astype(np.float32).reshape(-1, _ROW) for c in (x, y))
    taken = np.asarray(cv2.remap(texture, grid_x, grid_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
    return np.asarray(taken.reshape(-1, 3)[:count], dtype=np.float64)


def _box_table(world: World) -> tuple[Array, Array, NDArray[np.int64], Array, Array]:
    boxes = world.boxes
    return (
        np.array([b.centre for b in boxes]),
        np.array([b.rotation for b in boxes]),
        np.array([b.material for b in boxes]),
        np.array([b.tint for b in boxes]),
        np.array([b.offset for b in boxes]),
    )
