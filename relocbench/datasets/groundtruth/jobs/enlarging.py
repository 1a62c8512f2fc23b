"""Recordings in enlarged metres, in which a small scene has the size of a street.

Enlarged are the points, the lidars' poses on the rig, the odometry and the prior. Cameras are left out: images are
asked of the recording as it is, and their poses on the rig are enlarged where they meet the drives. See
:mod:`relocbench.datasets.groundtruth.registration.scene_scale`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.odometry.deferred import Pending
from relocbench.datasets.groundtruth.registration.scene_scale import scaled
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import FieldRecording, Scan, Trajectory

PriorOf = Callable[[Trajectory], Trajectory | None]


@dataclass(frozen=True, eq=False)
class EnlargedLidar(DerivedLidar):
    """A lidar whose metres are enlarged."""

    factor: float

    @property
    def T_rig_lidar(self) -> Array:
        return scaled(self.stream.T_rig_lidar, self.factor)

    @property
    def max_range_m(self) -> float:
        return self.stream.max_range_m * self.factor

    @property
    def sigma_m(self) -> float:
        return self.stream.sigma_m * self.factor

    def read(self, index: int) -> Scan:
        scan = self.stream.read(index)
        return Scan(scan.points * self.factor, scan.times_ns)


def enlarged(recording: FieldRecording, factor: float) -> FieldRecording:
    """The recording in enlarged metres, without cameras; itself if the factor is 1."""
    if factor == 1.0:
        return recording
    odometry = scaled_trajectory(recording.odometry, factor)
    if isinstance(odometry, Pending) and odometry.prior_of is not None:
        odometry = replace(odometry, prior_of=_of_enlarged(odometry.prior_of, factor))
    return replace(
        recording,
        odometry=odometry,
        lidars=tuple(EnlargedLidar(lidar, factor) for lidar in recording.lidars),
        cameras={},
        prior=None if recording.prior is None else scaled_trajectory(recording.prior, factor),
        prior_sigma_m=recording.prior_sigma_m * factor,
    )


def in_metres(recording: FieldRecording, large: FieldRecording, factor: float) -> FieldRecording:
    """The recording with odometry and prior of the same one in enlarged metres, which were computed from its scans."""
    if factor == 1.0:
        return large
    prior = None if large.prior is None else scaled_trajectory(large.prior, 1 / factor)
    return replace(recording, odometry=scaled_trajectory(large.odometry, 1 / factor), prior=prior)


def _of_enlarged(prior_of: PriorOf, factor: float) -> PriorOf:
    """The enlarged prior that is fitted to enlarged odometry."""

    def fitted(motion: Trajectory) -> Trajectory | None:
        prior = prior_of(scaled_trajectory(motion, 1 / factor))
        return None if prior is None else scaled_trajectory(prior, factor)

    return fitted


def scaled_trajectory(trajectory: Trajectory, factor: float) -> Trajectory:
    """A trajectory whose positions are multiplied by a factor; it stays of its class."""
    return replace(trajectory, T_odom_rig=scaled(trajectory.T_odom_rig, factor))
