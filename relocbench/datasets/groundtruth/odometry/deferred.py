"""Odometry that is computed from lidar later, after the inputs of all drives have been checked, and kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from relocbench.datasets.core.pairfile import pose_fields
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Trajectory
from relocbench.errors import DatasetError
from relocbench.files import atomic_write
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class Pending(Trajectory):
    """Stands in for odometry that is not computed yet: the times of the scans, without motion."""

    prior_of: Callable[[Trajectory], Trajectory | None] | None = None
    """the prior, if it is fitted to the odometry; None: the recording has the one that there is"""


def with_prior(motion: Trajectory, prior_of: Callable[[Trajectory], Trajectory | None]) -> Trajectory:
    """Odometry, and the way to the prior along with it if it is computed later."""
    return replace(motion, prior_of=prior_of) if isinstance(motion, Pending) else motion


def later(lidar: LidarStream, reporter: Reporter | None = None, /, *, max_gap_ns: int = 1_000_000_000) -> Trajectory:
    """A :class:`FromLidar` that computes nothing; :func:`computed` does."""
    times = lidar.times_ns
    return Pending(times, np.tile(np.eye(4), (len(times), 1, 1)), max_gap_ns)


def is_pending(recording: FieldRecording) -> bool:
    """Whether the odometry of a recording is to be computed yet."""
    return isinstance(recording.odometry, Pending)


def computed(recording: FieldRecording, from_lidar: FromLidar, reporter: Reporter) -> FieldRecording:
    """The recording with its odometry, computed from the lidar ``odometry_lidar``; itself if it has odometry.

    A prior that is fitted to the odometry is computed along with it.

    Raises:
        ConfigError, DatasetError: the odometry cannot be computed.
    """
    pending = recording.odometry
    if not isinstance(pending, Pending):
        return recording
    lidar = next(one for one in recording.lidars if one.name == recording.odometry_lidar)
    motion = from_lidar(lidar, reporter, max_gap_ns=pending.max_gap_ns)
    prior = recording.prior if pending.prior_of is None else pending.prior_of(motion)
    return replace(recording, odometry=motion, prior=prior)


def kept_in(path: Path) -> FromLidar:
    """A function that reads odometry from ``path``, or computes it and writes it there if the file does not exist.

    The file has one line ``timestamp_ns,tx,ty,tz,qx,qy,qz,qw`` for each scan: the pose of the rig in the frame of its
    first pose.
    """

    def odometry(
        lidar: LidarStream, reporter: Reporter | None = None, /, *, max_gap_ns: int = 1_000_000_000
    ) -> Trajectory:
        if not path.exists():
            _write(path, lidar_odometry(lidar, reporter, max_gap_ns=max_gap_ns))
        # Always use the file, so that a fresh build and a resumed one use the same numbers.
        poses = read_trajectory(path)
        if len(poses.times_ns) < 2 or not np.isin(poses.times_ns, lidar.times_ns).all():
            raise DatasetError(f"is not the odometry of the scans of {lidar.name}; remove it and build again", path)
        return Trajectory(poses.times_ns, poses.transforms, max_gap_ns, smooth=True)

    return odometry


def _write(path: Path, odometry: Trajectory) -> None:
    with atomic_write(path) as stream:
        stream.write("# timestamp_ns,tx,ty,tz,qx,qy,qz,qw\n")
        for time, pose in zip(odometry.times_ns.tolist(), odometry.T_odom_rig, strict=True):
            stream.write(f"{','.join([str(time), *pose_fields(pose)])}\n")
