"""Space cut into voxels: the key of the voxel that a point lies in, and the points of each voxel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Indices
from relocbench.kernels import njit

_BITS = 21
_HALF = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1
EMPTY = -1
"""the key of no voxel"""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def pack(x: int, y: int, z: int) -> int:
    """Key of the voxel (x, y, z). Keys repeat after 2^21 voxels along an axis."""
    return (((x + _HALF) & _MASK) << (2 * _BITS)) | (((y + _HALF) & _MASK) << _BITS) | ((z + _HALF) & _MASK)


@njit(cache=True, nogil=True, error_model="numpy")
def voxel_keys(points: NDArray[np.floating], size_m: float) -> Indices:
    """(N,) keys of the voxels, ``size_m`` wide, that points (N, 3) lie in; the origin is a corner of a voxel."""
    keys = np.empty(len(points), dtype=np.int64)
    for i in range(len(points)):
        keys[i] = pack(
            int(np.floor(points[i, 0] / size_m)),
            int(np.floor(points[i, 1] / size_m)),
            int(np.floor(points[i, 2] / size_m)),
        )
    return keys


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def slot_of(key: int, mask: int) -> int:
    """The slot at which the search for a key begins in a table of ``mask + 1`` slots (Fibonacci hashing)."""
    mixed = key * 0x9E3779B97F4A7C1
    return (mixed ^ (mixed >> 29)) & mask


@njit(cache=True, nogil=True, error_model="numpy")
def distinct_keys(keys: Indices) -> tuple[Indices, Indices]:
    """(N,) numbers of the distinct values of keys (N,), in the order in which they appear first, and (C,) the row where
    each does."""
    size = 8
    while size < 2 * len(keys):
        size *= 2
    table = np.full(size, -1, dtype=np.int32)
    number, first = np.empty(len(keys), dtype=np.int64), np.empty(len(keys), dtype=np.int64)
    count = 0
    for i in range(len(keys)):
        key = keys[i]
        slot = slot_of(key, size - 1)
        while table[slot] >= 0 and keys[first[table[slot]]] != key:
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = count
            first[count] = i
            count += 1
        number[i] = table[slot]
    return number, first[:count].copy()


class Grid(NamedTuple):
    """Points sorted by voxel. Within a voxel they keep their order, as voxels do by their first points."""

    size_m: float
    order: Indices
    """(N,) rows of the points, voxel after voxel"""
    starts: Indices
    """(C + 1,) where each of the C occupied voxels begins in ``order``"""
    keys: Indices
    """(S,) open-addressed hash table of voxel keys, ``EMPTY`` where there is none"""
    cells: NDArray[np.int32]
    """(S,) the number, from 0 to C - 1, of the voxel in each slot"""


def make_grid(points: NDArray[np.floating], size_m: float) -> Grid:
    """Sort points (N, 3) into voxels of ``size_m``."""
    return Grid(size_m, *_sorted(voxel_keys(points, size_m)))


@njit(cache=True, nogil=True, error_model="numpy")
def _sorted(voxels: Indices) -> tuple[Indices, Indices, Indices, NDArray[np.int32]]:
    """The order, the starts, and the table of a grid of points in these voxels (N,)."""
    number, first = distinct_keys(voxels)
    starts = np.zeros(len(first) + 1, dtype=np.int64)
    for i in range(len(number)):
        starts[number[i] + 1] += 1
    for c in range(len(first)):
        starts[c + 1] += starts[c]
    place, order = starts[:-1].copy(), np.empty(len(number), dtype=np.int64)
    for i in range(len(number)):
        order[place[number[i]]] = i
        place[number[i]] += 1
    size = 8
    while size < 3 * len(first):
        size *= 2
    keys, cells = np.full(size, EMPTY, dtype=np.int64), np.zeros(size, dtype=np.int32)
    for c in range(len(first)):
        slot = slot_of(voxels[first[c]], size - 1)
        while keys[slot] != EMPTY:
            slot = (slot + 1) & (size - 1)
        keys[slot] = voxels[first[c]]
        cells[slot] = c
    return order, starts, keys, cells


def cells_of(grid: Grid) -> Indices:
    """(N,) the number, from 0 to C - 1, of the voxel that each point lies in."""
    out = np.empty(len(grid.order), dtype=np.int64)
    out[grid.order] = np.repeat(np.arange(len(grid.starts) - 1), np.diff(grid.starts))
    return out


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def cell_of(key: int, keys: Indices, cells: NDArray[np.int32]) -> int:
    """The number, from 0 to C - 1, of the voxel with a key; -1 if no point lies in it."""
    mask = len(keys) - 1
    slot = slot_of(key, mask)
    while keys[slot] != EMPTY:
        if keys[slot] == key:
            return int(cells[slot])
        slot = (slot + 1) & mask
    return -1
