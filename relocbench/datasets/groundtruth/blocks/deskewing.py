"""Deskewing: each beam of a moving lidar is placed by the lidar's pose at the time when it was fired."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Bytes, Indices, Mask, Times
from relocbench.datasets.groundtruth.blocks.nodes import ArcLength
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Trajectory
from relocbench.geometry import invert, so3_log
from relocbench.kernels import njit

_KEPT_SCANS = 8
"""of each lidar, so that a scan which two blocks share is read once"""


class Beams(NamedTuple):
    """Beams that returned, in one frame."""

    points: NDArray[Any]
    """(N, 3) where each beam ended, metres"""
    origins: NDArray[Any]
    """(N, 3) where the sensor was"""
    times_ns: Times
    """(N,) when each beam was fired"""
    lidar: Bytes
    """(N,) number of the lidar that fired it, in the order of the recording"""

    def rows(self, which: Indices) -> Beams:
        """Some of the beams."""
        return Beams(self.points[which], self.origins[which], self.times_ns[which], self.lidar[which])


class BeamReader:
    """Reads the scans of a drive and deskews them. A scan that neighbouring blocks share is read once."""

    def __init__(
        self,
        recording: FieldRecording,
        arc_length: ArcLength,
        min_range_m: float,
        max_range_m: float,
        min_step_m: float,
    ) -> None:
        """
        Args:
            min_range_m: nearer points are left out, since they belong to the car itself.
            max_range_m: points further away are left out.
            min_step_m: a scan is used if the car has moved by so much since the last one; none is while it stands.
        """
        self._lidars = recording.lidars
        self._odometry = _pose_intervals(recording.odometry)
        self._ranges = [(min_range_m, min(max_range_m, lidar.max_range_m)) for lidar in recording.lidars]
        self._moved = [_moving(lidar, arc_length, min_step_m) for lidar in recording.lidars]
        self._slack = [_period(lidar) for lidar in recording.lidars]
        self._read = [lru_cache(maxsize=_KEPT_SCANS)(lidar.read) for lidar in recording.lidars]
        self.repeats: set[tuple[str, int]] = set()
        """lidar and index of the scans that were left out, since they have the very points of the scan before"""

    def between(self, begin_ns: int, end_ns: int, T_odom_node: Array) -> Beams:
        """The beams of all lidars fired in [begin, end), in the frame of the node.

        Args:
            T_odom_node: (4, 4).

        Raises:
            DatasetError: a scan is damaged.
        """
        parts = [self._of_lidar(i, begin_ns, end_ns) for i in range(len(self._lidars))]
        points, origins, times = (np.concatenate([part[k] for part in parts]) for k in range(3))
        lidar = np.repeat(np.arange(len(parts), dtype=np.uint8), [len(part[0]) for part in parts])
        T_node_odom = invert(T_odom_node)
        rotation, translation = T_node_odom[:3, :3], T_node_odom[:3, 3]
        return Beams(points @ rotation.T + translation, origins @ rotation.T + translation, times, lidar)

    def _of_lidar(self, i: int, begin_ns: int, end_ns: int) -> tuple[Array, Array, Times]:
        lidar, (nearest, farthest) = self._lidars[i], self._ranges[i]
        first = int(np.searchsorted(lidar.times_ns, begin_ns - self._slack[i]))
        last = int(np.searchsorted(lidar.times_ns, end_ns + self._slack[i], side="right"))
        scans = [self._read[i](s) for s in range(first, last) if self._moved[i][s] and not self._is_repeat(i, s)]
        points = np.concatenate([s.points for s in scans]) if scans else np.zeros((0, 3))
        times = np.concatenate([s.times_ns for s in scans]) if scans else np.zeros(0, np.int64)
        squared = np.einsum("ni,ni->n", points, points)
        use = (times >= begin_ns) & (times < end_ns) & (squared >= nearest**2) & (squared <= farthest**2)
        points, times = np.ascontiguousarray(points[use], dtype=np.float64), times[use]
        placed, origins = _place(points, times, *self._odometry, np.asarray(lidar.T_rig_lidar, dtype=np.float64))
        return placed, origins, times

    def _is_repeat(self, i: int, index: int) -> bool:
        """Whether a driver sent the scan before again: what is measured is never the same twice on the way."""
        points = self._read[i](index).points
        repeated = index > 0 and len(points) > 0 and np.array_equal(points, self._read[i](index - 1).points)
        if repeated:
            self.repeats.add((self._lidars[i].name, index))
        return repeated


def _period(lidar: LidarStream) -> int:
    """Nanoseconds within which of a scan's time its beams are fired."""
    gaps = np.diff(lidar.times_ns)
    return int(np.median(gaps)) if len(gaps) else 200_000_000


def _moving(lidar: LidarStream, arc_length: ArcLength, min_step_m: float) -> Mask:
    """(M,) whether the car moved on before each scan."""
    steps = np.floor(arc_length.at(lidar.times_ns) / min_step_m)
    return np.diff(steps, prepend=-1.0) != 0 if len(steps) else np.zeros(0, np.bool_)


def _pose_intervals(odometry: Trajectory) -> tuple[Times, Array, Array]:
    """Times (N,), poses (N, 4, 4) with straight motion between them, and its rotation vectors (N - 1, 3)."""
    odometry = odometry.finer()
    rotation = odometry.T_odom_rig[:, :3, :3]
    turns = so3_log(np.swapaxes(rotation[:-1], -1, -2) @ rotation[1:]) if len(rotation) > 1 else np.zeros((0, 3))
    return odometry.times_ns, np.ascontiguousarray(odometry.T_odom_rig), np.ascontiguousarray(turns)


@njit(cache=True, nogil=True, error_model="numpy")
def _place(
    points: Array, times_ns: Times, pose_times: Times, poses: Array, turns: Array, T_rig_lidar: Array
) -> tuple[Array, Array]:
    """Points (N, 3) of a lidar and their origins (N, 3), in the odometry's frame.

    Each beam is placed by the pose that ``Trajectory.at`` gives for its time: positions are interpolated along a line
    and rotations along a great arc, by Rodrigues' formula.
    """
    n, last = len(points), len(pose_times) - 1
    placed, origins = np.empty((n, 3)), np.empty((n, 3))
    q, lever, p = np.empty(3), np.empty(3), np.empty(3)
    interval = 0
    for i in range(n):
        time = times_ns[i]
        if last > 0 and not (pose_times[interval] <= time <= pose_times[interval + 1]):
            interval = min(max(int(np.searchsorted(pose_times, time, side="right")) - 1, 0), last - 1)
        share = 0.0
        vx = vy = vz = 0.0
        if last > 0:
            share = (time - pose_times[interval]) / (pose_times[interval + 1] - pose_times[interval])
            vx, vy, vz = share * turns[interval, 0], share * turns[interval, 1], share * turns[interval, 2]
        angle = np.sqrt(vx * vx + vy * vy + vz * vz)
        a = np.sin(angle) / angle if angle > 1e-8 else 1.0
        b = (1 - np.cos(angle)) / (angle * angle) if angle > 1e-4 else 0.5
        for row in range(3):
            lever[row] = T_rig_lidar[row, 3]
            p[row] = lever[row]
            for column in range(3):
                p[row] += T_rig_lidar[row, column] * points[i, column]
        for which in range(2):
            for row in range(3):
                q[row] = p[row] if which == 0 else lever[row]
            # R q = q + a v x q + b v x (v x q)
            cx, cy, cz = vy * q[2] - vz * q[1], vz * q[0] - vx * q[2], vx * q[1] - vy * q[0]
            ex, ey, ez = vy * cz - vz * cy, vz * cx - vx * cz, vx * cy - vy * cx
            q[0] += a * cx + b * ex
            q[1] += a * cy + b * ey
            q[2] += a * cz + b * ez
            for row in range(3):
                value = poses[interval, row, 3]
                if last > 0:
                    value += share * (poses[interval + 1, row, 3] - poses[interval, row, 3])
                for column in range(3):
                    value += poses[interval, row, column] * q[column]
                if which == 0:
                    placed[i, row] = value
                else:
                    origins[i, row] = value
    return placed, origins
