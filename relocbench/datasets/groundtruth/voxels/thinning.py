"""Thinning of point clouds to one measured point a voxel: the one nearest to the mean, or simply the first.

Measured points are kept rather than means, because a measured point has a beam of its own (from which free space is
found) and noise of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.voxels.voxels import distinct_keys, voxel_keys
from relocbench.kernels import njit

_UNIT_M = 1e-6
_MASK, _FACTOR = 0xFFFFFFFF, 0x2C1B3C6D
"""for mixing the bits of 32-bit numbers by multiplications and shifts"""


def thin(points: Array, voxel_m: float) -> Indices:
    """(M,) rows of points (N, 3): in each voxel the point nearest to the mean of all, voxel after voxel.

    Coordinates are summed as whole micrometres, so that the choice does not depend on the order of the points.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    keys = voxel_keys(points, voxel_m)
    order = np.argsort(keys, kind="stable")
    return _nearest_to_mean(points, keys, order)


def first_in_voxels(points: NDArray[np.floating], voxel_m: float) -> Indices:
    """(M,) rows of points (N, 3): the first in each voxel, in order; all rows for a ``voxel_m`` of 0."""
    if voxel_m <= 0:
        return np.arange(len(points))
    return np.asarray(distinct_keys(voxel_keys(points, voxel_m))[1])


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_to_mean(points: Array, keys: Indices, order: Indices) -> Indices:
    n = len(order)
    kept = np.empty(n, dtype=np.int64)
    count = 0
    begin = 0
    while begin < n:
        key = keys[order[begin]]
        end = begin
        sx = sy = sz = 0
        while end < n and keys[order[end]] == key:
            p = order[end]
            sx += int(np.rint(points[p, 0] / _UNIT_M))
            sy += int(np.rint(points[p, 1] / _UNIT_M))
            sz += int(np.rint(points[p, 2] / _UNIT_M))
            end += 1
        size = end - begin
        best = order[begin]
        best_distance = np.inf
        for i in range(begin, end):
            p = order[i]
            dx = size * int(np.rint(points[p, 0] / _UNIT_M)) - sx
            dy = size * int(np.rint(points[p, 1] / _UNIT_M)) - sy
            dz = size * int(np.rint(points[p, 2] / _UNIT_M)) - sz
            distance = float(dx) * dx + float(dy) * dy + float(dz) * dz
            if distance < best_distance or (distance == best_distance and _drawn_before(points, p, best)):
                best, best_distance = p, distance
        kept[count] = best
        count += 1
        begin = end
    return kept[:count]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _drawn_before(points: Array, a: int, b: int) -> bool:
    """Which of two points a draw by their coordinates prefers, whatever their order.

    Of two points alone in a voxel both are equally near to their mean. To prefer the one with the smaller x, say, would
    shift every surface by a part of its noise towards -x, and two drives in opposite directions by millimetres apart.
    """
    one, other = _mixed(points, a), _mixed(points, b)
    if one != other:
        return bool(one < other)
    for axis in range(3):
        if points[a, axis] != points[b, axis]:
            return bool(points[a, axis] < points[b, axis])
    return False


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _mixed(points: Array, row: int) -> int:
    """A number that looks random, of a point's coordinates in whole micrometres."""
    mixed = np.int64(0)
    for axis in range(3):
        mixed = (mixed ^ np.int64(np.rint(points[row, axis] / _UNIT_M))) & _MASK
        mixed = (mixed * _FACTOR) & _MASK
        mixed ^= mixed >> 16
        mixed = (mixed * _FACTOR) & _MASK
        mixed ^= mixed >> 15
    return int(mixed)
