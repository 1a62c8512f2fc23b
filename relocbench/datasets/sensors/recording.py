"""A recorded drive in the form that the ground-truth builder needs, independent of its format.

Importers turn their formats into a :class:`FieldRecording`, and only importers know formats. The rig's axes are
x forward, y left, z up, with any origin; formats with other axes are converted when they are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from relocbench.arrays import Array, Image, Mask, Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.sensors.pose_spline import PoseSpline
from relocbench.geometry import Camera, interpolate_trajectory

MAX_GAP_NS = 1_000_000_000
"""longest gap between poses that is interpolated over, unless the user says another one"""
_FINER = 5
"""parts of the time between two poses of a smooth trajectory that are straight enough"""
_FEWEST_OF_SPLINE = 4


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses along a drive, in the drive's own frame (``odom``) or that of a map (GNSS)."""

    times_ns: Times
    """(N,) strictly increasing"""
    T_odom_rig: Array
    """(N, 4, 4)"""
    max_gap_ns: int = MAX_GAP_NS
    """longest gap between poses to interpolate over"""
    breaks: tuple[int, ...] = ()
    """indices of poses whose motion from the previous pose was not measured but guessed; nothing is interpolated
    there, however short the gap"""
    smooth: bool = False
    """whether the motion between poses follows cubic splines, as a car's does between scans, and not straight lines"""

    def __post_init__(self) -> None:
        """Raise ValueError if a break is not between two poses."""
        if any(not 0 < index < len(self.times_ns) for index in self.breaks):
            raise ValueError(f"breaks must be indices of poses after the first, got {self.breaks}")

    def covers(self, times_ns: Times) -> Mask:
        """Whether the trajectory has a pose at each time (M,): within the drive and not in a gap."""
        if not len(self.times_ns):
            return np.zeros(len(times_ns), dtype=np.bool_)
        right = np.clip(np.searchsorted(self.times_ns, times_ns, side="left"), 1, max(len(self.times_ns) - 1, 1))
        inside: Mask = (times_ns >= self.times_ns[0]) & (times_ns <= self.times_ns[-1])
        if len(self.times_ns) == 1:
            return inside
        gap = self.times_ns[right] - self.times_ns[right - 1]
        on_pose = (times_ns == self.times_ns[right]) | (times_ns == self.times_ns[right - 1])
        measured = (gap <= self.max_gap_ns) & ~np.isin(right, self.breaks)
        out: Mask = inside & (on_pose | measured)
        return out

    def pieces(self, times_ns: Times) -> Times:
        """Number (M,) of the piece of the drive that each time belongs to; a gap or a break begins a new piece.

        Relative poses are known within a piece but not between pieces. A time in a gap belongs to the piece before it.
        """
        gaps = np.flatnonzero(np.diff(self.times_ns) > self.max_gap_ns) + 1
        starts = self.times_ns[np.union1d(gaps, np.array(self.breaks, dtype=np.int64)).astype(np.int64)]
        return np.searchsorted(starts, times_ns, side="right").astype(np.int64)

    def at(self, times_ns: Times) -> Array:
        """Poses (M, 4, 4) at times that the trajectory covers, interpolated linearly and by slerp, or by splines.

        Raises:
            ValueError: a time is outside the drive.
        """
        out = interpolate_trajectory(self.times_ns, self.T_odom_rig, times_ns)
        for first, spline in self._splines:
            inside = (times_ns >= self.times_ns[first]) & (times_ns <= spline.last_ns)
            out[inside] = spline.at(times_ns[inside])
        return out

    def finer(self) -> Trajectory:
        """A trajectory that is interpolated linearly and has poses so close together that this is the same."""
        if not self.smooth:
            return self
        gaps = np.diff(self.times_ns)
        whole = self.covers(self.times_ns[:-1] + gaps // 2)
        between = [self.times_ns[:-1][whole] + k * gaps[whole] // _FINER for k in range(1, _FINER)]
        times = np.unique(np.concatenate([self.times_ns, *between]))
        breaks = tuple(np.searchsorted(times, self.times_ns[list(self.breaks)]).tolist())
        return Trajectory(times, self.at(times), self.max_gap_ns, breaks)

    @cached_property
    def _splines(self) -> list[tuple[int, PoseSpline]]:
        """The splines of the pieces, and the number of the first pose of each."""
        piece = self.pieces(self.times_ns) if self.smooth else np.zeros(0, np.int64)
        members = [np.flatnonzero(piece == number) for number in np.unique(piece)]
        members = [rows for rows in members if len(rows) >= _FEWEST_OF_SPLINE]
        return [(int(rows[0]), PoseSpline(self.times_ns[rows], self.T_odom_rig[rows])) for rows in members]


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep of a lidar; beams without a return are left out."""

    points: Array
    """(N, 3) metres, each in the lidar's frame at the time when its beam was fired"""
    times_ns: Times
    """(N,) times at which the beams were fired"""


class LidarStream(Protocol):
    """The scans of one lidar of a drive. Streams are picklable, since worker processes read them."""

    @property
    def name(self) -> str: ...

    @property
    def pattern(self) -> Literal["push-broom", "spinning"]: ...

    @property
    def T_rig_lidar(self) -> Array:
        """(4, 4)"""
        ...

    @property
    def times_ns(self) -> Times:
        """Times (M,) of the scans, strictly increasing."""
        ...

    @property
    def max_range_m(self) -> float: ...

    @property
    def sigma_m(self) -> float:
        """Standard deviation of a range."""
        ...

    def read(self, index: int) -> Scan:
        """Read a scan, which may be empty. Raises DatasetError with the file if it is missing or damaged."""
        ...


class CameraStream(Protocol):
    """The images of one camera of a drive, as a pinhole camera would have taken them. Streams are picklable."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    @property
    def T_rig_cam(self) -> Array:
        """(4, 4)"""
        ...

    @property
    def times_ns(self) -> Times:
        """(M,) strictly increasing"""
        ...

    def read(self, index: int) -> Image:
        """Read an undistorted image, (H, W) or (H, W, 3) RGB. Raises DatasetError with the file."""
        ...

    def file(self, index: int) -> Path | None:
        """A file that holds exactly this image and can be linked; None if the stored image has to be converted."""
        ...


@dataclass(frozen=True, eq=False)
class RigStream:
    """The rig of a drive without images, at the times of the scans of a lidar."""

    name: str
    lidar: str
    times_ns: Times
    """(M,) strictly increasing"""

    @property
    def T_rig_cam(self) -> Array:
        """(4, 4) the identity: the frame is that of the rig."""
        return np.eye(4)


@dataclass(frozen=True, eq=False)
class FieldRecording:
    """One recorded drive: odometry, lidar scans, and optionally images and a GNSS prior."""

    name: str
    folder: Path
    condition: Condition
    odometry: Trajectory
    """accurate over tens of metres, with drift over hundreds"""
    lidars: tuple[LidarStream, ...]
    cameras: Mapping[str, CameraStream] = field(default_factory=dict)
    prior: Trajectory | None = None
    """``T_map_rig`` by GNSS in a map frame that all drives share (z up): accurate to metres, with a bias per drive"""
    prior_sigma_m: float = 10.0
    """standard deviation of the prior; truth more than three of these away contradicts it"""
    location: str = ""
    odometry_lidar: str = ""
    """name of the lidar that the odometry was computed from; empty if other sensors measured it"""

    def rig_stream(self, name: str) -> RigStream:
        """The rig at the scans of the first lidar, which stands in for a camera where there is none."""
        first = self.lidars[0]
        return RigStream(name, first.name, first.times_ns)
