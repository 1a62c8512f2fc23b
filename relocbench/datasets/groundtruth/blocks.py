"""Points of a drive, piece by piece: what the lidar measured along each few metres of road, in the frame of its middle.

Odometry is good to millimetres within a piece; how pieces lie to each other is left to the pose graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Times = NDArray[np.int64]


class Surface(IntEnum):
    """What a point probably lies on, as far as its neighbours tell."""

    ROUGH = 0
    """leaves, wires, edges, noise: no plane fits"""
    GROUND = 1
    """flat and at the height of the wheels"""
    STRUCTURE = 2
    """plane, upright or high: facades, roofs, poles' sides, cars"""


@dataclass(frozen=True, eq=False)
class Nodes:
    """Where a drive was cut: the poses to which its blocks belong."""

    times_ns: Times
    """(K,)"""
    T_odom_node: Array
    """(K, 4, 4) rig poses at these times"""
    travelled_m: Array
    """(K,) metres driven up to each"""
    stretch: NDArray[np.int64] | None = None
    """(K,) number of the piece of odometry without a gap that each lies in; None: there is no gap"""

    def __len__(self) -> int:
        return len(self.times_ns)


@dataclass(frozen=True, eq=False)
class Block:
    """What was measured along one piece of road, thinned to one point a voxel."""

    points: NDArray[np.float32]
    """(N, 3) in the node's frame"""
    normals: NDArray[np.float32]
    """(N, 3) unit, towards the sensor; 0 where no plane fits"""
    origins: NDArray[np.float32]
    """(N, 3) where the sensor was when it measured each"""
    surface: NDArray[np.uint8]
    """(N,) :class:`Surface`"""
    steady: NDArray[np.float32]
    """(N,) in [0, 1]: 0 where other beams of the same drive went through the point, so that it moved"""

    def __len__(self) -> int:
        return len(self.points)
