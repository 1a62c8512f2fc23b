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
    segment: NDArray[np.int64] | None = None
    """(K,) number of the piece of odometry without a gap that each lies in; None: there is no gap"""
    begin_ns: Times | None = None
    """(K,) beams fired from here on belong to the node's block; None: from half-way to the node before"""
    end_ns: Times | None = None
    """(K,) up to here, itself left out"""

    def __len__(self) -> int:
        return len(self.times_ns)

    def segments(self) -> NDArray[np.int64]:
        """(K,) ``stretch``, 0 if there is no gap."""
        return np.zeros(len(self), dtype=np.int64) if self.segment is None else self.segment

    def begins_and_ends(self) -> tuple[Times, Times]:
        """(K,), (K,) times from which and up to which beams belong to each block."""
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
