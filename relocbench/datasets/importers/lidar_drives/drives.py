"""Drives as their files hold them, brought onto one map, with odometry from poses or from their lidar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.recording import MAX_GAP_NS, CameraStream, FieldRecording, LidarStream, Trajectory
from relocbench.errors import ConfigError, DatasetError, available
from relocbench.geometry import invert
from relocbench.progress import Reporter

_ONE_MAP_M = 100_000.0
"""drives that begin further apart do not state their positions in one map"""


@dataclass(frozen=True, eq=False)
class DriveFiles:
    """A drive before its odometry is known."""

    name: str
    folder: Path
    condition: Condition
    lidars: tuple[LidarStream, ...]
    poses: Trajectory | None
    """odometry by the dataset's poses; None: it is computed from a lidar"""
    poses_from: str = ""
    """where the poses are from, for messages"""
    cameras: Mapping[str, CameraStream] = field(default_factory=dict)
    prior: Trajectory | None = None
    """``T_map_rig`` in metres, in a map that drives may share; its coordinates may be large"""
    prior_sigma_m: float = 10.0
    location: str = ""
    max_gap_ns: int = MAX_GAP_NS
    """longest gap to interpolate over between poses that are computed from a lidar"""

    def with_times_only(self) -> FieldRecording:
        """The recording with the right times and no motion, which checks of options can be made on."""
        spinning = self.poses is None
        times = _between(self.lidars) if spinning else self.poses.times_ns  # type: ignore[union-attr]
        return self._recording(Trajectory(times, np.tile(np.eye(4), (len(times), 1, 1))))

    def recording(self, from_lidar: FromLidar, reporter: Reporter) -> FieldRecording:
        """The recording, with odometry by its poses or computed from its first spinning lidar.

        Raises:
            DatasetError: there are neither poses nor a spinning lidar, or the lidar's scans are damaged.
        """
        if self.poses is not None:
            reporter.note(f"{self.name}: odometry is {self.poses_from}")
            first = invert(self.poses.T_odom_rig[0])
            return self._recording(replace(self.poses, T_odom_rig=first @ self.poses.T_odom_rig))
        lidar = next((lidar for lidar in self.lidars if lidar.pattern == "spinning"), None)
        if lidar is None:
            raise DatasetError("has neither poses nor a spinning lidar to compute odometry from", self.folder)
        reporter.note(f"{self.name}: odometry is computed from the scans of {lidar.name}")
        return self._recording(from_lidar(lidar, reporter, max_gap_ns=self.max_gap_ns), lidar.name)

    def _recording(self, odometry: Trajectory, odometry_lidar: str = "") -> FieldRecording:
        return FieldRecording(
            name=self.name,
            folder=self.folder,
            condition=self.condition,
            odometry=odometry,
            lidars=self.lidars,
            cameras=self.cameras,
            prior=self.prior,
            prior_sigma_m=self.prior_sigma_m,
            location=self.location,
            odometry_lidar=odometry_lidar,
        )


def _between(lidars: Sequence[LidarStream]) -> Times:
    ends = [time for lidar in lidars for time in (int(lidar.times_ns[0]), int(lidar.times_ns[-1]))]
    return np.unique(np.array(ends, dtype=np.int64))


def on_one_map(drives: Sequence[DriveFiles], reporter: Reporter) -> list[DriveFiles]:
    """The drives with priors relative to one origin near the first of them, so that no digits are lost.

    Drives that state positions more than 100 km from it are on another map: they lose their prior, which is noted.
    """
    origin = next((_start(drive.prior) for drive in drives if drive.prior is not None), None)
    if origin is None:
        return list(drives)
    moved = []
    for drive in drives:
        prior = drive.prior
        if prior is not None and float(np.linalg.norm(_start(prior) - origin)) > _ONE_MAP_M:
            reporter.note(f"{drive.name}: its positions are in another map than those of the first drive; not used")
            prior = None
        elif prior is not None:
            T_map_rig = prior.T_odom_rig.copy()
            T_map_rig[:, :3, 3] -= origin
            prior = replace(prior, T_odom_rig=T_map_rig)
        moved.append(replace(drive, prior=prior))
    return moved


def _start(prior: Trajectory) -> Array:
    """(3,) corner of the cube of 1 km in which a drive begins."""
    return np.asarray(np.floor(prior.T_odom_rig[0, :3, 3] / 1000.0) * 1000.0)


def rig_trajectory(
    table: PoseTable,
    reporter: Reporter,
    T_body_rig: Array | None = None,
    max_gap_ns: int | None = None,
) -> Trajectory:
    """Poses of the rig from those of another body on it; default: the body is the rig.

    Outliers are left out, and nothing is interpolated over holes; other jumps are interrupted when the drives are
    registered.

    Args:
        max_gap_ns: longest gap between two poses to interpolate over, whether or not it is a hole of this drive;
            None: one second, and no hole.

    Raises:
        DatasetError: there are fewer than two poses, or they cannot be those of one drive.
    """
    table = plausible(table, reporter, jumps=False, holes=max_gap_ns is None)
    if len(table.times_ns) < 2:
        raise DatasetError(f"holds {len(table.times_ns)} poses; a trajectory has at least 2", table.path)
    T_map_body = table.transforms
    T_map_rig = T_map_body if T_body_rig is None else T_map_body @ T_body_rig
    return Trajectory(table.times_ns, T_map_rig, max_gap_ns or MAX_GAP_NS, table.breaks)


def chosen_of(wanted: Sequence[str] | None, known: Sequence[str], default: Sequence[str], what: str) -> list[str]:
    """The wanted sensors; None: the default ones.

    Args:
        what: the dataset and the kind of sensor that it has not, for messages.

    Raises:
        ConfigError: there is no such sensor.
    """
    for name in wanted or ():
        if name not in known:
            raise ConfigError(f"{what} '{name}'{available(name, known)}")
    return list(default if wanted is None else dict.fromkeys(wanted))
