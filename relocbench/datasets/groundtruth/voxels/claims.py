"""Which of several blocks shows each voxel best, kept up to date while blocks are added and removed.

A block claims the voxels in which it has points, each with a rank. The lowest rank wins; between equal ranks the lower
block number does. Adding or removing a claim only looks at the other claims on the same voxel.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats, Indices, Mask
from relocbench.datasets.groundtruth.voxels.voxels import EMPTY, distinct_keys, slot_of
from relocbench.kernels import njit

_NONE = -1


class VoxelClaims:
    """Claims of blocks on voxels. The winners do not depend on the order in which the blocks were added."""

    def __init__(self) -> None:
        self._keys = np.full(1024, EMPTY, dtype=np.int64)
        self._heads = np.full(1024, _NONE, dtype=np.int64)
        self._used = 0
        """number of slots of the table that are taken, including those whose claims were all removed"""
        self._next = np.full(1024, _NONE, dtype=np.int64)
        self._owner = np.zeros(1024, dtype=np.int64)
        self._rank = np.zeros(1024, dtype=np.float32)
        self._wins = np.zeros(1024, dtype=np.bool_)
        self._free = np.arange(1024)
        self._blocks: dict[int, tuple[Indices, Indices, Indices]] = {}

    def enter(self, block: int, keys: Indices, ranks: Floats) -> None:
        """Add a block with the voxels (N,) of its points and their ranks (N,); a voxel gets the lowest rank in it."""
        inverse, first = distinct_keys(keys)
        voxels, best = keys[first], np.full(len(first), np.inf, dtype=np.float32)
        np.minimum.at(best, inverse, ranks)
        self._make_room(len(voxels))
        mine, self._free = self._free[: len(voxels)], self._free[len(voxels) :]
        self._owner[mine] = block
        self._rank[mine] = best
        self._used += _enter(voxels, mine, self._keys, self._heads, self._next, self._owner, self._rank, self._wins)
        self._blocks[block] = (voxels, mine, inverse)

    def leave(self, block: int) -> None:
        """Remove a block and its claims."""
        voxels, mine, _ = self._blocks.pop(block)
        _leave(voxels, mine, self._keys, self._heads, self._next, self._owner, self._rank, self._wins)
        self._free = np.concatenate([self._free, mine])

    def winning(self, block: int) -> Mask:
        """(N,) whether the block wins the voxel of each of its points."""
        _, mine, inverse = self._blocks[block]
        return self._wins[mine][inverse]

    def _make_room(self, count: int) -> None:
        short = count - len(self._free)
        if short > 0:
            more = max(short, len(self._next))
            self._free = np.concatenate([self._free, np.arange(len(self._next), len(self._next) + more)])
            self._next = np.append(self._next, np.full(more, _NONE, dtype=np.int64))
            self._owner = np.append(self._owner, np.zeros(more, dtype=np.int64))
            self._rank = np.append(self._rank, np.zeros(more, dtype=np.float32))
            self._wins = np.append(self._wins, np.zeros(more, dtype=np.bool_))
        if 2 * (self._used + count) > len(self._keys):
            live = self._heads != _NONE
            size = len(self._keys)
            while 3 * (int(live.sum()) + count) > size:
                size *= 2
            self._keys, self._heads = _moved(self._keys[live], self._heads[live], size)
            self._used = int(live.sum())


@njit(cache=True, nogil=True, error_model="numpy")
def _moved(keys: Indices, heads: Indices, size: int) -> tuple[Indices, Indices]:
    table, first = np.full(size, EMPTY, dtype=np.int64), np.full(size, _NONE, dtype=np.int64)
    for i in range(len(keys)):
        slot = _slot(keys[i], table)
        table[slot] = keys[i]
        first[slot] = heads[i]
    return table, first


@njit(cache=True, nogil=True, error_model="numpy")
def _slot(key: int, table: Indices) -> int:
    mask = len(table) - 1
    slot = slot_of(key, mask)
    while table[slot] != EMPTY and table[slot] != key:
        slot = (slot + 1) & mask
    return int(slot)


@njit(cache=True, nogil=True, error_model="numpy")
def _judge(head: int, following: Indices, owner: Indices, rank: Floats, wins: Mask) -> None:
    best = head
    claim = head
    while claim != _NONE:
        wins[claim] = False
        if rank[claim] < rank[best] or (rank[claim] == rank[best] and owner[claim] < owner[best]):
            best = claim
        claim = following[claim]
    if best != _NONE:
        wins[best] = True


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(
    voxels: Indices, claims: Indices, keys: Indices, heads: Indices, following: Indices, owner: Indices,
    rank: Floats, wins: Mask,
) -> int:  # fmt: skip
    """Link new claims and find the winners anew. Returns how many slots of the table became taken."""
    taken = 0
    for i in range(len(voxels)):
        slot = _slot(voxels[i], keys)
        if keys[slot] == EMPTY:
            keys[slot] = voxels[i]
            taken += 1
        following[claims[i]] = heads[slot]
        heads[slot] = claims[i]
        _judge(heads[slot], following, owner, rank, wins)
    return taken


@njit(cache=True, nogil=True, error_model="numpy")
def _leave(
    voxels: Indices, claims: Indices, keys: Indices, heads: Indices, following: Indices, owner: Indices,
    rank: Floats, wins: Mask,
) -> None:  # fmt: skip
    for i in range(len(voxels)):
        slot = _slot(voxels[i], keys)
        if heads[slot] == claims[i]:
            heads[slot] = following[claims[i]]
        else:
            before = heads[slot]
            while following[before] != claims[i]:
                before = following[before]
            following[before] = following[claims[i]]
        _judge(heads[slot], following, owner, rank, wins)
