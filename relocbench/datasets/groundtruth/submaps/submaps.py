"""Submaps: the blocks around a node, put together along the odometry, in a window that slides from node to node.

Where several blocks have points in the same voxel, those of the block that saw it from nearest are kept. The cost of a
step is that of the blocks that enter and leave, and of transforming the others into the next node's frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.voxels.claims import VoxelClaims
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys
from relocbench.geometry import apply, invert


@dataclass(frozen=True, eq=False)
class Submap(Block):
    """Points around one node, in that node's frame: those of several blocks, end to end."""

    block: NDArray[np.int32]
    """(N,) number of the block that each point came from"""


class SubmapWindow:
    """Puts together the submap of one node after another. The result does not depend on the order of the nodes."""

    def __init__(
        self,
        nodes: Nodes,
        store: BlockStore,
        half_length_m: float = 30.0,
        *,
        voxel_m: float = 0.1,
    ) -> None:
        """
        Args:
            half_length_m: length of road on either side of the node, within its segment of the odometry.
            voxel_m: size of the voxels in which only the points of one block are kept; 0: all points are kept.
        """
        self._nodes = nodes
        self._store = store
        self._half_length_m = half_length_m
        self._voxel_m = voxel_m
        self._poses = nodes.T_odom_node
        self._segment = nodes.segments()
        self._claims = VoxelClaims()
        self._inside: dict[int, Block] = {}

    def stretched(self, factor: float) -> SubmapWindow:
        """Submaps of the same blocks along odometry that is ``factor`` times as long."""
        return SubmapWindow(self._nodes.stretched(factor), self._store, self._half_length_m, voxel_m=self._voxel_m)

    def blocks_around(self, node: int) -> range:
        """The numbers of the blocks of a node's submap. Raises IndexError if there is no such node."""
        if not 0 <= node < len(self._nodes):
            raise IndexError(f"no node {node}; there are {len(self._nodes)}")
        travelled = self._nodes.travelled_m
        near = (np.abs(travelled - travelled[node]) <= self._half_length_m) & (self._segment == self._segment[node])
        inside = np.flatnonzero(near)
        return range(int(inside[0]), int(inside[-1]) + 1)

    def at(self, node: int) -> Submap:
        """The submap around a node, in its frame. Raises DatasetError if a block is missing or damaged."""
        wanted = self.blocks_around(node)
        for block in [b for b in self._inside if b not in wanted]:
            self._leave(block)
        for block in wanted:
            if block not in self._inside:
                self._enter(block)
        T_node_odom = invert(self._poses[node])
        parts = [self._part(block, T_node_odom @ self._poses[block]) for block in wanted]
        numbers = np.repeat(np.array(wanted, dtype=np.int32), [len(part[0]) for part in parts])
        points, normals, origins, surface, steady = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return Submap(points, normals, origins, surface, steady, numbers)

    def _enter(self, number: int) -> None:
        block = self._store.get(number)
        self._inside[number] = block
        if self._voxel_m > 0:
            keys = voxel_keys(apply(self._poses[number], block.points.astype(np.float64)), self._voxel_m)
            self._claims.enter(number, keys, np.linalg.norm(block.points - block.origins, axis=1))

    def _leave(self, number: int) -> None:
        self._inside.pop(number)
        if self._voxel_m > 0:
            self._claims.leave(number)

    def _part(self, number: int, T_node_block: Array) -> tuple[NDArray[Any], ...]:
        block = self._inside[number]
        keep = self._claims.winning(number) if self._voxel_m > 0 else slice(None)
        rotation, shift = T_node_block[:3, :3].T.astype(np.float32), T_node_block[:3, 3].astype(np.float32)
        return (
            block.points[keep] @ rotation + shift,
            block.normals[keep] @ rotation,
            block.origins[keep] @ rotation + shift,
            block.surface[keep],
            block.steady[keep],
        )
