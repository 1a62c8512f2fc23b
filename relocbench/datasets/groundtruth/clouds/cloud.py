"""A point cloud as one side of a registration, and from where it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.cloud_files import CloudFile
from relocbench.errors import DatasetError

SensorChoice = Literal["auto", "origin", "unknown"]
_FEWEST = 200


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in one frame, and from where they were measured."""

    name: str
    points: Array
    """(N, 3) metres"""
    sensors: Array | None = None
    """(N, 3) position of the sensor that measured each point; None: unknown"""
    supposed: bool = False
    """whether ``sensors`` are supposed and have to be checked against the points"""
    normals: Array | None = None
    """(N, 3) normals of any length; None: unknown"""
    origin: Array | None = None
    """(3,) subtracted from the coordinates of the file; None: nothing was"""
    drifts: bool = False
    """whether the points were put together by odometry, whose errors grow with the distance"""

    def __len__(self) -> int:
        return len(self.points)


def cloud_of_file(file: CloudFile, choice: SensorChoice = "auto") -> Cloud:
    """The cloud of a file.

    Args:
        choice: whether the sensor was at the origin of the coordinates; ``auto`` supposes so unless the coordinates are
            those of a map. Positions that the file states are used in any case but ``unknown``.

    Raises:
        DatasetError: there are too few points.
    """
    if len(file.points) < _FEWEST:
        raise DatasetError(f"has {len(file.points)} points; registration needs at least {_FEWEST}", file.path)
    sensors, supposed = file.sensors, False
    if choice == "unknown":
        sensors = None
    elif choice == "origin":
        sensors = np.broadcast_to(-file.origin, file.points.shape)
    elif sensors is None and not file.origin.any():
        sensors, supposed = np.zeros_like(file.points), True
    origin = file.origin if file.origin.any() else None
    return Cloud(file.path.name, file.points, sensors, supposed, file.normals, origin)
