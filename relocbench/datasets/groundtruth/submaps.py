"""Submaps: the blocks around a node, laid together along the odometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
    """(N,) :class:`relocbench.datasets.groundtruth.blocks.Surface`"""
    steady: NDArray[np.float32]
    """(N,) in [0, 1]"""
    block: NDArray[np.int32]
    """(N,) the block each came from"""

    def __len__(self) -> int:
        return len(self.points)
