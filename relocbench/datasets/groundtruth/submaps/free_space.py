"""Free space: a wall cannot stand where the beams of the other drive went through.

This is the strongest evidence against a wrong pose. Periodic facades and long walls still fit after a shift along the
street, but the gaps, crossings and recesses between them were seen through.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.datasets.groundtruth.voxels.traversal import enter_grid, next_voxel
from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, cells_of, make_grid, pack
from relocbench.geometry import apply
from relocbench.kernels import njit

_CELLS_M = (0.3, 0.5, 0.8)
"""sizes of surface patches; the first with which patches hold enough of the points is used"""
_HELD = 0.3
"""share of the points that patches must hold"""
_LEAST_POINTS = 3
"""least number of points in a patch"""
_FLAT = 0.95
"""least length of the mean of a patch's unit normals"""
_END_MARGIN_M = 0.6
"""a surface this close to a beam's end was reached, not passed"""
_START_MARGIN_M = 1.5
"""surfaces this close to the sensor are ignored"""
_GRAZING = 0.3
"""sine of the smallest angle between a beam and a surface that it crosses"""
_WITHIN = 0.6
"""a beam crosses a patch if it meets its plane within this share of the patch's size from its middle"""
_BEAMS = 12_000
"""number of beams that are followed, evenly spread"""
_LOW_WEIGHT = 0.15
"""weight of patches on cars, hedges and what else changes near the road"""
_NEAR_M = 10.0
"""distance from the node within which the height of the road is looked for"""
_LONGEST_M = 45.0
"""distance from the sensor up to which beams are followed"""


@dataclass(frozen=True, eq=False)
class Patches:
    """The V surface patches of a submap, at most one a voxel."""

    middle: Array
    """(V, 3) mean of the points"""
    normals: Array
    """(V, 3) unit vectors towards the sensor"""
    origins: Array
    """(V, 3) mean position of the sensor"""
    weights: Array
    """(V,)"""
    held: float
    """share of the points that lie in patches"""
    grid: Grid
    """the points sorted by voxel"""
    rows: NDArray[np.int32]
    """(C,) number of the patch in each occupied voxel, -1 if there is none"""

    def __len__(self) -> int:
        return len(self.middle)


@dataclass(frozen=True, eq=False)
class BeamVotes:
    """For each patch of one submap, the number of beams of the other that reached it or went through it."""

    through: Indices
    """(V,) number of beams that went through each patch"""
    reached: Indices
    """(V,) number of beams that ended at each patch"""
    weights: Array
    """(V,) weights of the patches"""

    def violations(self, found: Mask) -> float:
        """Weighted share of the decided patches that more beams went through than reached; nan if none is decided.

        Args:
            found: (V,) patches that the other drive measured as well. They violate nothing: beams go through hedges and
                between bars.
        """
        total = float(self.weights[self._decided].sum())
        violated = self._decided & (self.through > self.reached) & ~found
        return float(self.weights[violated].sum()) / total if total > 0 else float("nan")

    @property
    def _decided(self) -> Mask:
        # A single beam that goes through decides nothing: it may have passed beside an edge.
        return (self.through + self.reached >= 2) | (self.reached >= 1)


class FreeSpace:
    """Surface patches and beams of one submap, each computed once."""

    same_place_m = 2.5
    """a drive could see what was measured from within this distance of its own sensors; it is less than the width of a
    lane, since other sides of things are hidden from the next lane"""
    low_m = 2.2
    """height over the road below which cars park and hedges grow"""

    def __init__(self, submap: Submap) -> None:
        self.submap = submap

    @cached_property
    def patches(self) -> Patches:
        """Patches of the submap's static structure."""
        used = (self.submap.surface == Surface.STRUCTURE) & (self.submap.steady >= 0.5)
        arrays = (self.submap.points, self.submap.normals, self.submap.origins)
        points, normals, origins = (a[used].astype(np.float64) for a in arrays)
        for cell_m in _CELLS_M:
            patches = make_patches(points, normals, origins, cell_m, self.low_height_m)
            if patches.held >= _HELD:
                break
        return patches

    @cached_property
    def low_height_m(self) -> float:
        """Height in the node's frame below which things are low; over the node itself where no road is seen near it."""
        points = self.submap.points[self.submap.surface == Surface.GROUND]
        near = points[np.einsum("ni,ni->n", points[:, :2], points[:, :2]) <= _NEAR_M**2, 2]
        return self.low_m + (float(np.median(near)) if len(near) else 0.0)

    @cached_property
    def sensor_positions(self) -> Array:
        """(P, 3) positions of the sensors, about a metre apart."""
        origins = self.submap.origins.astype(np.float64)
        return np.asarray(origins[first_in_voxels(origins, 1.0)])

    @cached_property
    def beams(self) -> tuple[Array, Array]:
        """Origins and ends (B, 3) of beams; the ends are evenly spread."""
        points = self.submap.points.astype(np.float64)
        keep = first_in_voxels(points, 0.25)
        if len(keep) > _BEAMS:
            keep = keep[np.arange(_BEAMS) * len(keep) // _BEAMS]
        return self.submap.origins[keep].astype(np.float64), points[keep]

    def could_see(self, patches: Patches, T_patches_this: Array) -> Mask:
        """(V,) patches of another submap that were measured from near a sensor of this one, which could see them.

        Args:
            T_patches_this: (4, 4) from this submap's frame to that of the patches.
        """
        positions = apply(T_patches_this, self.sensor_positions)
        reach = self.same_place_m
        return np.asarray(cKDTree(positions).query(patches.origins, distance_upper_bound=reach)[0] < reach)

    def votes_of(self, beams: tuple[Array, Array], T_this_other: Array) -> BeamVotes:
        """The votes of another submap's beams (origins and ends, in its frame) on this one's patches."""
        origins, ends = (apply(T_this_other, p) for p in beams)
        patches = self.patches
        through, reached = _follow(origins, ends, patches.middle, patches.normals, patches.grid, patches.rows)
        return BeamVotes(through, reached, patches.weights)


def make_patches(
    points: Array, normals: Array, origins: Array, cell_m: float, low_m: float = FreeSpace.low_m
) -> Patches:
    """Patches, one a voxel of ``cell_m``, of points (N, 3) with unit normals (N, 3), measured from origins (N, 3).

    Patches below ``low_m`` weigh less.
    """
    grid = make_grid(points, cell_m)
    cells, count = cells_of(grid), len(grid.starts) - 1
    size = np.bincount(cells, minlength=count).astype(np.float64)

    def mean(values: Array) -> Array:
        return np.column_stack([np.bincount(cells, values[:, k], count) for k in range(3)]) / size[:, None]

    middle, facing, measured_from = mean(points), mean(normals), mean(origins)
    length = np.linalg.norm(facing, axis=1)
    surface = (size >= _LEAST_POINTS) & (length >= _FLAT)
    rows = np.where(surface, np.cumsum(surface) - 1, -1).astype(np.int32)
    middle, facing = middle[surface], facing[surface] / length[surface, None]
    weights = np.where(middle[:, 2] < low_m, _LOW_WEIGHT, 1.0)
    held = float(size[surface].sum()) / max(len(points), 1)
    return Patches(middle, facing, measured_from[surface], weights, held, grid, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(
    origins: Array, ends: Array, middle: Array, normals: Array, grid: Grid, rows: NDArray[np.int32]
) -> tuple[Indices, Indices]:  # pragma: no cover - compiled
    """(V,) beams through each patch, and (V,) beams that ended at it."""
    within = _WITHIN * grid.size_m
    through = np.zeros(len(middle), dtype=np.int64)
    reached = np.zeros(len(middle), dtype=np.int64)
    voxel, step = np.empty(3, np.int64), np.empty(3, np.int64)
    leave, stride, d = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(origins)):
        length = 0.0
        for k in range(3):
            d[k] = ends[i, k] - origins[i, k]
            length += d[k] * d[k]
        length = np.sqrt(length)
        if length < _START_MARGIN_M:
            continue
        last = min(length + _END_MARGIN_M, _LONGEST_M)
        for k in range(3):
            d[k] /= length
        enter_grid(origins[i], d, 0.0, grid.size_m, voxel, step, leave, stride)
        travelled = 0.0
        while travelled <= last:
            slot = cell_of(pack(voxel[0], voxel[1], voxel[2]), grid.keys, grid.cells)
            if slot >= 0 and rows[slot] >= 0:
                v = rows[slot]
                towards = normals[v, 0] * d[0] + normals[v, 1] * d[1] + normals[v, 2] * d[2]
                if abs(towards) >= _GRAZING:
                    far = 0.0
                    for k in range(3):
                        far += normals[v, k] * (middle[v, k] - origins[i, k])
                    far /= towards
                    aside = 0.0
                    for k in range(3):
                        aside += (origins[i, k] + far * d[k] - middle[v, k]) ** 2
                    if aside <= within * within and far > _START_MARGIN_M:
                        if far < length - _END_MARGIN_M:
                            through[v] += 1
                        elif far <= length + _END_MARGIN_M:
                            reached[v] += 1
            travelled = next_voxel(voxel, step, leave, stride)
    return through, reached
