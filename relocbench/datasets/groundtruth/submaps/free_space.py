"""Free space: a wall cannot stand where the other drive's beams went through.

The strongest witness against a wrong pose, since it needs no similarity: periodic facades and long walls agree with
themselves wherever they are slid, but gaps, crossings and set-backs were seen through. Beams are followed cell by cell
(Amanatides and Woo, A fast voxel traversal algorithm, 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.submaps.planes import thinned
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, cubes_of, make_grid, pack
from relocbench.geometry import apply
from relocbench.kernels import njit

Array = NDArray[np.float64]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class FreeSpaceOptions:
    """When a beam counts as having gone through a surface."""

    cells_m: tuple[float, ...] = (0.3, 0.5, 0.8)
    """size of a piece of surface: the first with which pieces hold enough of the points; sparse clouds need larger"""
    held: float = 0.3
    """share of the points that is enough"""
    least_points: int = 3
    """fewer in a cell are no surface"""
    flat: float = 0.95
    """length of the mean of a piece's unit normals, at least"""
    end_margin_m: float = 0.6
    """a surface so close before a beam's end was reached, not passed"""
    start_margin_m: float = 1.5
    """so close to the sensor nothing is judged"""
    grazing: float = 0.3
    """sine of the smallest angle between a beam and a surface that it can be said to cross"""
    within: float = 0.6
    """of a cell: a beam crosses a piece if it meets its plane so near to its middle"""
    beams: int = 12_000
    """so many are followed, spread evenly"""
    low_m: float = 2.2
    """below this height over the node cars park and hedges grow"""
    low_weight: float = 0.3
    """what low pieces count"""
    longest_m: float = 45.0
    """beams are followed so far at most"""


@dataclass(frozen=True, eq=False)
class Patches:
    """A submap's surfaces, one piece a cell."""

    middle: Array
    """(V, 3)"""
    normals: Array
    """(V, 3)"""
    origins: Array
    """(V, 3) where the sensor was, on average"""
    weights: Array
    """(V,)"""
    held: float
    """share of the points that lie in pieces"""
    grid: Grid
    """of the points"""
    rows: NDArray[np.int32]
    """(C,) piece of each occupied cell, -1 if what is in it is no surface"""

    def __len__(self) -> int:
        return len(self.middle)


@dataclass(frozen=True, eq=False)
class BeamVotes:
    """What the beams of one submap say of the pieces of the other."""

    through: Counts
    """(V,) beams that went through each piece"""
    reached: Counts
    """(V,) beams that ended at it"""
    weights: Array
    """(V,)"""

    @property
    def patches(self) -> int:
        """How many were judged."""
        return int(np.count_nonzero(self._decided))

    def violations(self, found: NDArray[np.bool_]) -> float:
        """Weighted share of the judged pieces that most beams went through; nan where none was judged.

        Args:
            found: (V,) pieces that the other has as well. Beams go through hedges and between bars; what both have
                measured contradicts nothing.
        """
        total = float(self.weights[self._decided].sum())
        violated = self._decided & (self.through > self.reached) & ~found
        return float(self.weights[violated].sum()) / total if total > 0 else float("nan")

    @property
    def _decided(self) -> NDArray[np.bool_]:
        # A single beam may pass beside an edge.
        return (self.through + self.reached >= 2) | (self.reached >= 1)


class FreeSpace:
    """Surfaces and beams of one submap, made ready once."""

    def __init__(self, submap: Submap, options: FreeSpaceOptions | None = None) -> None:
        self.submap = submap
        self.options = options or FreeSpaceOptions()

    @cached_property
    def patches(self) -> Patches:
        """Its steady surfaces that stand upright or high."""
        used = (self.submap.surface == Surface.STRUCTURE) & (self.submap.steady >= 0.5)
        arrays = (self.submap.points, self.submap.normals, self.submap.origins)
        points, normals, origins = (a[used].astype(np.float64) for a in arrays)
        for cell_m in self.options.cells_m:
            patches = make_patches(points, normals, origins, cell_m, self.options)
            if patches.held >= self.options.held:
                break
        return patches

    @cached_property
    def sensor_positions(self) -> Array:
        """(P, 3) places about a metre apart where the sensors were."""
        origins = self.submap.origins.astype(np.float64)
        return np.asarray(origins[thinned(origins, 1.0)])

    @cached_property
    def beams(self) -> tuple[Array, Array]:
        """Origins and ends (B, 3) of beams, evenly spread over where they ended."""
        points = self.submap.points.astype(np.float64)
        keep = thinned(points, 0.25)
        if len(keep) > self.options.beams:
            keep = keep[np.arange(self.options.beams) * len(keep) // self.options.beams]
        return self.submap.origins[keep].astype(np.float64), points[keep]

    def votes_of(self, beams: tuple[Array, Array], T_this_other: Array) -> BeamVotes:
        """This submap's pieces by another's beams."""
        origins, ends = (apply(T_this_other, p) for p in beams)
        patches, o = self.patches, self.options
        through, reached = _follow(
            origins, ends, patches.middle, patches.normals, patches.grid, patches.rows,
            o.start_margin_m, o.end_margin_m, o.grazing, o.within * patches.grid.size_m, o.longest_m,
        )  # fmt: skip
        return BeamVotes(through, reached, patches.weights)


def make_patches(points: Array, normals: Array, origins: Array, cell_m: float, options: FreeSpaceOptions) -> Patches:
    """Pieces of points (N, 3) with unit normals (N, 3), measured from origins (N, 3)."""
    grid = make_grid(points, cell_m)
    cells, count = cubes_of(grid), len(grid.starts) - 1
    size = np.bincount(cells, minlength=count).astype(np.float64)

    def mean(values: Array) -> Array:
        return np.column_stack([np.bincount(cells, values[:, k], count) for k in range(3)]) / size[:, None]

    middle, facing, measured_from = mean(points), mean(normals), mean(origins)
    length = np.linalg.norm(facing, axis=1)
    surface = (size >= options.least_points) & (length >= options.flat)
    rows = np.where(surface, np.cumsum(surface) - 1, -1).astype(np.int32)
    middle, facing = middle[surface], facing[surface] / length[surface, None]
    weights = np.where(middle[:, 2] < options.low_m, options.low_weight, 1.0)
    held = float(size[surface].sum()) / max(len(points), 1)
    return Patches(middle, facing, measured_from[surface], weights, held, grid, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(
    origins: Array, ends: Array, middle: Array, normals: Array, grid: Grid,
    rows: NDArray[np.int32], start_margin: float, end_margin: float, grazing: float, within: float,
    longest: float,
) -> tuple[Counts, Counts]:  # fmt: skip  # pragma: no cover - compiled
    cell = grid.size_m
    through = np.zeros(len(middle), dtype=np.int64)
    reached = np.zeros(len(middle), dtype=np.int64)
    at, step = np.empty(3, np.int64), np.empty(3, np.int64)
    following, stride, d = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(origins)):
        length = 0.0
        for k in range(3):
            d[k] = ends[i, k] - origins[i, k]
            length += d[k] * d[k]
        length = np.sqrt(length)
        if length < start_margin:
            continue
        last = min(length + end_margin, longest)
        for k in range(3):
            d[k] /= length
            at[k] = int(np.floor(origins[i, k] / cell))
            if d[k] > 0:
                step[k], stride[k] = 1, cell / d[k]
                following[k] = ((at[k] + 1) * cell - origins[i, k]) / d[k]
            elif d[k] < 0:
                step[k], stride[k] = -1, -cell / d[k]
                following[k] = (at[k] * cell - origins[i, k]) / d[k]
            else:
                step[k], stride[k], following[k] = 0, np.inf, np.inf
        travelled = 0.0
        while travelled <= last:
            slot = cell_of(pack(at[0], at[1], at[2]), grid.keys, grid.cells)
            if slot >= 0 and rows[slot] >= 0:
                v = rows[slot]
                towards = normals[v, 0] * d[0] + normals[v, 1] * d[1] + normals[v, 2] * d[2]
                if abs(towards) >= grazing:
                    far = 0.0
                    for k in range(3):
                        far += normals[v, k] * (middle[v, k] - origins[i, k])
                    far /= towards
                    aside = 0.0
                    for k in range(3):
                        aside += (origins[i, k] + far * d[k] - middle[v, k]) ** 2
                    if aside <= within * within and far > start_margin:
                        if far < length - end_margin:
                            through[v] += 1
                        elif far <= length + end_margin:
                            reached[v] += 1
            k = 0
            if following[1] < following[k]:
                k = 1
            if following[2] < following[k]:
                k = 2
            travelled = following[k]
            at[k] += step[k]
            following[k] += stride[k]
    return through, reached
