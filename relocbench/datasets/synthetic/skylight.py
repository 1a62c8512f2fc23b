"""How much of the sky is seen from where: visibility on a coarse grid of the district, for light from all sides."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from relocbench.datasets.synthetic.mesh import Mesh, Semantic
from relocbench.datasets.synthetic.raycast import Scene

Floats = NDArray[np.float32]
_CELL_M = 2.5
_HEIGHTS = np.array([0.3, 1.5, 3.5, 6.5, 10.5, 16.0, 24.0], dtype=np.float32)
_DIRECTIONS = 14
_FAR_M = 80.0
_OFF_WALL_M = 1.6
"""light is looked up this far in front of a surface: behind it lies the dark inside of a house"""


class Skylight(NamedTuple):
    """Share of the sky seen and where it lies, at grid points."""

    low: Floats
    """(2,) x and y of the first point"""
    grid: Floats
    """(height, y, x, 4): mean visibility of the upper half, then mean of visibility times direction"""
    heights: Floats
    """(height,) metres"""


def upper_directions(count: int) -> Floats:
    """(count, 3) unit vectors spread evenly over the upper half sphere (golden spiral)."""
    k = np.arange(count)
    z = (k + 0.5) / count
    turn = k * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1).astype(np.float32)


def make_skylight(mesh: Mesh, scene: Scene) -> Skylight:
    """Cast rays to the sky from points all over the part of the mesh where anything is built."""
    built = mesh.vertices[mesh.triangles[mesh.semantic != Semantic.TERRAIN].ravel()]
    if len(built) == 0:
        built = np.zeros((1, 3), dtype=np.float32)
    low, high = np.clip(built[:, :2].min(0), -600, 600), np.clip(built[:, :2].max(0), -600, 600)
    nx, ny = (np.ceil((high - low) / _CELL_M).astype(int) + 2).tolist()
    x, y = low[0] + _CELL_M * np.arange(nx), low[1] + _CELL_M * np.arange(ny)
    points = np.stack(np.meshgrid(_HEIGHTS, y, x, indexing="ij")[::-1], axis=-1).astype(np.float32).reshape(-1, 3)
    directions = upper_directions(_DIRECTIONS)
    seen = np.stack([_sees(scene, points, d) for d in directions], axis=1)
    values = np.concatenate([seen.mean(1, keepdims=True), seen @ directions / _DIRECTIONS], axis=1)
    return Skylight(low.astype(np.float32), values.astype(np.float32).reshape(len(_HEIGHTS), ny, nx, 4), _HEIGHTS)


def _sees(scene: Scene, points: Floats, direction: Floats) -> Floats:
    rays = np.concatenate([points, np.broadcast_to(direction, points.shape)], axis=1)
    return 1.0 - scene.occluded(np.ascontiguousarray(rays), _FAR_M).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def sky_share(light: Skylight, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> tuple[float, float]:
    """Irradiance by a sky of radiance 1/pi at a point with a normal, and the mean visibility there."""
    layers, rows, columns, _ = light.grid.shape
    gx = (x + _OFF_WALL_M * nx - light.low[0]) / _CELL_M
    gy = (y + _OFF_WALL_M * ny - light.low[1]) / _CELL_M
    if gx < 0 or gy < 0 or gx >= columns - 1 or gy >= rows - 1:
        return 0.5 + 0.5 * nz, 1.0
    h = z + 0.5 * max(nz, 0.0)
    k = 0
    while k < layers - 2 and light.heights[k + 1] < h:
        k += 1
    fz = min(max((h - light.heights[k]) / (light.heights[k + 1] - light.heights[k]), 0.0), 1.0)
    ix, iy = int(gx), int(gy)
    fx, fy = gx - ix, gy - iy
    weight, v0, vx, vy, vz = 1e-6, 0.3e-6, 0.0, 0.0, 0.15e-6
    for c in range(8):
        a, b, e = c & 1, (c >> 1) & 1, c >> 2
        at = light.grid[k + e, iy + b, ix + a]
        # A point inside a house sees nothing: it says nothing about the street either.
        w = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if e else 1 - fz) * min(1.0, 8.0 * at[0])
        weight += w
        v0 += w * at[0]
        vx += w * at[1]
        vy += w * at[2]
        vz += w * at[3]
    v0 /= weight
    share = 0.5 * v0 + (vx * nx + vy * ny + vz * nz) / weight
    return max(share, 0.04), v0
