"""Odometry computed from lidar, kept on disk because computing it takes long."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.datasets.core.pairfile import pose_fields
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.sensors.recording import LidarStream, Trajectory
from relocbench.datasets.sensors.trajectories import read_trajectory
from relocbench.errors import DatasetError
from relocbench.files import atomic_write
from relocbench.progress import Reporter


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
        times = np.array(list(poses), dtype=np.int64)
        if len(times) < 2 or not np.isin(times, lidar.times_ns).all():
            raise DatasetError(f"is not the odometry of the scans of {lidar.name}; remove it and build again", path)
        return Trajectory(times, np.array(list(poses.values())), max_gap_ns, smooth=True)

    return odometry


def _write(path: Path, odometry: Trajectory) -> None:
    with atomic_write(path) as stream:
        stream.write("# timestamp_ns,tx,ty,tz,qx,qy,qz,qw\n")
        for time, pose in zip(odometry.times_ns.tolist(), odometry.T_odom_rig, strict=True):
            stream.write(f"{','.join([str(time), *pose_fields(pose)])}\n")
