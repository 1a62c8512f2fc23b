"""The parts of a recording, independent of its layout: sensors and their times, the car's motion, other cars."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from relocbench.arrays import Array, Image, Mask, Times
from relocbench.datasets.core import images
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.lidar import Lidar
from relocbench.datasets.synthetic.town.moving import Moving
from relocbench.errors import ConfigError, available
from relocbench.geometry import Camera, interpolate, interpolate_trajectory

_TELEPORT_M = 5.0
"""a car that moves further than this in one step has left the route at one end and reappeared at the other"""


@dataclass(frozen=True, eq=False)
class TrueTrajectory:
    """The exact motion of the car, defined by :func:`interpolate_trajectory` between these poses."""

    times_ns: Times
    """(N,)"""
    T_world_rig: Array
    """(N, 4, 4)"""

    def at(self, times_ns: Times) -> Array:
        """``T_world_rig`` (M, 4, 4) at times (M,). Raises ValueError outside the drive."""
        return interpolate_trajectory(self.times_ns, self.T_world_rig, times_ns)


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """``T_world_sensor`` at any time of the drive."""

    trajectory: TrueTrajectory
    T_rig_sensor: Array

    def __call__(self, times_ns: Times, /) -> Array:
        return np.asarray(self.trajectory.at(times_ns) @ self.T_rig_sensor)


@dataclass(frozen=True, eq=False)
class CarTrack:
    """The motion of another car, given at the steps of the drive and interpolated between them."""

    variant: int
    times_ns: Times
    """(N,)"""
    T_world_car: Array
    """(N, 4, 4), NaN where the car is absent"""

    def __call__(self, times_ns: Times, /) -> Array:
        """``T_world_car`` (M, 4, 4) at times (M,), NaN where the car is absent."""
        right = np.clip(np.searchsorted(self.times_ns, times_ns, side="right"), 1, len(self.times_ns) - 1)
        before, after = self.T_world_car[right - 1], self.T_world_car[right]
        span = self.times_ns[right] - self.times_ns[right - 1]
        fraction = (times_ns - self.times_ns[right - 1]) / span
        moved = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1)
        known = (moved < _TELEPORT_M) & (fraction >= 0) & (fraction <= 1)
        out = np.full((len(times_ns), 4, 4), np.nan)
        out[known] = interpolate(before[known], after[known], fraction[known])
        return out


def car_tracks(times_ns: Times, steps: Sequence[Sequence[Moving]]) -> list[CarTrack]:
    """The tracks of cars that are listed step by step; a car is identified by its look."""
    poses: dict[int, Array] = {}
    for i, cars in enumerate(steps):
        for T_world_car, variant, _ in cars:
            if variant not in poses:
                poses[variant] = np.full((len(steps), 4, 4), np.nan)
            poses[variant][i] = T_world_car
    return [CarTrack(variant, times_ns, track) for variant, track in poses.items()]


def cars_at(tracks: Sequence[CarTrack], time_ns: int) -> list[Moving]:
    """The cars that are present at one time."""
    found = [(track(np.array([time_ns]))[0], track.variant) for track in tracks]
    return [Moving(pose, variant) for pose, variant in found if np.isfinite(pose[0, 0])]


@dataclass(frozen=True, eq=False)
class CameraMount:
    """A camera of the recording car."""

    camera: Camera
    T_rig_cam: Array


@dataclass(frozen=True, eq=False)
class LidarMount:
    """A lidar of the recording car."""

    lidar: Lidar
    T_rig_lidar: Array
    compensated: bool = False
    """whether scans are written motion-compensated"""


@dataclass(frozen=True)
class Layout(ABC):
    """One drive in a format on disk, which defines the sensors and their times, and writes what they measure.

    Subclasses are dataclasses; they are pickled without their cached properties.
    """

    root: Path
    frames: int
    """images of each camera (RobotCar: of the stereo lenses)"""
    scale: float
    """image size relative to the real cameras"""
    chosen: tuple[str, ...]
    """cameras to record"""
    format: ClassVar[str]
    known_cameras: ClassVar[Collection[str]]

    def __post_init__(self) -> None:
        for name in self.chosen:
            if name not in self.known_cameras:
                raise ConfigError(f"no {self.format} camera '{name}'{available(name, self.known_cameras)}")

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    @abstractmethod
    def name(self) -> str:
        """The drive's name."""

    @property
    def folder(self) -> Path:
        """The folder of the drive's images and scans."""
        return self.root / self.name

    @property
    @abstractmethod
    def cameras(self) -> Mapping[str, CameraMount]: ...

    @property
    @abstractmethod
    def lidars(self) -> Mapping[str, LidarMount]: ...

    @property
    @abstractmethod
    def times(self) -> Mapping[str, Times]:
        """Times of the images and scans in nanoseconds, by sensor."""

    def path(self, sensor: str, index: int) -> Path:
        """The file of an image or a scan."""
        return self.folder / sensor / f"{self.stem(sensor, index)}.{'bin' if sensor in self.lidars else 'png'}"

    def stem(self, sensor: str, index: int) -> str:
        """The name of that file: its time in microseconds."""
        return str(int(self.times[sensor][index]) // 1000)

    def is_whole(self, sensor: str, path: Path) -> bool:
        """Whether the file exists and was written to its end."""
        if sensor in self.lidars:
            return path.is_file() and self.is_scan_size(path.stat().st_size)
        return images.is_whole(path)

    @abstractmethod
    def is_scan_size(self, size: int) -> bool:
        """Whether a scan can have this size in bytes."""

    def write_image(self, camera: str, path: Path, rgb: Image) -> None:
        images.write_image(path, rgb)

    @abstractmethod
    def write_scan(self, path: Path, points: Array, reflectance: Array, returned: Mask) -> None: ...

    @abstractmethod
    def write_texts(self, trajectory: TrueTrajectory, factors: Factors, seed: int) -> dict[str, Any]:
        """Write calibration, times, odometry and other text files; returns the random errors in them, for the truth.

        Raises:
            DatasetError: the folder holds another calibration.
        """
