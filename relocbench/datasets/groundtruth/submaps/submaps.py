"""Submaps: the blocks around a node, laid together along the odometry, sliding from node to node.

Where several blocks show the same voxel, the one that saw it from nearest stays. A step costs what enters and leaves,
and moving the points that stay into the next node's frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.voxels.claims import VoxelClaims
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys
from relocbench.geometry import apply, invert

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Submap:
    """Points around one node, in that node's frame; the arrays are those of :class:`Block`, laid end to end."""

    node: int
    points: NDArray[np.float32]
    """(N, 3)"""
    normals: NDArray[np.float32]
    """(N, 3) unit, towards the sensor; 0 where no plane fits"""
    origins: NDArray[np.float32]
    """(N, 3) where the sensor was"""
    surface: NDArray[np.uint8]
    """(N,) :class:`relocbench.datasets.groundtruth.blocks.blocks.Surface`"""
    steady: NDArray[np.float32]
    """(N,) in [0, 1]"""
    block: NDArray[np.int32]
    """(N,) the block each came from"""

    def __len__(self) -> int:
        return len(self.points)


class SubmapWindow:
    """The submap of one node after another. It may go forward, backward or anywhere: the result is the same."""

    def __init__(
        self,
        nodes: Nodes,
        store: BlockStore,
        half_length_m: float = 30.0,
        *,
        voxel_m: float = 0.1,
        T_odom_node: Array | None = None,
    ) -> None:
        """
        Args:
            half_length_m: way to both sides of the node, within its stretch of odometry.
            voxel_m: where several blocks have points, those of one stay; 0: all stay.
            T_odom_node: (K, 4, 4) better poses than the odometry's, in any one frame.
        """
        self._nodes = nodes
        self._store = store
        self._half_length_m = half_length_m
        self._voxel_m = voxel_m
        self._poses = nodes.T_odom_node if T_odom_node is None else np.asarray(T_odom_node, dtype=np.float64)
        self._stretch = nodes.segments()
        self._claims = VoxelClaims()
        self._inside: dict[int, Block] = {}
        self.work = 0
        """points of blocks that entered or left so far"""

    @property
    def claims_changed(self) -> int:
        """Claims of blocks on voxels that came or went so far."""
        return self._claims.work

    def blocks_around(self, node: int) -> range:
        """The blocks of a node's submap. Raises IndexError if there is no such node."""
        if not 0 <= node < len(self._nodes):
            raise IndexError(f"no node {node}; there are {len(self._nodes)}")
        travelled = self._nodes.travelled_m
        near = (np.abs(travelled - travelled[node]) <= self._half_length_m) & (self._stretch == self._stretch[node])
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
        points, normals, origins, surface, steady = (np.concatenate([part[i] for part in parts]) for i in range(5))
        numbers = np.repeat(np.array(wanted, dtype=np.int32), [len(part[0]) for part in parts])
        return Submap(node, points, normals, origins, surface, steady, numbers)

    def _enter(self, number: int) -> None:
        block = self._store.get(number)
        self._inside[number] = block
        self.work += len(block)
        if self._voxel_m > 0:
            keys = voxel_keys(apply(self._poses[number], block.points.astype(np.float64)), self._voxel_m)
            self._claims.enter(number, keys, np.linalg.norm(block.points - block.origins, axis=1))

    def _leave(self, number: int) -> None:
        self.work += len(self._inside.pop(number))
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
