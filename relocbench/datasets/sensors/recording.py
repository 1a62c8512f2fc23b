"""What the builder of ground truth needs of a recorded drive, whatever its format.

An importer turns its format into a :class:`FieldRecording`; everything behind it knows no format. The rig's axes are
x forward, y left, z up, wherever its origin is; formats with other axes are converted when they are read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core.schema import Condition
from relocbench.geometry import Camera, interpolate_trajectory

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses along a drive, in a frame of the drive's own (``odom``) or of a map (GNSS)."""

    times_ns: Times
    """(N,) strictly increasing"""
    T_odom_rig: Array
    """(N, 4, 4)"""
    max_gap_ns: int = 1_000_000_000
    """nothing is interpolated between poses that lie further apart"""
    breaks: tuple[int, ...] = ()
    """indices of poses before which nothing was measured: how they lie to those before is a guess, however near in
    time, and nothing is interpolated there"""

    def covers(self, times_ns: Times) -> NDArray[np.bool_]:
        """(M,) whether a pose can be told at each time: within the drive and not in a gap."""
        right = np.clip(np.searchsorted(self.times_ns, times_ns, side="left"), 1, max(len(self.times_ns) - 1, 1))
        inside = (times_ns >= self.times_ns[0]) & (times_ns <= self.times_ns[-1])
        if len(self.times_ns) == 1:
            return inside
        gap = self.times_ns[right] - self.times_ns[right - 1]
        on_pose = (times_ns == self.times_ns[right]) | (times_ns == self.times_ns[right - 1])
        measured = (gap <= self.max_gap_ns) & ~np.isin(right, self.breaks)
        return inside & (on_pose | measured)

    def pieces(self, times_ns: Times) -> Times:
        """(M,) number of the piece of the drive that each time lies in; a gap or a break begins a new piece.

        Poses of one piece are known relative to each other, those of two are not. A time in a gap counts to the piece
        before it.
        """
        gaps = np.flatnonzero(np.diff(self.times_ns) > self.max_gap_ns) + 1
        starts = self.times_ns[np.union1d(gaps, np.array(self.breaks, dtype=np.int64)).astype(np.int64)]
        return np.searchsorted(starts, times_ns, side="right").astype(np.int64)

    def at(self, times_ns: Times) -> Array:
        """(M, 4, 4) at times that it covers: lines and great arcs between the poses around each.

        Raises:
            ValueError: outside the drive.
        """
        return interpolate_trajectory(self.times_ns, self.T_odom_rig, times_ns)


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep of a lidar: what returned, without what did not."""

    points: Array
    """(N, 3) metres in the lidar's frame, each as it was when its beam was fired"""
    times_ns: Times
    """(N,) when each beam was fired"""


class LidarStream(Protocol):
    """The scans of one lidar of a drive; picklable, since workers read them."""

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
        """(M,) of the scans, strictly increasing"""
        ...

    @property
    def max_range_m(self) -> float: ...

    @property
    def sigma_m(self) -> float:
        """Standard deviation of a range."""
        ...

    def read(self, index: int) -> Scan:
        """A scan. Raises DatasetError with the file if it is missing or damaged; an empty scan is empty."""
        ...


class CameraStream(Protocol):
    """The images of one camera of a drive, as a pinhole camera would have taken them; picklable."""

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

    def read(self, index: int) -> NDArray[np.uint8]:
        """(H, W) or (H, W, 3) RGB, undistorted. Raises DatasetError with the file."""
        ...

    def file(self, index: int) -> Path | None:
        """The file that holds exactly this image and can be linked to; None where it has to be developed first."""
        ...


@dataclass(frozen=True, eq=False)
class FieldRecording:
    """One drive."""

    name: str
    folder: Path
    condition: Condition
    odometry: Trajectory
    """accurate over tens of metres, drifting over hundreds"""
    lidars: tuple[LidarStream, ...]
    cameras: Mapping[str, CameraStream] = field(default_factory=dict)
    prior: Trajectory | None = None
    """``T_map_rig`` by GNSS, in a map frame that all drives share (z up): good to metres, and biased between drives"""
    prior_sigma_m: float = 10.0
    """beyond three times this, prior and truth disagree"""
    location: str = ""
