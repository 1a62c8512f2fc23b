"""What moved: points that other beams of the same drive went through, and where none of them met anything.

A beam speaks against a point if it passes it closely, well before it ends, at another time than the point was
measured, and not along the point's surface. It speaks for the point if it ends beside it. Leaves and wires are passed
and met; a car that drove on is passed alone. Beams fired at nearly the same time say nothing: the car was still there.

A push-broom lidar sees each place once, so that only a second one, some metres behind the first, can tell; what it
does not reach in the meantime stays steady. Beams that did not return are not used: dark surfaces, wet ones and the sky
look alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, make_grid, pack
from relocbench.kernels import njit

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class DynamicPointOptions:
    """When a beam went through a point, and when it met the same thing."""

    pass_m: float = 0.1
    """a beam passes a point that is so near to it"""
    meet_m: float = 0.2
    """a beam that ends so near to a point met the same thing"""
    pool_m: float = 0.25
    """points so near to one another, measured at one time, share their beams: evidence is thin and surfaces large"""
    margin_m: float = 0.5
    """so long before its end a beam passes nothing: noise, drift and grazing"""
    most_beams: int = 16_000
    """of a block that are heard, evenly over its points: a spinning lidar sees everything over and over"""
    apart_ns: int = 150_000_000
    """beams fired so soon after one another say nothing about one another"""
    cosine: float = 0.25
    """of the angle between a beam and a normal; below it the beam runs along the surface"""


class Rays(NamedTuple):
    """Beams of several blocks in one frame."""

    points: Array
    """(N, 3)"""
    origins: Array
    """(N, 3)"""
    times_ns: Times
    """(N,)"""


def static_scores(
    rays: Rays, normals: NDArray[np.float32], wanted: Indices, heard: Indices, options: DynamicPointOptions
) -> NDArray[np.float32]:
    """Share (M,) of the beams at a point that met something there: 1 where nothing speaks against it.

    Args:
        normals: (M, 3) of the wanted points, in the frame of the beams; 0 where no plane fits.
        wanted: (M,) rows.
        heard: (H,) rows whose beams vote.
    """
    if not len(wanted) or not len(heard):
        return np.ones(len(wanted), dtype=np.float32)
    targets = Rays(rays.points[wanted], rays.origins[wanted], rays.times_ns[wanted])
    rays = Rays(rays.points[heard], rays.origins[heard], rays.times_ns[heard])
    passed = _passed(targets, normals, make_grid(targets.points, 2 * options.pass_m), rays,
                     options.pass_m, options.margin_m, options.apart_ns, options.cosine)  # fmt: skip
    if not passed.any():
        return np.ones(len(wanted), dtype=np.float32)
    met = _met(targets, make_grid(rays.points, options.meet_m), rays, options.meet_m, options.apart_ns)
    against, speaking = _pooled(
        targets, make_grid(targets.points, options.pool_m), passed, met, options.pool_m, options.apart_ns
    )
    # Half a beam speaks for every point: one passing beam alone is little evidence.
    return np.where(against > 0, (speaking + 0.5) / (speaking + 0.5 + against), 1.0).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _passed(
    targets: Rays, normals: NDArray[np.float32], grid: Grid, rays: Rays, pass_m: float, margin_m: float,
    apart_ns: int, cosine: float,
) -> Indices:  # fmt: skip
    """(M,) beams that went through each target. Cubes along a beam as in Amanatides and Woo, A fast voxel traversal
    algorithm for ray tracing, 1987."""
    votes = np.zeros(len(targets.points), dtype=np.int64)
    size = grid.size_m
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    for p in range(len(targets.points)):
        for axis in range(3):
            lowest[axis] = min(lowest[axis], targets.points[p, axis])
            highest[axis] = max(highest[axis], targets.points[p, axis])
    d, at, step = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    until, across = np.empty(3), np.empty(3)
    first, last = targets.times_ns.min(), targets.times_ns.max()
    for r in range(len(rays.points)):
        if last - apart_ns < rays.times_ns[r] < first + apart_ns:
            continue
        length = 0.0
        for axis in range(3):
            d[axis] = rays.points[r, axis] - rays.origins[r, axis]
            length += d[axis] * d[axis]
        length = np.sqrt(length)
        end = length - margin_m
        if end <= 0:
            continue
        # Only the part of the beam within the box about the targets.
        begin = 0.0
        for axis in range(3):
            d[axis] /= length
            o = rays.origins[r, axis]
            if d[axis] != 0:
                one, two = (lowest[axis] - o) / d[axis], (highest[axis] - o) / d[axis]
                begin, end = max(begin, min(one, two)), min(end, max(one, two))
            elif o < lowest[axis] or o > highest[axis]:
                end = -1.0
        if begin > end:
            continue
        for axis in range(3):
            o = rays.origins[r, axis]
            at[axis] = int(np.floor((o + begin * d[axis]) / size))
            if d[axis] > 0:
                step[axis] = 1
                until[axis] = ((at[axis] + 1) * size - o) / d[axis]
                across[axis] = size / d[axis]
            elif d[axis] < 0:
                step[axis] = -1
                until[axis] = (at[axis] * size - o) / d[axis]
                across[axis] = -size / d[axis]
            else:
                step[axis] = 0
                until[axis] = np.inf
                across[axis] = np.inf
        entered = begin
        while entered <= end:
            cell = cell_of(pack(at[0], at[1], at[2]), grid.keys, grid.cells)
            if cell >= 0:
                for k in range(grid.starts[cell], grid.starts[cell + 1]):
                    p = grid.order[k]
                    if abs(targets.times_ns[p] - rays.times_ns[r]) < apart_ns:
                        continue
                    x = targets.points[p, 0] - rays.origins[r, 0]
                    y = targets.points[p, 1] - rays.origins[r, 1]
                    z = targets.points[p, 2] - rays.origins[r, 2]
                    along = x * d[0] + y * d[1] + z * d[2]
                    if along <= 0 or along > end:
                        continue
                    if x * x + y * y + z * z - along * along > pass_m * pass_m:
                        continue
                    nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
                    plane = nx != 0 or ny != 0 or nz != 0
                    if plane and abs(nx * d[0] + ny * d[1] + nz * d[2]) < cosine:
                        continue
                    votes[p] += 1
            axis = 0
            if until[1] < until[axis]:
                axis = 1
            if until[2] < until[axis]:
                axis = 2
            entered = until[axis]
            until[axis] += across[axis]
            at[axis] += step[axis]
    return votes


@njit(cache=True, nogil=True, error_model="numpy")
def _met(targets: Rays, grid: Grid, rays: Rays, meet_m: float, apart_ns: int) -> Indices:
    """(M,) beams that ended beside each target at another time."""
    votes = np.zeros(len(targets.points), dtype=np.int64)
    size = grid.size_m
    for p in range(len(votes)):
        x, y, z = targets.points[p, 0], targets.points[p, 1], targets.points[p, 2]
        cx, cy, cz = int(np.floor(x / size)), int(np.floor(y / size)), int(np.floor(z / size))
        for ix in range(cx - 1, cx + 2):
            for iy in range(cy - 1, cy + 2):
                for iz in range(cz - 1, cz + 2):
                    cell = cell_of(pack(ix, iy, iz), grid.keys, grid.cells)
                    if cell < 0:
                        continue
                    for k in range(grid.starts[cell], grid.starts[cell + 1]):
                        r = grid.order[k]
                        if abs(targets.times_ns[p] - rays.times_ns[r]) < apart_ns:
                            continue
                        dx, dy, dz = rays.points[r, 0] - x, rays.points[r, 1] - y, rays.points[r, 2] - z
                        if dx * dx + dy * dy + dz * dz <= meet_m * meet_m:
                            votes[p] += 1
    return votes


@njit(cache=True, nogil=True, error_model="numpy")
def _pooled(
    targets: Rays, grid: Grid, passed: Indices, met: Indices, pool_m: float, apart_ns: int
) -> tuple[Indices, Indices]:
    """Sums (M,) of both kinds of votes over the targets around each that were measured when it was."""
    against, speaking = np.zeros_like(passed), np.zeros_like(met)
    size = grid.size_m
    for p in range(len(passed)):
        x, y, z = targets.points[p, 0], targets.points[p, 1], targets.points[p, 2]
        cx, cy, cz = int(np.floor(x / size)), int(np.floor(y / size)), int(np.floor(z / size))
        for ix in range(cx - 1, cx + 2):
            for iy in range(cy - 1, cy + 2):
                for iz in range(cz - 1, cz + 2):
                    cell = cell_of(pack(ix, iy, iz), grid.keys, grid.cells)
                    if cell < 0:
                        continue
                    for k in range(grid.starts[cell], grid.starts[cell + 1]):
                        q = grid.order[k]
                        if abs(targets.times_ns[p] - targets.times_ns[q]) >= apart_ns:
                            continue
                        dx, dy, dz = targets.points[q, 0] - x, targets.points[q, 1] - y, targets.points[q, 2] - z
                        if dx * dx + dy * dy + dz * dz <= pool_m * pool_m:
                            against[p] += passed[q]
                            speaking[p] += met[q]
    return against, speaking
