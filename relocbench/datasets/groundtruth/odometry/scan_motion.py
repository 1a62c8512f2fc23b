"""Whether the scans of a spinning lidar are motion-compensated or distorted by its motion, told from the scans.

In a distorted scan each point is where the lidar saw it at its own moment of the turn. Some metres further on, the same
wall is seen at another moment, so that it lies elsewhere, by the metres driven in between; the two scans fit only after
both are corrected. If the scans are compensated, the same correction is what makes them fit worse. A few scans in a row
are registered under either assumption, at several places of the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Array, Times
from relocbench.datasets.groundtruth.odometry.lidar_odometry import deskewed, lidar_odometry
from relocbench.datasets.groundtruth.odometry.local_map import plane_normals
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import LidarStream, Scan
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, se3_log
from relocbench.progress import Reporter

ScanMotion = Literal["compensated", "distorted"]

_PLACES = 7
"""places along the drive that are tried, evenly spaced"""
_WINDOWS = 3
"""of them, so many where the lidar moved are used"""
_SCANS = 8
"""scans registered at each"""
_LEAST_M = 1.5
"""metres moved within these scans; less tells nothing"""
_MARGIN = 1.06
"""one assumption must fit better by this factor"""
_VOXEL_M = 0.4
_REACH_M = 0.6
_NEAREST_M, _FARTHEST_M = 3.0, 50.0


@dataclass(frozen=True)
class Detected:
    """How scans were taken, and the evidence for it."""

    motion: ScanMotion
    evidence: str
    """one sentence for people"""


@dataclass(frozen=True, eq=False)
class _Part(DerivedLidar):
    """Some scans in a row of a lidar, whose frame is the rig."""

    first: int
    count: int

    @property
    def T_rig_lidar(self) -> Array:
        return np.eye(4)

    @property
    def times_ns(self) -> Times:
        return self.stream.times_ns[self.first : self.first + self.count]

    def read(self, index: int) -> Scan:
        return self.stream.read(self.first + index)


def detect_motion(compensated: LidarStream, distorted: LidarStream) -> Detected:
    """Tell which of two readings of the same scans is right.

    Args:
        compensated: the scans, all points of each at its own time.
        distorted: the scans, each point at the time when its beam was fired.

    Raises:
        DatasetError: a scan is damaged.
    """
    fits: list[tuple[float, float]] = []
    speeds: list[float] = []
    count = len(compensated.times_ns)
    starts = np.unique(np.linspace(0, max(count - _SCANS, 0), _PLACES).astype(int)).tolist()
    for first in _from_the_middle(starts):
        if count < _SCANS or len(fits) == _WINDOWS:
            break
        parts = [_fit(_Part(stream, first, _SCANS)) for stream in (compensated, distorted)]
        if any(fit is None for fit in parts):
            continue
        (plain, moved), (corrected, _) = parts  # type: ignore[misc]
        if moved >= _LEAST_M:
            fits.append((plain, corrected))
            speeds.append(moved)
    if not fits:
        return Detected(
            "compensated", f"cannot be told: of the scans looked at, no {_SCANS} in a row move and have enough points"
        )
    plain, corrected = np.median(np.array(fits), axis=0).tolist()
    message = (
        f"scans {np.median(speeds):.1f} m apart fit to {100 * plain:.1f} cm as they are and to "
        f"{100 * corrected:.1f} cm with their motion taken out (medians at {len(fits)} places)"
    )
    better = [a > _MARGIN * b for a, b in fits], [b > _MARGIN * a for a, b in fits]
    if sum(better[0]) > len(fits) / 2 and plain > _MARGIN * corrected:
        return Detected("distorted", message)
    if sum(better[1]) > len(fits) / 2 and corrected > _MARGIN * plain:
        return Detected("compensated", message)
    return Detected("compensated", f"cannot be told: {message}")


def detected_motion(title: str, compensated: LidarStream, distorted: LidarStream, reporter: Reporter) -> ScanMotion:
    """What :func:`detect_motion` tells of a drive, which is reported together with the evidence.

    Raises:
        DatasetError: a scan is damaged.
    """
    detected = detect_motion(compensated, distorted)
    reporter.note(f"{title}: scans are taken as {detected.motion} by motion: {detected.evidence} (--motion)")
    return detected.motion


def _from_the_middle(starts: Sequence[int]) -> list[int]:
    """The places in the order of their distance from the middle, since cars stand at the ends of a drive."""
    middle = (len(starts) - 1) / 2
    return [starts[i] for i in sorted(range(len(starts)), key=lambda i: (abs(i - middle), i))]


def _fit(part: _Part) -> tuple[float, float] | None:
    """Median distance of the last scan's points from planes of the first, and metres moved; None if nothing fits."""
    try:
        motion = lidar_odometry(part)
    except DatasetError:
        for i in range(part.count):
            part.read(i)  # raises if a scan is damaged
        return None  # too few points to register
    poses, times = motion.T_odom_rig, motion.times_ns
    if len(times) < 3:
        return None
    clouds = []
    for end, neighbour in ((0, 1), (-1, -2)):
        twist = se3_log(invert(poses[end]) @ poses[neighbour]) / int(times[neighbour] - times[end])
        index = int(np.flatnonzero(part.times_ns == times[end])[0])
        points = deskewed(part.read(index), int(times[end]), twist)
        reach = np.sum(points**2, axis=1)
        near = points[(reach >= _NEAREST_M**2) & (reach <= _FARTHEST_M**2)]
        clouds.append(apply(poses[end], near))
    moved = float(np.linalg.norm(poses[-1][:3, 3] - poses[0][:3, 3]))
    distance = _distance(clouds[0], clouds[1])
    return None if distance is None else (distance, moved)


def _distance(ref: Array, query: Array) -> float | None:
    """Median distance of points from planes within reach; upright planes only, since the road fits either way."""
    places = ref[first_in_voxels(ref, _VOXEL_M)] if len(ref) else ref
    if len(places) < 50 or len(query) < 50:
        return None
    normals, flat = plane_normals(places, ref)
    upright = flat & (np.abs(normals[:, 2]) < 0.5)
    if np.count_nonzero(upright) < 20:
        return None
    sample = query[first_in_voxels(query, _VOXEL_M / 2)]
    distance, nearest = map(
        np.asarray, cKDTree(places[upright]).query(sample, distance_upper_bound=_REACH_M, workers=1)
    )
    near = np.isfinite(distance)
    if np.count_nonzero(near) < 20:
        return None
    apart = sample[near] - places[upright][nearest[near]]
    return float(np.median(np.abs(np.einsum("ni,ni->n", normals[upright][nearest[near]], apart))))
