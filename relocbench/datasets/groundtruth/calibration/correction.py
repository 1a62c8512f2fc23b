"""Recordings with their lidars' calibration corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.groundtruth.calibration.unknowns import SIZE, Sensors
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Scan
from relocbench.geometry import se3_exp


@dataclass(frozen=True, eq=False)
class CorrectedLidar:
    """A lidar whose clock or extrinsics were in error."""

    stream: LidarStream
    late_ns: int
    """by how much its times are too large"""
    T_right_given: Array
    """(4, 4) correction of the extrinsics, in the rig's frame"""

    @property
    def name(self) -> str:
        return self.stream.name

    @property
    def pattern(self) -> Literal["push-broom", "spinning"]:
        return self.stream.pattern

    @property
    def T_rig_lidar(self) -> Array:
        return np.asarray(self.T_right_given @ self.stream.T_rig_lidar)

    @property
    def times_ns(self) -> Times:
        return self.stream.times_ns - self.late_ns

    @property
    def max_range_m(self) -> float:
        return self.stream.max_range_m

    @property
    def sigma_m(self) -> float:
        return self.stream.sigma_m

    def read(self, index: int) -> Scan:
        """Read a scan. Raises DatasetError with the file if it is missing or damaged."""
        scan = self.stream.read(index)
        return Scan(scan.points, scan.times_ns - self.late_ns)


def corrected(recording: FieldRecording, sensors: Sensors, errors: Array) -> FieldRecording:
    """The recording with the errors (K,) of its lidars removed."""
    lidars = []
    for k, lidar in enumerate(recording.lidars):
        first = SIZE * sensors.number(recording.name, k)
        own = errors[first : first + SIZE]
        lidars.append(CorrectedLidar(lidar, round(float(own[6]) * 1e9), se3_exp(own[:6])) if own.any() else lidar)
    return replace(recording, lidars=tuple(lidars))
