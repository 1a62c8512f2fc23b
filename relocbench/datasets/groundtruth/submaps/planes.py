"""Planes of a submap for registration: thinned coarse to fine, found in a sparse grid, sampled by direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, make_grid, pack, voxel_keys
from relocbench.errors import ConfigError
from relocbench.kernels import njit

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_BINS = 6
"""directions are told apart on an octahedral map of so many by so many"""


@dataclass(frozen=True)
class PlaneOptions:
    """How much each point counts, and how many do."""

    structure: float = 1.0
    """weight of facades and whatever else stands upright"""
    ground: float = 0.3
    """weight of the road: snow and leaves lie on it"""
    rough: float = 0.1
    """weight of leaves and edges, where a plane fits at all"""
    steady: float = 0.5
    """points less steady than this are left out"""
    thinning_m: tuple[float, ...] = (0.4, 0.2, 0.0)
    """one point a voxel of this size, level by level; 0 keeps all"""
    reach_m: tuple[float, ...] = (1.0, 0.5, 0.3)
    """cell of the grid, level by level: no plane is found further away than this"""
    samples: tuple[int, ...] = (3000, 5000, 9000)
    """points, level by level, that look for a plane on the other side"""
    near_m: tuple[float, ...] = (1e9, 20.0, 8.0)
    """points measured so far from the node are sampled half as often, level by level: odometry is best close by"""

    def __post_init__(self) -> None:
        if not len(self.thinning_m) == len(self.reach_m) == len(self.samples) == len(self.near_m) > 0:
            raise ConfigError("thinning_m, reach_m, samples and near_m of planes need one value a level each")
        if min(self.reach_m + self.near_m) <= 0 or min(self.samples) < 6 or min(self.thinning_m) < 0:
            raise ConfigError("planes need a positive reach and at least 6 samples on each level")


@dataclass(frozen=True, eq=False)
class Planes:
    """Oriented points that stand for planes, sorted by cell so that near ones are found fast."""

    points: Array
    """(N, 3) in the node's frame"""
    normals: Array
    """(N, 3) unit, towards the sensor"""
    weights: Array
    """(N,) by surface and steadiness"""
    lever_arms: Array
    """(N, 3) from the node to where the sensor was, as odometry tells: it drifts on that way"""
    grid: Grid
    """of these points, which are in its order"""

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def lever_lengths_m(self) -> Array:
        """(N,)"""
        return np.asarray(np.linalg.norm(self.lever_arms, axis=1))

    def stretched(self, stretch: float) -> Planes:
        """The planes where they would lie had odometry told every way longer by this share."""
        if not stretch:
            return self
        points = self.points + stretch * self.lever_arms
        return grid_planes(points, self.normals, self.weights, self.lever_arms, self.grid.size_m)

    def nearest(self, points: Array, normals: Array, reach_m: float, cosine: float = 0.7) -> Indices:
        """(M,) the nearest plane to each point that faces the same way, -1 where there is none.

        Args:
            points: (M, 3) in this submap's frame.
            normals: (M, 3) theirs; 0 faces any way.
            reach_m: at most the grid's cell.
            cosine: of the largest angle between the normals.
        """
        if reach_m > self.grid.size_m * (1 + 1e-9):
            raise ValueError(f"a grid of {self.grid.size_m} m cells cannot be searched to {reach_m} m")
        return np.asarray(_nearest(points, normals, self.points, self.normals, self.grid, reach_m, cosine))


@dataclass(frozen=True, eq=False)
class Sample:
    """Points of one submap that look for planes in the other."""

    points: Array
    """(M, 3)"""
    normals: Array
    """(M, 3)"""
    weights: Array
    """(M,)"""
    lever_arms: Array
    """(M, 3)"""

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def lever_lengths_m(self) -> Array:
        """(M,)"""
        return np.asarray(np.linalg.norm(self.lever_arms, axis=1))

    def stretched(self, stretch: float) -> Sample:
        """See :meth:`Planes.stretched`."""
        return replace(self, points=self.points + stretch * self.lever_arms) if stretch else self


class PlaneMap:
    """A submap made ready for registration: built once, used against many others."""

    def __init__(self, submap: Submap, options: PlaneOptions | None = None) -> None:
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
    def _bins(self) -> Indices:
        return direction_bins(self.normals)

    def level(self, k: int) -> Planes:
        """The planes of a level, 0 the coarsest."""
        if k not in self._levels:
            keep = thinned(self.points, self.options.thinning_m[k])
            self._levels[k] = grid_planes(
                self.points[keep],
                self.normals[keep],
                self._weights[keep],
                self._lever_arms[keep],
                self.options.reach_m[k],
            )
        return self._levels[k]

    def sample(self, k: int) -> Sample:
        """The points of a level that look for planes: about as many for each direction of the normal.

        Facades along the street have most of the points; what tells where one is along it are the few that face the
        other way (Rusinkiewicz and Levoy, Efficient variants of the ICP algorithm, 3DIM 2001).
        """
        if k not in self._samples:
            often = 1 / (1 + np.square(np.linalg.norm(self._lever_arms, axis=1) / self.options.near_m[k]))
            keep = balanced(self._bins, self.options.samples[k], often)
            self._samples[k] = Sample(
                self.points[keep], self.normals[keep], self._weights[keep], self._lever_arms[keep]
            )
        return self._samples[k]


def grid_planes(points: Array, normals: Array, weights: Array, lever_arms: Array, cell_m: float) -> Planes:
    """Planes of (N, 3) points with unit normals (N, 3), weights (N,) and ways from the node (N, 3)."""
    grid = make_grid(points, cell_m)
    order = grid.order
    return Planes(points[order], normals[order], weights[order], lever_arms[order], grid)


def thinned(points: Array, voxel_m: float) -> Indices:
    """(M,) rows of points (N, 3): the first in each voxel, in order; all for a voxel of 0."""
    if voxel_m <= 0:
        return np.arange(len(points))
    return np.sort(np.unique(voxel_keys(points, voxel_m), return_index=True)[1])


def direction_bins(normals: Array) -> Indices:
    """(N,) bins of unit vectors (N, 3) on an octahedral map (Meyer et al., On floating-point normal vectors, 2010)."""
    n = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-12)
    folded = (1 - np.abs(n[:, [1, 0]])) * np.where(n[:, :2] < 0, -1.0, 1.0)
    uv = np.where(n[:, 2:] < 0, folded, n[:, :2])
    cell = np.clip(((uv + 1) / 2 * _BINS).astype(np.int64), 0, _BINS - 1)
    return np.asarray(cell[:, 0] * _BINS + cell[:, 1])


def balanced(bins: Indices, count: int, often: Array) -> Indices:
    """(M,) rows of bins (N,): at most ``count``, as evenly over the bins as they allow.

    Args:
        often: (N,) how often each is to be drawn, within its bin, in proportion; without replacement (Efraimidis and
            Spirakis, Weighted random sampling with a reservoir, 2006). The draw is the same every time.
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
    order = np.argsort(bins + wait / (1 + wait))
    rank = np.arange(len(bins)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.sort(order[rank < int(share)])


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(
    points: Array, normals: Array, planes: Array, facing: Array, grid: Grid, reach: float, cosine: float
) -> Indices:  # pragma: no cover - compiled
    cell, starts = grid.size_m, grid.starts
    found = np.full(len(points), -1, dtype=np.int64)
    low, high = np.empty(3), np.empty(3)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        free = a * a + b * b + c * c < 0.25
        cx, cy, cz = int(np.floor(x / cell)), int(np.floor(y / cell)), int(np.floor(z / cell))
        low[0], low[1], low[2] = x - cx * cell, y - cy * cell, z - cz * cell
        for k in range(3):
            high[k] = cell - low[k]
        best = reach * reach
        for step in range(27):
            turn = (step + 13) % 27  # the point's own cell first
            dx, dy, dz = turn // 9 - 1, (turn // 3) % 3 - 1, turn % 3 - 1
            gx = low[0] if dx < 0 else (high[0] if dx > 0 else 0.0)
            gy = low[1] if dy < 0 else (high[1] if dy > 0 else 0.0)
            gz = low[2] if dz < 0 else (high[2] if dz > 0 else 0.0)
            if gx * gx + gy * gy + gz * gz > best:
                continue
            cell_row = cell_of(pack(cx + dx, cy + dy, cz + dz), grid.keys, grid.cells)
            if cell_row < 0:
                continue
            for j in range(starts[cell_row], starts[cell_row + 1]):
                ex, ey, ez = planes[j, 0] - x, planes[j, 1] - y, planes[j, 2] - z
                squared = ex * ex + ey * ey + ez * ez
                if squared < best and (free or a * facing[j, 0] + b * facing[j, 1] + c * facing[j, 2] >= cosine):
                    best = squared
                    found[i] = j
    return found
