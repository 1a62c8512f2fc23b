"""Odometry from a spinning lidar: KISS-ICP estimates each step, and a fit to planes makes it precise.

Vizzo et al., KISS-ICP: In Defense of Point-to-Point ICP, RA-L 2023.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.odometry.local_map import LocalMap
from relocbench.datasets.sensors.recording import LidarStream, Scan, Trajectory
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import apply, invert, make_transform, project_to_rotation, se3_exp, se3_log
from relocbench.progress import Advance, Reporter, Silent

_NEAREST_M = 3.0
"""points nearer than this are left out, since they belong to the car itself"""
_FEWEST_POINTS = 100
"""a scan with fewer points is skipped"""
_START_SCANS = 4
"""the speed at the start is estimated from so many scans"""
_PASSES = 2
"""extra registration passes over motion-distorted scans; each deskews by what the one before left over"""
_SLICES = 64
"""the motion during a scan is computed at the borders of so many slices; points are interpolated between them"""


class FromLidar(Protocol):
    """A function that returns the odometry of a lidar, such as :func:`lidar_odometry` or one that caches its result."""

    def __call__(
        self, lidar: LidarStream, reporter: Reporter | None = None, /, *, max_gap_ns: int = 1_000_000_000
    ) -> Trajectory: ...


def lidar_odometry(
    lidar: LidarStream,
    reporter: Reporter | None = None,
    *,
    max_gap_ns: int = 1_000_000_000,
) -> Trajectory:
    """The poses of the rig at the times of the scans, in the frame of the first pose.

    Scans are deskewed with the velocity of the previous step, as in KISS-ICP; scans need not be equally spaced in time.
    Scans that the motion distorts are then registered anew, deskewed by the motion before and after each of them.
    Between scans the motion is smooth.
    The computation uses one thread, so that the same scans give the same bytes.

    Args:
        max_gap_ns: the trajectory is interrupted where two scans are further apart in time than this.

    Raises:
        ConfigError: the lidar does not spin; the single planes of a push-broom lidar cannot be registered.
        DatasetError: a scan is damaged, or fewer than two scans have enough points.
    """
    if lidar.pattern != "spinning":
        raise ConfigError(f"odometry from lidar needs a spinning lidar; {lidar.name} is {lidar.pattern}")
    times = lidar.times_ns
    started = _Registration(lidar)
    if _is_skewed(lidar.read(0)):
        # Deskewing the first scan needs a velocity: a rough one comes from registering some scans without deskewing.
        for i in range(min(_START_SCANS, len(times))):
            started.add(int(times[i]), lidar.read(i))
    run = _Registration(lidar, started.twist)
    skewed = False
    with (reporter or Silent()).stage(f"odometry from {lidar.name}", len(times)) as advance:
        for i, time in enumerate(times.tolist()):
            scan = lidar.read(i)
            run.add(time, scan)
            skewed = skewed or _is_skewed(scan)
            advance(1)
    missing = sorted(set(times.tolist()) - set(run.times))
    if missing:
        message = f"{len(missing)} of {len(times)} scans have fewer than {_FEWEST_POINTS} points and are left out"
        (reporter or Silent()).note(f"{lidar.name}: {message}, the first at {missing[0]} ns")
    if len(run.times) < 2:
        raise DatasetError(f"{lidar.name} has {len(run.times)} scans with enough points; odometry needs at least 2")
    T_first_lidar = np.array(run.poses)
    if skewed:
        title = f"odometry from {lidar.name}, once more"
        with (reporter or Silent()).stage(title, _PASSES * len(run.times)) as advance:
            for _ in range(_PASSES):
                T_first_lidar = _once_more(lidar, run.times, T_first_lidar, max_gap_ns, advance)
    T_first_lidar = make_transform(project_to_rotation(T_first_lidar[:, :3, :3]), T_first_lidar[:, :3, 3])
    T_odom_rig = lidar.T_rig_lidar @ invert(T_first_lidar[0]) @ T_first_lidar @ invert(lidar.T_rig_lidar)
    return Trajectory(np.array(run.times, dtype=np.int64), T_odom_rig, max_gap_ns, smooth=True)


def _once_more(lidar: LidarStream, times: list[int], T_first_lidar: Array, max_gap_ns: int, advance: Advance) -> Array:
    """Poses (N, 4, 4) of scans, registered again from known poses (N, 4, 4), by which they are deskewed.

    A velocity from before a scan knows nothing of how the car brakes, turns and sways during the scan.
    """
    index = {int(time): i for i, time in enumerate(lidar.times_ns.tolist())}
    known = Trajectory(np.array(times, dtype=np.int64), T_first_lidar, max_gap_ns, smooth=True)
    planes, poses = LocalMap(), [T_first_lidar[0]]
    for k, time in enumerate(times):
        points = _deskewed_by(lidar.read(index[time]), known, k)
        outside = points[np.sum(points**2, axis=1) >= _NEAREST_M**2]
        if k:
            poses.append(planes.fit(outside, poses[-1] @ invert(T_first_lidar[k - 1]) @ T_first_lidar[k]))
        planes.insert(outside, poses[k])
        advance(1)
    return np.array(poses)


def _deskewed_by(scan: Scan, known: Trajectory, k: int) -> Array:
    """(N, 3) points of scan k as seen from its pose, moved along the poses of all scans.

    Before the first and after the last pose, and across gaps, the motion goes on as it was.
    """
    if not _is_skewed(scan):
        return scan.points
    times, poses = known.times_ns, known.T_odom_rig
    offsets = (scan.times_ns - times[k]).astype(np.float64)
    knots = np.linspace(offsets.min(), offsets.max(), _SLICES + 1)
    at = times[k] + np.rint(knots).astype(np.int64)
    right = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    left = right - 1
    share = (at - times[left]) / (times[right] - times[left])
    steps = se3_log(invert(poses[left]) @ poses[right])
    moves = poses[left] @ se3_exp(share[:, None] * steps)
    inside = known.covers(at)
    moves[inside] = known.at(at[inside])
    return _placed(scan.points, offsets, knots, invert(poses[k]) @ moves)


class _Registration:
    """Registers one scan after another against a local map of the scans before."""

    def __init__(self, lidar: LidarStream, twist: Array | None = None) -> None:
        self._icp = _kiss_icp(lidar.max_range_m)
        self._planes = LocalMap()
        self.twist = np.zeros(6) if twist is None else twist
        """(6,) velocity: twist per nanosecond"""
        self.times: list[int] = []
        self.poses: list[Array] = []

    def add(self, time_ns: int, scan: Scan) -> None:
        """Register a scan, unless it has too few points away from the car."""
        if len(scan.points) < _FEWEST_POINTS:
            return
        elapsed = time_ns - self.times[-1] if self.times else 0
        self._icp.last_delta = se3_exp(self.twist * elapsed)
        points = deskewed(scan, time_ns, self.twist)
        outside = points[np.sum(points**2, axis=1) >= _NEAREST_M**2]
        if len(outside) < _FEWEST_POINTS:
            return
        self._icp.register_frame(points, np.empty(0))
        pose = np.eye(4)
        if self.times:
            pose = self._planes.fit(outside, self.poses[-1] @ self._icp.last_delta)
            self.twist = se3_log(invert(self.poses[-1]) @ pose) / elapsed
        self._planes.insert(outside, pose)
        self.times.append(time_ns)
        self.poses.append(pose)


def deskewed(scan: Scan, time_ns: int, twist: Array) -> Array:
    """(N, 3) points of a scan as seen from the lidar's pose at ``time_ns``, assuming constant velocity.

    Args:
        twist: (6,) velocity of the lidar in its own frame: twist per nanosecond.
    """
    offsets = (scan.times_ns - time_ns).astype(np.float64)
    if not len(offsets) or not _is_skewed(scan):
        return scan.points
    knots = np.linspace(offsets.min(), offsets.max(), _SLICES + 1)
    return _placed(scan.points, offsets, knots, se3_exp(twist * knots[:, None]))


def _placed(points: Array, offsets: Array, knots: Array, moves: Array) -> Array:
    """(N, 3) points moved by poses (S + 1, 4, 4) at equally spaced knots (S + 1,), interpolated at offsets (N,)."""
    left = np.clip(np.searchsorted(knots, offsets, side="right") - 1, 0, _SLICES - 1)
    fraction = ((offsets - knots[left]) / (knots[1] - knots[0]))[:, None]
    at = points[:, None, :]
    return np.asarray(apply(moves[left], at)[:, 0] * (1 - fraction) + apply(moves[left + 1], at)[:, 0] * fraction)


def _is_skewed(scan: Scan) -> bool:
    return bool(len(scan.times_ns)) and bool(np.ptp(scan.times_ns) > 0)


def _kiss_icp(farthest_m: float) -> Any:
    """KISS-ICP with every setting given, so that environment variables cannot change any."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import AdaptiveThresholdConfig, DataConfig, MappingConfig, RegistrationConfig
    from kiss_icp.kiss_icp import KissICP

    reach = min(farthest_m, 100.0)
    return KissICP(
        KISSConfig(
            out_dir="",
            data=DataConfig(max_range=reach, min_range=_NEAREST_M, deskew=False),
            mapping=MappingConfig(voxel_size=reach / 100.0, max_points_per_voxel=20),
            registration=RegistrationConfig(max_num_iterations=500, convergence_criterion=1e-4, max_num_threads=1),
            adaptive_threshold=AdaptiveThresholdConfig(fixed_threshold=None, initial_threshold=2.0, min_motion_th=0.1),
        )
    )
