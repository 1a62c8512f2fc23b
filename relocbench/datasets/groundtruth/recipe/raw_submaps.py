"""Raw submaps: all points that the lidars of a drive measured along a stretch of road, put together along the odometry.

Unlike the submaps of blocks they are made anew around every image, and keep moving things and all points of a voxel.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.deskewing import BeamReader
from relocbench.datasets.groundtruth.blocks.making import BlockOptions
from relocbench.datasets.groundtruth.blocks.nodes import arc_length_along
from relocbench.datasets.sensors.recording import FieldRecording


class RawSubmaps:
    """The raw submaps of one drive, around any time of it."""

    def __init__(self, recording: FieldRecording, length_m: float) -> None:
        """
        Args:
            length_m: metres of road of a submap.

        Raises:
            DatasetError: odometry and lidars have no time in common.
        """
        options = BlockOptions()
        self._odometry = recording.odometry
        self._half_m = length_m / 2
        self._way = arc_length_along(recording)
        self._reader = BeamReader(recording, self._way, options.min_range_m, options.max_range_m, options.min_step_m)

    def around(self, time_ns: int) -> Array:
        """(N, 3) points in the frame of the rig at a time that the odometry covers.

        Raises:
            DatasetError: a scan is damaged.
        """
        begin, end = self.span(time_ns)
        at = np.array([time_ns], dtype=np.int64)
        return np.asarray(self._reader.between(begin, end, self._odometry.at(at)[0]).points)

    def span(self, time_ns: int) -> tuple[int, int]:
        """First time and end, exclusive, of the stretch of road, within the segment of the odometry."""
        times, way = self._way.times_ns, self._way.travelled_m
        here = int(np.clip(np.searchsorted(times, time_ns, side="right") - 1, 0, len(times) - 1))
        mine = self._way.segment == self._way.segment[here]
        at = self._way.at(np.array([time_ns], dtype=np.int64))[0]
        inside = times[mine & (np.abs(way - at) <= self._half_m)]
        if not len(inside):
            return time_ns, time_ns + 1
        return int(min(inside[0], time_ns)), int(max(inside[-1], time_ns)) + 1
