"""Surfels: the points of a submap as small pieces of surface that reach just as far as their neighbours.

Each point with a normal becomes a star-shaped polygon in its tangent plane. In each of eight directions it reaches a
little beyond half-way to its nearest neighbour on the same surface (Pfister et al., Surfels, 2000, with a radius by the
local sampling in each direction). A round disk would leave gaps or reach into the air, since the scan lines of a
push-broom scanner are further apart than the points on them, and at a rim there are no neighbours on one side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats, Indices, Mask
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.kernels import njit

SECTORS = 8
_OVERLAP = 0.8
"""share of the distance to a neighbour that a surfel reaches: those of a square or triangular grid leave no gap"""
_RIM = 0.25
"""share of the distance to its nearest neighbour that it reaches in directions without one"""
_SAME_M = 0.01
"""points nearer to each other than this count as one point that was measured twice"""
_RISE = 0.2
"""largest distance of a neighbour from the surfel's plane, as a share of its distance: surfaces are curved"""
_LARGEST_GRID = 40_000_000


@dataclass(frozen=True)
class SurfelOptions:
    """Options that decide which points belong to one surface."""

    gap_m: float = 0.4
    """largest distance between neighbours; between points further apart there is a hole"""
    closed_hole_m: float = 1.5
    """width up to which a hole hides what is behind it, such as a window in a wall or a dark door"""
    offset_m: float = 0.05
    """largest distance of a neighbour from a surfel's plane, in addition to that by curvature"""
    cosine: float = 0.7
    """cosine of the largest angle between the normals of neighbours"""
    adopt_m: float = 0.03
    """a point without a plane takes that of the nearest surfel whose plane is within this distance; 0: none"""
    rough_m: float = 0.12
    """radius within which a point without a plane hides what is behind it"""
    rough_reach_m: float = 0.06
    """radius of the disk, facing the camera, that is drawn for it; 0: none is"""
    crowd: int = 3
    """least number of others within ``gap_m`` of a point without a plane; with fewer it is noise, such as a raindrop"""
    steady: float = 0.5
    """points with a lower static score are left out"""


@dataclass(frozen=True, eq=False)
class Surfels:
    """N surfels in the frame of the submap's node."""

    points: Floats
    """(N, 3) middle of each surfel"""
    normals: Floats
    """(N, 3) unit vectors towards the sensor; 0 for points without a plane"""
    axes: Floats
    """(N, 3) unit vectors along the surface, in the first of the eight directions"""
    reach: Floats
    """(N, 8) metres that the surfel covers in each direction, anticlockwise about its normal; 0 if it is not drawn"""
    occluding_reach: Floats
    """(N, 8) metres within which it hides what is behind it, at least as much as it covers"""
    origins: Floats
    """(N, 3) position of the sensor"""

    def __len__(self) -> int:
        return len(self.points)


def make_surfels(submap: Submap, options: SurfelOptions | None = None) -> Surfels:
    """Surfels of a submap's static points, in their order."""
    options = options or SurfelOptions()
    kept = (submap.steady >= options.steady) & np.isfinite(submap.points).all(axis=1)
    points = np.ascontiguousarray(submap.points[kept], dtype=np.float32)
    normals = np.ascontiguousarray(submap.normals[kept], dtype=np.float32)
    length = np.linalg.norm(normals, axis=1)
    normals[length <= 0.5] = 0
    crowd = np.zeros(len(points), np.int32)
    if len(points):
        normals, crowd = _adopted(points, normals, *_grid(points, options.gap_m), options.gap_m, options.adopt_m)
        length = np.linalg.norm(normals, axis=1)
    plane = length > 0.5
    normals = np.where(plane[:, None], normals / np.maximum(length, 1e-6)[:, None], 0).astype(np.float32)
    axes = _tangents(normals)
    distance = np.full((len(points), SECTORS), np.inf, dtype=np.float32)
    far = distance.copy()
    chosen = np.flatnonzero(plane)
    if len(chosen):
        of = (points[chosen], normals[chosen], axes[chosen])
        limits = (options.offset_m, _RISE, options.cosine)
        everything = np.arange(len(chosen))
        near = np.asarray(_neighbour_distances(*of, everything, *_grid(of[0], options.gap_m), options.gap_m, *limits))
        distance[chosen] = far[chosen] = near
        # Only for surfels beside a hole are neighbours searched further away, among thinned points to save time.
        rim = np.flatnonzero(~np.isfinite(near).all(axis=1))
        if len(rim) and options.closed_hole_m > options.gap_m:
            thin = first_in_voxels(of[0] / np.float32(options.gap_m / 1.5), 1.0)
            p, n, a = (np.ascontiguousarray(np.concatenate([array[rim], array[thin]])) for array in of)
            grid = _grid(p, options.closed_hole_m, first=len(rim))
            wide = _neighbour_distances(p, n, a, np.arange(len(rim)), *grid, options.closed_hole_m, *limits)
            far[chosen[rim]] = np.minimum(near[rim], wide)
    reach, occluding_reach = _stars(distance, far, plane, options)
    stray = ~plane & (crowd < options.crowd)
    reach[stray] = occluding_reach[stray] = 0
    return Surfels(
        points, normals, axes, reach, occluding_reach, np.ascontiguousarray(submap.origins[kept], dtype=np.float32)
    )


def _tangents(normals: Floats) -> Floats:
    """(N, 3) unit vectors at right angles to the normals (N, 3): level ones, or near x if the normal is upright."""
    level = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals), np.float32)], axis=1)
    size = np.linalg.norm(level, axis=1)
    upright = size < 0.3
    level[upright] = np.stack([normals[:, 2], np.zeros(len(normals)), -normals[:, 0]], axis=1)[upright]
    size = np.maximum(np.linalg.norm(level, axis=1), 1e-6)
    out: Floats = (level / size[:, None]).astype(np.float32)
    return out


def _stars(distance: Floats, far: Floats, plane: Mask, options: SurfelOptions) -> tuple[Floats, Floats]:
    """``reach`` and ``occluding_reach`` of surfels, from the distances to their neighbours (N, 8), inf if none."""
    met = np.isfinite(distance)
    nearest = np.min(distance, axis=1, initial=options.gap_m)
    alone = np.asarray(~met.any(axis=1))
    rim = np.where(met, _OVERLAP * np.where(met, distance, 0), _RIM * nearest[:, None])
    reach = np.where(alone[:, None], 0, rim)
    occluding_reach = np.where(
        np.isfinite(far), np.maximum(_OVERLAP * np.where(np.isfinite(far), far, 0), reach), reach
    )
    reach[~plane] = options.rough_reach_m
    occluding_reach[~plane | alone] = options.rough_m
    return reach.astype(np.float32), occluding_reach.astype(np.float32)


def _grid(
    points: Floats, cell_m: float, first: int = 0
) -> tuple[Floats, float, Indices, NDArray[np.int32], NDArray[np.int32]]:
    """Points from row ``first`` on, sorted by cell: lowest corner, cell size, shape, start of each cell, and rows.

    The cell size is at least ``cell_m``; it is enlarged until the grid fits into memory.
    """
    low = points.min(axis=0)
    extent = (points.max(axis=0) - low).astype(np.float64)
    while np.prod(np.floor(extent / cell_m) + 1) > _LARGEST_GRID:
        cell_m *= 1.5
    shape = np.floor(extent / cell_m).astype(np.int64) + 1
    starts, rows = _sorted_by_cell(points, low, np.float32(1 / cell_m), shape, first)
    return low, float(cell_m), shape, starts, rows


@njit(cache=True, nogil=True, error_model="numpy")
def _sorted_by_cell(points, low, inverse, shape, first):  # type: ignore[no-untyped-def]
    count = len(points)
    cell = np.empty(count, np.int64)
    starts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int32)
    for i in range(first, count):
        x = min(np.int64((points[i, 0] - low[0]) * inverse), shape[0] - 1)
        y = min(np.int64((points[i, 1] - low[1]) * inverse), shape[1] - 1)
        z = min(np.int64((points[i, 2] - low[2]) * inverse), shape[2] - 1)
        cell[i] = (x * shape[1] + y) * shape[2] + z
        starts[cell[i] + 1] += 1
    for k in range(len(starts) - 1):
        starts[k + 1] += starts[k]
    rows = np.empty(count - first, np.int32)
    filled = starts[:-1].copy()
    for i in range(first, count):
        rows[filled[cell[i]]] = i
        filled[cell[i]] += 1
    return starts, rows


@njit(cache=True, nogil=True, error_model="numpy")
def _adopted(points, normals, low, cell_m, shape, starts, rows, gap_m, adopt_m):  # type: ignore[no-untyped-def]
    """(N, 3) normals, with missing ones taken from the nearest point in whose plane the point lies; and for the points
    whose normals were missing, (N,) the number of others within ``gap_m``."""
    out = normals.copy()
    crowd = np.zeros(len(points), np.int32)
    inverse = np.float32(1.0 / cell_m)
    for i in range(len(points)):
        if normals[i, 0] != 0 or normals[i, 1] != 0 or normals[i, 2] != 0:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        cx = min(np.int64((px - low[0]) * inverse), shape[0] - 1)
        cy = min(np.int64((py - low[1]) * inverse), shape[1] - 1)
        cz = min(np.int64((pz - low[2]) * inverse), shape[2] - 1)
        best, nearest = -1, np.float32(gap_m * gap_m)
        for x in range(max(cx - 1, 0), min(cx + 2, shape[0])):
            for y in range(max(cy - 1, 0), min(cy + 2, shape[1])):
                row = (x * shape[1] + y) * shape[2]
                for m in range(starts[row + max(cz - 1, 0)], starts[row + min(cz + 2, shape[2])]):
                    j = rows[m]
                    nx, ny, nz = normals[j, 0], normals[j, 1], normals[j, 2]
                    dx, dy, dz = points[j, 0] - px, points[j, 1] - py, points[j, 2] - pz
                    square = dx * dx + dy * dy + dz * dz
                    if j != i and square < gap_m * gap_m:
                        crowd[i] += 1
                    if nx == 0 and ny == 0 and nz == 0:
                        continue
                    if square < nearest and abs(dx * nx + dy * ny + dz * nz) <= adopt_m:
                        best, nearest = j, square
        if best >= 0:
            out[i] = normals[best]
    return out, crowd


@njit(cache=True, nogil=True, error_model="numpy")
def _neighbour_distances(  # type: ignore[no-untyped-def]
    points, normals, axes, wanted, low, cell_m, shape, starts, rows, gap_m, offset_m, rise, cosine
):
    """(M, 8) metres from each point asked to its nearest neighbour on the same surface, by direction; inf if none.

    A neighbour counts for the two directions that it is between.
    """
    out = np.full((len(wanted), SECTORS), np.inf, np.float32)
    inverse = np.float32(1.0 / cell_m)
    farthest = gap_m * gap_m
    for k in range(len(wanted)):
        i = wanted[k]
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        ax, ay, az = axes[i, 0], axes[i, 1], axes[i, 2]
        bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
        cx = min(np.int64((px - low[0]) * inverse), shape[0] - 1)
        cy = min(np.int64((py - low[1]) * inverse), shape[1] - 1)
        cz = min(np.int64((pz - low[2]) * inverse), shape[2] - 1)
        for x in range(max(cx - 1, 0), min(cx + 2, shape[0])):
            for y in range(max(cy - 1, 0), min(cy + 2, shape[1])):
                row = (x * shape[1] + y) * shape[2]
                for m in range(starts[row + max(cz - 1, 0)], starts[row + min(cz + 2, shape[2])]):
                    j = rows[m]
                    dx, dy, dz = points[j, 0] - px, points[j, 1] - py, points[j, 2] - pz
                    square = dx * dx + dy * dy + dz * dz
                    if square > farthest:
                        continue
                    if nx * normals[j, 0] + ny * normals[j, 1] + nz * normals[j, 2] < cosine:
                        continue
                    u, v = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz
                    length = np.sqrt(u * u + v * v)
                    if length < _SAME_M or abs(dx * nx + dy * ny + dz * nz) > offset_m + rise * length:
                        continue
                    s = _octant(u, v)
                    t = (s + 1) % SECTORS
                    out[k, s] = min(out[k, s], length)
                    out[k, t] = min(out[k, t], length)
    return out


@njit(cache=True, inline="always")
def _octant(u, v):  # type: ignore[no-untyped-def]
    """The octant, numbered anticlockwise from (1, 0), that (u, v) lies in."""
    if v >= 0:
        if u >= 0:
            return 0 if u > v else 1
        return 2 if v > -u else 3
    if u < 0:
        return 4 if -u > -v else 5
    return 6 if -v > u else 7
