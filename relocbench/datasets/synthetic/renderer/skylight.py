"""Sky visibility, precomputed on a coarse grid over the district and on a fine grid close to the ground.

Both grids are fixed in the world, so that the light on a surface does not change as the camera moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from relocbench.arrays import Floats, Mask
from relocbench.datasets.synthetic.town.mesh import Mesh, Semantic
from relocbench.datasets.synthetic.town.raycast import Scene
from relocbench.kernels import njit

_CELL_M = 2.5
_HEIGHTS = np.array([0.3, 1.5, 3.5, 6.5, 10.5, 16.0, 24.0], dtype=np.float32)
_DIRECTIONS = 14
_FAR_M = 80.0
_OFF_WALL_M = 1.6
"""distance in front of a surface at which light is looked up, because grid points inside a house are dark"""
_FINE_M = 0.25
_FINE_DIRECTIONS = 9
_MOVING_DIRECTIONS = 6
_GROUND_M = 0.17
"""just above the pavement"""
_LOW_M = 0.9
"""height below which objects darken the ground"""
_NEAR_M = 1.2
"""farthest distance of what darkens the ground"""
_BLOCKS_AT_ONCE = 4096
"""blocks of four by four points of the fine grid that are processed together, which bounds the memory"""
_TRIANGLES_AT_ONCE = 100_000
_SIDE_M = 600.0
_FAR_GROUND = (Semantic.NONE, Semantic.ROAD, Semantic.PAVEMENT, Semantic.MARKING, Semantic.TERRAIN)


class Skylight(NamedTuple):
    """Visibility of the sky at grid points."""

    low: Floats
    """(2,) x and y of the first point of both grids"""
    shape: tuple[int, int, int]
    """number of points of the coarse grid along height, y and x"""
    points: Floats
    """(height y x, 4): mean visibility of the upper hemisphere, and mean of visibility times direction"""
    heights: Floats
    """(height,) metres"""
    ground: Floats
    """(y, x) share of the light on the ground that is not blocked within 1.2 m"""


def upper_directions(count: int) -> Floats:
    """Unit vectors (count, 3) spread evenly over the upper hemisphere (golden spiral)."""
    k = np.arange(count)
    z = (k + 0.5) / count
    turn = k * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1).astype(np.float32)


def make_skylight(mesh: Mesh, scene: Scene) -> Skylight:
    """Compute the skylight by casting rays from points over the built-up part of the mesh."""
    low, high = np.full(2, np.inf, dtype=np.float32), np.full(2, -np.inf, dtype=np.float32)
    for corners in _corners(mesh, mesh.semantic != Semantic.TERRAIN):
        low = np.minimum(low, corners[..., :2].min((0, 1)))
        high = np.maximum(high, corners[..., :2].max((0, 1)))
    if (low > high).any():
        low = high = np.zeros(2, dtype=np.float32)
    low, high = np.clip(low, -_SIDE_M, _SIDE_M), np.clip(high, -_SIDE_M, _SIDE_M)
    nx, ny = (np.ceil((high - low) / _CELL_M).astype(int) + 2).tolist()
    x, y = low[0] + _CELL_M * np.arange(nx), low[1] + _CELL_M * np.arange(ny)
    directions = upper_directions(_DIRECTIONS)
    values = np.zeros((len(_HEIGHTS), ny * nx, 4), dtype=np.float32)
    for layer, height in zip(values, _HEIGHTS, strict=True):
        points = np.stack(np.meshgrid(x, y, [height]), axis=-1).astype(np.float32).reshape(-1, 3)
        for d in directions:
            seen = _sees(scene, points, d, _FAR_M) / np.float32(_DIRECTIONS)
            layer[:, 0] += seen
            layer[:, 1:] += seen[:, None] * d
    shape = len(_HEIGHTS), ny, nx
    nx, ny = (np.ceil((high - low) / _FINE_M).astype(int) + 2).tolist()
    standing = ~np.isin(mesh.semantic, _FAR_GROUND)
    ground = np.ones((ny, nx), dtype=np.float32)
    _darken(ground, low, mesh, standing, scene, _FINE_DIRECTIONS)
    return Skylight(low.astype(np.float32), shape, values.reshape(-1, 4), _HEIGHTS, ground)


class MovingSkylight:
    """The skylight of a town with the ground darkened under and beside what moves, for one moment after another.

    The small effect on everything else is ignored.
    """

    def __init__(self, light: Skylight) -> None:
        self._still, self._light = light.ground, light._replace(ground=light.ground.copy())
        self._last = np.s_[:0, :0]

    def put(self, mesh: Mesh, scene: Scene) -> Skylight:
        """The skylight with what moves at one moment; it takes the place of the one that was made before."""
        ground = self._light.ground
        ground[self._last] = self._still[self._last]
        if len(mesh):
            # Whole blocks, so that the points in them are those of the whole grid.
            block_m = 4 * _FINE_M
            first = np.floor((mesh.vertices.min(axis=0)[:2] - self._light.low) / block_m).astype(int) - 2
            end = np.ceil((mesh.vertices.max(axis=0)[:2] - self._light.low) / block_m).astype(int) + 2
            (x0, y0), (x1, y1) = 4 * np.maximum(first, 0), 4 * np.maximum(end, 0)
            self._last = np.s_[y0:y1, x0:x1]
            low = self._light.low + np.float32(_FINE_M) * np.array([x0, y0], dtype=np.float32)
            _darken(ground[self._last], low, mesh, np.ones(len(mesh), dtype=np.bool_), scene, _MOVING_DIRECTIONS)
        return self._light


def _darken(ground: Floats, low: Floats, mesh: Mesh, standing: Mask, scene: Scene, count: int) -> None:
    """Lower the values of a grid (y, x) near the low ones of the triangles (T,) to the visibility of the sky there.

    It is weighted by the cosine, over ``count`` directions.
    """
    ny, nx = ground.shape
    near = np.zeros((-(-ny // 4) + 2, -(-nx // 4) + 2), dtype=np.bool_)
    steps = np.linspace(0, 1, 25, dtype=np.float32)[:, None, None]
    for corners in _corners(mesh, standing):
        corners = corners[corners[..., 2].min(1) < _LOW_M][..., :2]
        # Long edges are sampled, so that no cell between their ends is missed.
        long = corners[np.ptp(corners, axis=1).max(1) > 4 * _FINE_M]
        walked = [long[:, i] + steps * (long[:, (i + 1) % 3] - long[:, i]) for i in range(3)]
        points = np.concatenate([corners.reshape(-1, 2), *(w.reshape(-1, 2) for w in walked)])
        cells = np.floor((points - low) / (4 * _FINE_M)).astype(int)
        inside = ((cells >= 0) & (cells < [near.shape[1] - 2, near.shape[0] - 2])).all(1)
        near[cells[inside, 1] + 1, cells[inside, 0] + 1] = True
    grown = near.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            grown |= np.roll(near, (dy, dx), (0, 1))
    directions = upper_directions(count)
    weight = directions[:, 2] / directions[:, 2].sum()
    down, across = np.divmod(np.arange(16), 4)
    rows, columns = np.nonzero(grown[1:-1, 1:-1])
    for first in range(0, len(rows), _BLOCKS_AT_ONCE):
        part = slice(first, first + _BLOCKS_AT_ONCE)
        iy, ix = (4 * rows[part, None] + down).ravel(), (4 * columns[part, None] + across).ravel()
        inside = (iy < ny) & (ix < nx)
        iy, ix = iy[inside], ix[inside]
        rays = np.empty((count, len(ix), 6), dtype=np.float32)
        rays[..., 0], rays[..., 1], rays[..., 2] = low[0] + _FINE_M * ix, low[1] + _FINE_M * iy, _GROUND_M
        rays[..., 3:] = directions[:, None]
        free = ~scene.occluded(rays.reshape(-1, 6), _NEAR_M).reshape(count, -1)
        ground[iy, ix] = np.minimum(ground[iy, ix], np.add.reduce(weight[:, None] * free))


def _corners(mesh: Mesh, chosen: Mask) -> Iterator[Floats]:
    """The corners (M, 3, 3) of the chosen triangles (T,), in chunks."""
    for first in range(0, len(mesh), _TRIANGLES_AT_ONCE):
        part = slice(first, first + _TRIANGLES_AT_ONCE)
        triangles = mesh.triangles[part][chosen[part]]
        if len(triangles):
            yield mesh.vertices[triangles]


def _sees(scene: Scene, points: Floats, direction: Floats, far: float) -> Floats:
    rays = np.concatenate([points, np.broadcast_to(direction, points.shape)], axis=1)
    return 1.0 - scene.occluded(np.ascontiguousarray(rays), far).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def sky_share(light: Skylight, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> tuple[float, float]:
    """Irradiance at a point with a normal under a sky of radiance 1/pi, and the mean visibility of the sky there."""
    points, heights = light.points, light.heights
    layers, rows, columns = light.shape
    gx = (x + _OFF_WALL_M * nx - light.low[0]) * (1 / _CELL_M)
    gy = (y + _OFF_WALL_M * ny - light.low[1]) * (1 / _CELL_M)
    if gx < 0 or gy < 0 or gx >= columns - 1 or gy >= rows - 1:
        return 0.5 + 0.5 * nz, 1.0
    h = z + 0.5 * max(nz, 0.0)
    k = 0
    while k < layers - 2 and heights[k + 1] < h:
        k += 1
    fz = min(max((h - heights[k]) / (heights[k + 1] - heights[k]), 0.0), 1.0)
    ix, iy = int(gx), int(gy)
    fx, fy = gx - ix, gy - iy
    weight, v0, share = 1e-6, 0.3e-6, 0.15e-6 * nz
    for c in range(8):
        a, b, e = c & 1, (c >> 1) & 1, c >> 2
        at = np.uint64(((k + e) * rows + iy + b) * columns + ix + a)
        open_sky = points[at, 0]
        # Points inside a house see no sky and must not count for the street.
        w = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if e else 1 - fz) * min(1.0, 8.0 * open_sky)
        weight += w
        v0 += w * open_sky
        share += w * (points[at, 1] * nx + points[at, 2] * ny + points[at, 3] * nz)
    per_weight = 1.0 / weight
    v0 *= per_weight
    return max(0.5 * v0 + share * per_weight, 0.04), v0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def ground_share(light: Skylight, x: float, y: float) -> float:
    """Share of light on the ground that is not blocked by objects standing on it."""
    ground = light.ground
    rows, columns = ground.shape
    gx, gy = (x - light.low[0]) / _FINE_M, (y - light.low[1]) / _FINE_M
    if gx < 0 or gy < 0 or gx >= columns - 1 or gy >= rows - 1:
        return 1.0
    i, j = int(gx), int(gy)
    a, b = gx - i, gy - j
    upper = ground[j, i] * (1 - a) + ground[j, i + 1] * a
    lower = ground[j + 1, i] * (1 - a) + ground[j + 1, i + 1] * a
    return float(upper * (1 - b) + lower * b)
