"""Blocks: the points that the lidar measured along each few metres of road, in the frame of the block's node.

Odometry is good to millimetres within a block; the poses of blocks relative to each other are left to the pose graph.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from relocbench.arrays import Array, Bytes, Floats, Indices, Times


class Surface(IntEnum):
    """The kind of surface that a point probably lies on, judged by its neighbours."""

    ROUGH = 0
    """no plane fits: leaves, wires, edges, noise"""
    GROUND = 1
    """a level plane at the height of the wheels"""
    STRUCTURE = 2
    """any other plane: facades, roofs, sides of poles, cars"""


@dataclass(frozen=True, eq=False)
class Nodes:
    """The K nodes of a drive: the poses, at equal distances along the road, in whose frames its blocks are given."""

    times_ns: Times
    """(K,)"""
    T_odom_node: Array
    """(K, 4, 4) pose of the rig at each node, by the odometry"""
    travelled_m: Array
    """(K,) arc length: metres driven up to each node"""
    segment: Indices | None = None
    """(K,) number of the segment, a part of the odometry without a gap, that each node lies in; None: one segment"""
    begin_ns: Times | None = None
    """(K,) when each block begins; None: half-way between nodes"""
    end_ns: Times | None = None
    """(K,) when each block ends, exclusive"""

    def __len__(self) -> int:
        return len(self.times_ns)

    def stretched(self, factor: float) -> Nodes:
        """The nodes of odometry that is ``factor`` times as long."""
        T = self.T_odom_node.copy()
        T[:, :3, 3] *= factor
        return replace(self, T_odom_node=T, travelled_m=self.travelled_m * factor)

    def segments(self) -> Indices:
        """(K,) number of the segment that each node lies in."""
        return np.zeros(len(self), dtype=np.int64) if self.segment is None else self.segment

    def begins_and_ends(self) -> tuple[Times, Times]:
        """(K,), (K,) when each block begins, and when it ends, exclusive; beams fired in between belong to it."""
        if self.begin_ns is not None and self.end_ns is not None:
            return self.begin_ns, self.end_ns
        times = self.times_ns
        if len(times) < 2:
            return times - 500_000_000, times + 500_000_000
        middle = times[:-1] + np.diff(times) // 2
        begin = np.append(2 * times[0] - middle[0], middle)
        return begin, np.append(middle, 2 * times[-1] - middle[-1])


@dataclass(frozen=True, eq=False)
class Block:
    """The points measured along one piece of road, thinned to one point a voxel."""

    points: Floats
    """(N, 3) in the node's frame"""
    normals: Floats
    """(N, 3) unit vectors towards the sensor; 0 where no plane fits"""
    origins: Floats
    """(N, 3) position of the sensor when it measured each point"""
    surface: Bytes
    """(N,) :class:`Surface`"""
    steady: Floats
    """(N,) static score in [0, 1]: 1 for a static point, 0 for a dynamic one, through which other beams went"""
    lidar: Bytes | None = field(default=None, kw_only=True)
    """(N,) number of the lidar that measured each point, in the order of the recording; None: there is one"""

    def __len__(self) -> int:
        return len(self.points)
