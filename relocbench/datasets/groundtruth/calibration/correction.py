"""Recordings with their lidars' calibration corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.groundtruth.calibration.unknowns import SIZE, Sensors
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import FieldRecording, Scan
from relocbench.geometry import se3_exp


@dataclass(frozen=True, eq=False)
class CorrectedLidar(DerivedLidar):
    """A lidar whose clock or extrinsics were in error."""

    late_ns: int
    """by how much its times are too large"""
    T_right_given: Array
    """(4, 4) correction of the extrinsics, in the rig's frame"""

    @property
    def T_rig_lidar(self) -> Array:
        return np.asarray(self.T_right_given @ self.stream.T_rig_lidar)

    @property
    def times_ns(self) -> Times:
        return self.stream.times_ns - self.late_ns

    def read(self, index: int) -> Scan:
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
