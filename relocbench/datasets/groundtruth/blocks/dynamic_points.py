"""Dynamic points: those that other beams of the same drive went through without meeting anything.

A beam votes against a point if it passes close to it, well before it ends, at another time than the point was
measured, and not along the point's surface. It votes for the point if it ends beside it. Leaves and wires get votes of
both kinds; a car that drove on gets votes against it only. Beams fired at nearly the same time as the point do not
vote, since the car was still there.

A push-broom lidar sees each place once, so that it takes a second lidar, mounted some metres behind the first, to find
what moved; points that the second one does not reach count as static. Beams that did not return are not used, since
dark surfaces, wet surfaces and the sky cannot be told apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Floats, Indices
from relocbench.datasets.groundtruth.blocks.deskewing import Beams
from relocbench.datasets.groundtruth.voxels.traversal import enter_grid, next_voxel
from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, make_grid, pack
from relocbench.kernels import njit


@dataclass(frozen=True)
class DynamicPointOptions:
    """Options that decide which beams vote for or against a point."""

    pass_m: float = 0.1
    """a beam that comes so near to a point passes it"""
    meet_m: float = 0.2
    """a beam that ends so near to a point met the same surface"""
    pool_m: float = 0.25
    """points so near to each other, measured at the same time, share their votes, since each alone has few"""
    margin_m: float = 0.5
    """the last part of a beam, so long, passes nothing: allows for noise, drift and grazing incidence"""
    most_beams: int = 16_000
    """number of beams of a block that vote, spread evenly over its points: a spinning lidar has plenty"""
    apart_ns: int = 150_000_000
    """a beam fired within so short a time of a point's does not vote on it"""
    cosine: float = 0.25
    """cosine of the angle between a beam and a normal below which the beam runs along the surface"""


def static_scores(
    beams: Beams, normals: Floats, wanted: Indices, voting: Indices, options: DynamicPointOptions
) -> Floats:
    """Static scores (M,) of points: the share of the votes on each that are for it; 1 where none is against it.

    Args:
        beams: of several blocks, in one frame.
        normals: (M, 3) of the wanted points, in the frame of the beams; 0 where no plane fits.
        wanted: (M,) rows of the points to score.
        voting: (H,) rows of the beams that vote.
    """
    if not len(wanted) or not len(voting):
        return np.ones(len(wanted), dtype=np.float32)
    targets, beams = beams.rows(wanted), beams.rows(voting)
    passed = _passed(targets, normals, make_grid(targets.points, 2 * options.pass_m), beams,
                     options.pass_m, options.margin_m, options.apart_ns, options.cosine)  # fmt: skip
    if not passed.any():
        return np.ones(len(wanted), dtype=np.float32)
    one_each = np.ones((len(beams.points), 1), dtype=np.int64)
    met = _votes_near(
        targets, beams, one_each, make_grid(beams.points, options.meet_m), options.meet_m, options.apart_ns, False
    )
    own = np.column_stack([passed, met])
    pooled = _votes_near(
        targets, targets, own, make_grid(targets.points, options.pool_m), options.pool_m, options.apart_ns, True
    )
    votes_against, votes_for = pooled[:, 0], pooled[:, 1]
    # Every point gets half a vote: one passing beam alone is little evidence.
    return np.where(votes_against > 0, (votes_for + 0.5) / (votes_for + 0.5 + votes_against), 1.0).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _passed(
    targets: Beams, normals: Floats, grid: Grid, beams: Beams, pass_m: float, margin_m: float,
    apart_ns: int, cosine: float,
) -> Indices:  # fmt: skip
    """(M,) number of beams that went through each target."""
    votes = np.zeros(len(targets.points), dtype=np.int64)
    lowest, highest = np.full(3, np.inf), np.full(3, -np.inf)
    for p in range(len(targets.points)):
        for axis in range(3):
            lowest[axis] = min(lowest[axis], targets.points[p, axis])
            highest[axis] = max(highest[axis], targets.points[p, axis])
    d, voxel, step = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    leave, stride = np.empty(3), np.empty(3)
    first, last = targets.times_ns.min(), targets.times_ns.max()
    for b in range(len(beams.points)):
        if last - apart_ns < beams.times_ns[b] < first + apart_ns:
            continue
        length = 0.0
        for axis in range(3):
            d[axis] = beams.points[b, axis] - beams.origins[b, axis]
            length += d[axis] * d[axis]
        length = np.sqrt(length)
        end = length - margin_m
        if end <= 0:
            continue
        # Only the part of the beam within the bounding box of the targets.
        begin = 0.0
        for axis in range(3):
            d[axis] /= length
            o = beams.origins[b, axis]
            if d[axis] != 0:
                one, two = (lowest[axis] - o) / d[axis], (highest[axis] - o) / d[axis]
                begin, end = max(begin, min(one, two)), min(end, max(one, two))
            elif o < lowest[axis] or o > highest[axis]:
                end = -1.0
        if begin > end:
            continue
        enter_grid(beams.origins[b], d, begin, grid.size_m, voxel, step, leave, stride)
        entered = begin
        while entered <= end:
            cell = cell_of(pack(voxel[0], voxel[1], voxel[2]), grid.keys, grid.cells)
            if cell >= 0:
                for k in range(grid.starts[cell], grid.starts[cell + 1]):
                    p = grid.order[k]
                    if abs(targets.times_ns[p] - beams.times_ns[b]) < apart_ns:
                        continue
                    x = targets.points[p, 0] - beams.origins[b, 0]
                    y = targets.points[p, 1] - beams.origins[b, 1]
                    z = targets.points[p, 2] - beams.origins[b, 2]
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
            entered = next_voxel(voxel, step, leave, stride)
    return votes


@njit(cache=True, nogil=True, error_model="numpy")
def _votes_near(
    targets: Beams, voters: Beams, votes: Indices, grid: Grid, reach_m: float, apart_ns: int, same_time: bool
) -> Indices:
    """(M, C) sums, for each target, of the votes (V, C) of the voters that end within ``reach_m`` of it.

    Args:
        grid: of the voters' points; its voxels are as large as ``reach_m``.
        same_time: whether only voters measured at the target's time count, or only those measured at another time.
    """
    sums = np.zeros((len(targets.points), votes.shape[1]), dtype=np.int64)
    size = grid.size_m
    for p in range(len(sums)):
        x, y, z = targets.points[p, 0], targets.points[p, 1], targets.points[p, 2]
        cx, cy, cz = int(np.floor(x / size)), int(np.floor(y / size)), int(np.floor(z / size))
        for ix in range(cx - 1, cx + 2):
            for iy in range(cy - 1, cy + 2):
                for iz in range(cz - 1, cz + 2):
                    cell = cell_of(pack(ix, iy, iz), grid.keys, grid.cells)
                    if cell < 0:
                        continue
                    for k in range(grid.starts[cell], grid.starts[cell + 1]):
                        v = grid.order[k]
                        if (abs(targets.times_ns[p] - voters.times_ns[v]) < apart_ns) != same_time:
                            continue
                        dx, dy, dz = voters.points[v, 0] - x, voters.points[v, 1] - y, voters.points[v, 2] - z
                        if dx * dx + dy * dy + dz * dz <= reach_m * reach_m:
                            for c in range(votes.shape[1]):
                                sums[p, c] += votes[v, c]
    return sums
