"""The planes of a submap that ICP uses: thinned coarse to fine, indexed by voxel, and sampled evenly by direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.blocks import Block, Surface
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, make_grid, pack
from relocbench.kernels import njit

_BINS = 6
"""normals are binned on an octahedral map of so many by so many cells"""


@dataclass(frozen=True)
class PlaneOptions:
    """Options that decide which points are used as planes, and with what weight."""

    structure: float = 1.0
    """weight of structure: facades and other planes that are not ground"""
    ground: float = 0.3
    """weight of the road, which snow and leaves may cover"""
    rough: float = 0.1
    """weight of other points, such as leaves and edges, where a plane fits at all"""
    steady: float = 0.5
    """points with a lower static score are left out"""
    thinning_m: tuple[float, ...] = (0.4, 0.2, 0.0)
    """voxel size for thinning, level by level; 0 keeps all points"""
    reach_m: tuple[float, ...] = (1.0, 0.5, 0.3)
    """largest distance between a point and its plane, level by level"""
    samples: tuple[int, ...] = (3000, 5000, 9000)
    """number of points, level by level, that are matched to planes of the other submap"""
    near_m: tuple[float, ...] = (1e9, 20.0, 8.0)
    """lever arm at which points are sampled half as often, level by level, since odometry is best near the node"""


@dataclass(frozen=True, eq=False)
class Sample:
    """Points of a submap, with normals, that are matched to planes of another."""

    points: Array
    """(N, 3) in the node's frame"""
    normals: Array
    """(N, 3) unit vectors towards the sensor"""
    weights: Array
    """(N,) weights by surface and static score"""
    lever_arms: Array
    """(N, 3) from the node to the sensor when it measured each point, by the odometry, whose drift grows with it"""

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def lever_lengths_m(self) -> Array:
        """(N,) lengths of the lever arms, metres"""
        return np.asarray(np.linalg.norm(self.lever_arms, axis=1))

    def rescaled(self, scale_error: float) -> Self:
        """The points as they would lie if the odometry's scale were larger by a factor of ``1 + scale_error``."""
        return replace(self, points=self.points + scale_error * self.lever_arms) if scale_error else self


@dataclass(frozen=True, eq=False)
class Planes(Sample):
    """Points with normals that stand for planes, sorted by voxel for fast search."""

    grid: Grid
    """of these points, which are in the grid's order"""

    def rescaled(self, scale_error: float) -> Planes:
        """The planes as they would lie, sorted anew."""
        if not scale_error:
            return self
        points = self.points + scale_error * self.lever_arms
        return grid_planes(points, self.normals, self.weights, self.lever_arms, self.grid.size_m)

    def check_reach(self, reach_m: float) -> None:
        """Raise ValueError if planes so far away could be missed."""
        if reach_m > self.grid.size_m * (1 + 1e-9):
            raise ValueError(f"a grid of {self.grid.size_m} m cells cannot be searched to a distance of {reach_m} m")

    def nearest(self, points: Array, normals: Array, reach_m: float, cosine: float = 0.7) -> Indices:
        """(M,) row of the plane nearest to each point and facing the same way, -1 where there is none.

        Args:
            points: (M, 3) in this submap's frame.
            normals: (M, 3) of the points; 0 matches any direction.
            reach_m: largest distance, at most the voxel size of the grid.
            cosine: cosine of the largest angle between the normals.
        """
        self.check_reach(reach_m)
        return np.asarray(_nearest(points, normals, self.points, self.normals, self.grid, reach_m, cosine))


class PlaneMap:
    """The planes of a submap or block at several levels, coarse to fine, each computed once."""

    def __init__(self, submap: Block, options: PlaneOptions | None = None) -> None:
        self.submap = submap
        self.options = options or PlaneOptions()
        by_surface = np.zeros(256)
        by_surface[[Surface.STRUCTURE, Surface.GROUND, Surface.ROUGH]] = (
            self.options.structure,
            self.options.ground,
            self.options.rough,
        )
        weights = by_surface[submap.surface] * submap.steady
        flat = np.einsum("ni,ni->n", submap.normals, submap.normals) > 0.5
        used = flat & (submap.steady >= self.options.steady) & (weights > 0)
        self.points = submap.points[used].astype(np.float64)
        self.normals = submap.normals[used].astype(np.float64)
        self._weights = weights[used].astype(np.float64)
        self._lever_arms = submap.origins[used].astype(np.float64)
        self._levels: dict[int, Planes] = {}
        self._samples: dict[int, Sample] = {}

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def _squared_lever_lengths(self) -> Array:
        return np.asarray(np.einsum("ni,ni->n", self._lever_arms, self._lever_arms))

    @cached_property
    def _bins(self) -> Indices:
        return direction_bins(self.normals)

    def level(self, k: int) -> Planes:
        """The planes of a level; 0 is the coarsest."""
        if k not in self._levels:
            keep = first_in_voxels(self.points, self.options.thinning_m[k])
            self._levels[k] = grid_planes(
                self.points[keep],
                self.normals[keep],
                self._weights[keep],
                self._lever_arms[keep],
                self.options.reach_m[k],
            )
        return self._levels[k]

    def sample(self, k: int) -> Sample:
        """The points of a level that are matched to planes: about as many for each direction of the normal.

        Most points lie on facades along the street, but only the few that face along the street constrain the position
        along it (Rusinkiewicz and Levoy, Efficient variants of the ICP algorithm, 3DIM 2001).
        """
        if k not in self._samples:
            often = 1 / (1 + self._squared_lever_lengths / self.options.near_m[k] ** 2)
            keep = balanced(self._bins, self.options.samples[k], often)
            self._samples[k] = Sample(
                self.points[keep], self.normals[keep], self._weights[keep], self._lever_arms[keep]
            )
        return self._samples[k]


def grid_planes(points: Array, normals: Array, weights: Array, lever_arms: Array, cell_m: float) -> Planes:
    """Planes of points (N, 3) with unit normals (N, 3), weights (N,) and lever arms (N, 3), sorted by voxel."""
    grid = make_grid(points, cell_m)
    order = grid.order
    return Planes(points[order], normals[order], weights[order], lever_arms[order], grid)


@njit(cache=True, nogil=True, error_model="numpy")
def direction_bins(normals: Array) -> Indices:
    """(N,) bins of unit vectors (N, 3) on an octahedral map (Meyer et al., On floating-point normal vectors, 2010)."""
    bins = np.empty(len(normals), dtype=np.int64)
    for i in range(len(normals)):
        length = max(abs(normals[i, 0]) + abs(normals[i, 1]) + abs(normals[i, 2]), 1e-12)
        x, y = normals[i, 0] / length, normals[i, 1] / length
        if normals[i, 2] < 0:
            x, y = (1 - abs(y)) * (-1.0 if x < 0 else 1.0), (1 - abs(x)) * (-1.0 if y < 0 else 1.0)
        u = min(max(int((x + 1) / 2 * _BINS), 0), _BINS - 1)
        v = min(max(int((y + 1) / 2 * _BINS), 0), _BINS - 1)
        bins[i] = u * _BINS + v
    return bins


def balanced(bins: Indices, count: int, often: Array) -> Indices:
    """(M,) rows drawn without replacement: at most ``count``, as evenly over the bins (N,) as these allow.

    Args:
        often: (N,) weights of the rows within their bins (Efraimidis and Spirakis, Weighted random sampling with a
            reservoir, 2006). The draw is the same every time.
    """
    if len(bins) <= count:
        return np.arange(len(bins))
    sizes = np.bincount(bins)
    occupied = np.sort(sizes[sizes > 0])
    share, left = 0.0, float(count)
    for k, size in enumerate(occupied):
        share = left / (len(occupied) - k)
        if size > share:
            break
        left -= float(size)
    wait = np.random.default_rng(0).exponential(size=len(bins)) / often
    chosen = []
    order, ends = np.argsort(bins.astype(np.uint8), kind="stable"), np.cumsum(sizes)
    for size, end in zip(sizes.tolist(), ends.tolist(), strict=True):
        own = order[end - size : end]
        chosen.append(own[np.argpartition(wait[own], int(share))[: int(share)]] if size > share else own)
    return np.sort(np.concatenate(chosen))


@njit(cache=True, nogil=True, error_model="numpy")
def wrenches(directions: Array, points: Array) -> Array:
    """(N, 6) derivative ``(m, q x m)`` of ``m^T se3_exp(xi) q`` by xi = (rho, phi), for directions m and points q."""
    out = np.empty((len(points), 6))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a, b, c = directions[i, 0], directions[i, 1], directions[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = a, b, c
        out[i, 3], out[i, 4], out[i, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(
    points: Array, normals: Array, planes: Array, facing: Array, grid: Grid, reach: float, cosine: float
) -> Indices:  # pragma: no cover - compiled
    nearest = np.empty(len(points), dtype=np.int64)
    for i in range(len(points)):
        nearest[i] = nearest_plane(points[i], normals[i], planes, facing, grid, reach, cosine)
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_plane(
    point: Array, normal: Array, planes: Array, facing: Array, grid: Grid, reach: float, cosine: float
) -> int:  # pragma: no cover - compiled
    """The row that :meth:`Planes.nearest` finds for one point (3,) with a normal (3,)."""
    cell = grid.size_m
    x, y, z = point[0], point[1], point[2]
    a, b, c = normal[0], normal[1], normal[2]
    free = a * a + b * b + c * c < 0.25
    cx, cy, cz = int(np.floor(x / cell)), int(np.floor(y / cell)), int(np.floor(z / cell))
    lx, ly, lz = x - cx * cell, y - cy * cell, z - cz * cell
    found, best = -1, reach * reach
    # The point's own cell comes first; a cell that is further away than the best plane so far is not looked at.
    for ix in range(3):
        dx = ix if ix < 2 else -1
        gx = 0.0 if ix == 0 else (cell - lx if ix == 1 else lx)
        if gx * gx > best:
            continue
        for iy in range(3):
            dy = iy if iy < 2 else -1
            gy = 0.0 if iy == 0 else (cell - ly if iy == 1 else ly)
            if gx * gx + gy * gy > best:
                continue
            for iz in range(3):
                dz = iz if iz < 2 else -1
                gz = 0.0 if iz == 0 else (cell - lz if iz == 1 else lz)
                if gx * gx + gy * gy + gz * gz > best:
                    continue
                row = cell_of(pack(cx + dx, cy + dy, cz + dz), grid.keys, grid.cells)
                if row < 0:
                    continue
                for j in range(grid.starts[row], grid.starts[row + 1]):
                    ex, ey, ez = planes[j, 0] - x, planes[j, 1] - y, planes[j, 2] - z
                    squared = ex * ex + ey * ey + ez * ez
                    if squared < best and (free or a * facing[j, 0] + b * facing[j, 1] + c * facing[j, 2] >= cosine):
                        found, best = j, squared
    return found
