"""Which axes of the lidars the calibration means, told from scans.

An HDL-32E counts azimuths from its own y axis, and the ROS driver calls this direction x. The published poses of the
lidars fit a car under both: they differ by a quarter of a turn about the lidar. Two scans some metres of road apart
tell: brought together by the poses of the car, they agree under the right axes alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.spatial import KDTree

from relocbench.arrays import Array
from relocbench.datasets.sensors.recording import LidarStream, Trajectory
from relocbench.geometry import apply, invert, make_transform, path_lengths

LidarAxes = Literal["ros", "velodyne"]

T_VELODYNE_ROS = make_transform(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [0.0, 0.0, 0.0])
"""from x along azimuth 0, y left to x right, y along azimuth 0"""
TURNS: dict[LidarAxes, Array] = {"ros": np.eye(4), "velodyne": T_VELODYNE_ROS}
_PAIRS, _LIDARS = 4, 2
_LEAST_M, _MOST_M = 3.0, 8.0
_ABOVE_M = 0.5
"""points higher above the rear axle than this: the road looks alike from everywhere"""
_NEAR_M = 0.3
_POINTS, _FEWEST = 6000, 300
_CLEARER, _LEAST_SHARE = 2.0, 0.1


def axes_by_scans(lidars: Sequence[LidarStream], poses: Trajectory) -> tuple[LidarAxes | None, dict[LidarAxes, float]]:
    """The axes under which scans agree, None if they do not tell, and the shares of points that agree.

    Args:
        lidars: with poses on the rig as if the axes were those of the ROS driver.
    """
    shares: dict[LidarAxes, list[float]] = {"ros": [], "velodyne": []}
    for lidar in lidars[:_LIDARS]:
        for first, second in _pairs(lidar, poses):
            for axes, turn in TURNS.items():
                a, b = (_placed(lidar, k, poses, lidar.T_rig_lidar @ turn) for k in (first, second))
                b = b[:: max(1, len(b) // _POINTS)]
                if len(a) >= _FEWEST and len(b) >= _FEWEST:
                    shares[axes].append(float(np.mean(KDTree(a).query(b, distance_upper_bound=_NEAR_M)[0] < _NEAR_M)))
    found: dict[LidarAxes, float] = {axes: float(np.mean(v)) if v else 0.0 for axes, v in shares.items()}
    best: LidarAxes = "ros" if found["ros"] >= found["velodyne"] else "velodyne"
    clear = found[best] >= _LEAST_SHARE and found[best] > _CLEARER * min(found.values())
    return (best if clear else None), found


def _pairs(lidar: LidarStream, poses: Trajectory) -> list[tuple[int, int]]:
    """Scans some metres of road apart, spread over the drive."""
    known = np.flatnonzero(poses.covers(lidar.times_ns))
    if len(known) < 2:
        return []
    where = poses.at(lidar.times_ns[known])[:, :3, 3]
    travelled = path_lengths(where)
    later = np.searchsorted(travelled, travelled + _LEAST_M)
    fits = np.flatnonzero(later < len(known))
    fits = fits[travelled[later[fits]] - travelled[fits] <= _MOST_M]
    chosen = fits[np.unique(np.linspace(0, len(fits) - 1, _PAIRS).astype(int))] if len(fits) else fits
    return [(int(known[k]), int(known[later[k]])) for k in chosen]


def _placed(lidar: LidarStream, index: int, poses: Trajectory, T_rig_lidar: Array) -> Array:
    """Points (N, 3) of a scan above the road, in the frame of the poses."""
    scan = lidar.read(index)
    known = np.flatnonzero(poses.covers(scan.times_ns))
    if not len(known):
        return np.empty((0, 3))
    T_world_rig = poses.at(scan.times_ns[known])
    points: Array = apply(T_world_rig @ T_rig_lidar, scan.points[known][:, None, :])[:, 0]
    height = apply(invert(T_world_rig[0]), points)[:, 2]
    return points[height > _ABOVE_M]
