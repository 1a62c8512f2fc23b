"""A kapture folder: where its cameras were, what they saw, and what is known of depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.importers.kapture.tables import (
    CAMERAS,
    DEPTHS,
    Moment,
    Mount,
    Record,
    Sensor,
    read_observations,
    read_points,
    read_records,
    read_rigs,
    read_sensors,
    read_trajectories,
    read_version,
)
from relocbench.datasets.importers.photos.points import ModelImage, SparseModel
from relocbench.errors import DatasetError, quoted
from relocbench.geometry import Camera, invert, rotation_angle

_SAME_PLACE = 1e-4
"""metres and radians between sensors that are taken as one: far below a pixel"""


@dataclass(frozen=True, eq=False)
class KaptureFolder:
    """A kapture folder."""

    root: Path
    sensors: dict[str, Sensor]
    mounts: dict[str, list[Mount]]
    """device -> the rigs that it is mounted on"""
    poses: dict[Moment, Array | None]
    """``T_device_world`` of sensors and rigs; None where it is told in part only"""
    images: list[Record]
    """by timestamp and sensor"""
    depths: dict[int, list[Record]]
    """timestamp -> the depth maps of that time"""
    points: Array
    """(P, 3)"""
    observed: dict[str, Indices]
    """image name -> the points that it observes"""

    def path(self, record: Record) -> Path:
        """The file of a record."""
        return self.root / "sensors" / "records_data" / record.name

    def camera(self, device: str) -> Camera:
        """The camera of a sensor. Raises DatasetError with file and line if its model cannot be read."""
        sensor = self.sensors[device]
        if sensor.camera is None:
            raise DatasetError(f"{quoted(device)}: {sensor.fault}", self.root / "sensors" / "sensors.txt", sensor.line)
        return sensor.camera

    def T_device_world(self, device: str, timestamp: int) -> Array | None:
        """Pose (4, 4) of a sensor or a rig: its own, or else that of a rig that carries it; None if unknown.

        ``T_device_world = T_device_rig @ T_rig_world``, where the rig may be carried by another one.
        """
        own = self.poses.get((timestamp, device))
        if own is not None:
            return own
        for mount in self.mounts.get(device, ()):
            if (
                mount.T_device_rig is not None
                and (T_rig_world := self.T_device_world(mount.rig, timestamp)) is not None
            ):
                return np.asarray(mount.T_device_rig @ T_rig_world)
        return None

    def depth_of(self, image: Record) -> Record | None:
        """The depth map of an image: one of the same time, of a sensor that stands and looks as the image's does.

        One with the same intrinsics goes before others. None if there is none, or the image has no pose.
        """
        candidates = self.depths.get(image.timestamp, [])
        T_cam_world = self.T_device_world(image.device, image.timestamp) if candidates else None
        if T_cam_world is None:
            return None
        at_once = [depth for depth in candidates if self._in_one_place(depth, T_cam_world)]
        same = [depth for depth in at_once if self.sensors[depth.device].camera == self.sensors[image.device].camera]
        return next(iter(same or at_once), None)

    def _in_one_place(self, depth: Record, T_cam_world: Array) -> bool:
        T_depth_world = self.T_device_world(depth.device, depth.timestamp)
        if T_depth_world is None or self.sensors[depth.device].camera is None:
            return False
        T_depth_cam = T_depth_world @ invert(T_cam_world)
        moved = float(np.linalg.norm(T_depth_cam[:3, 3]))
        return moved < _SAME_PLACE and float(rotation_angle(T_depth_cam[:3, :3])) < _SAME_PLACE

    @cached_property
    def model(self) -> SparseModel:
        """The posed images that observe points, and the points; without images whose camera model cannot be read.

        An image's number is its position in :attr:`images`.
        """
        numbers = {device: number for number, device in enumerate(self.sensors)}
        cameras = {numbers[device]: s.camera for device, s in self.sensors.items() if s.camera is not None}
        posed: dict[int, ModelImage] = {}
        for number, record in enumerate(self.images):
            T_cam_world = self.T_device_world(record.device, record.timestamp)
            seen = self.observed.get(record.name)
            if T_cam_world is not None and seen is not None and numbers[record.device] in cameras:
                posed[number] = ModelImage(record.name, numbers[record.device], T_cam_world, seen)
        no_errors = np.full(len(self.points), np.nan)
        return SparseModel(cameras, posed, np.arange(len(self.points)), self.points, no_errors)


def is_kapture(folder: Path) -> bool:
    """Whether a folder is in the kapture format."""
    return (folder / "sensors" / "sensors.txt").exists()


def read_folder(root: Path) -> KaptureFolder:
    """Read a kapture folder of version 1.0 or 1.1.

    Needed are ``sensors/sensors.txt`` and ``sensors/records_camera.txt``; read where they are there: ``rigs.txt``,
    ``trajectories.txt`` and ``records_depth.txt`` beside these, ``reconstruction/points3d.txt`` and
    ``reconstruction/observations.txt``. Observations of images without record are left out.

    Raises:
        DatasetError: with file and line: a table is missing or wrong, or of another version.
    """
    tables, reconstruction = root / "sensors", root / "reconstruction"
    version = read_version(tables / "sensors.txt")
    sensors = read_sensors(tables / "sensors.txt")
    mounts = read_rigs(tables / "rigs.txt", sensors)
    devices = {*sensors, *mounts, *(mount.rig for on in mounts.values() for mount in on)}
    trajectories, depth_table = tables / "trajectories.txt", tables / "records_depth.txt"
    poses = read_trajectories(trajectories, devices) if trajectories.exists() else {}
    images = read_records(tables / "records_camera.txt", sensors, CAMERAS)
    if not images:
        raise DatasetError("holds no image; expected lines timestamp, device_id, path", tables / "records_camera.txt")
    depths: dict[int, list[Record]] = {}
    for record in read_records(depth_table, sensors, DEPTHS) if depth_table.exists() else ():
        depths.setdefault(record.timestamp, []).append(record)
    points, observed = np.zeros((0, 3)), {}
    if (reconstruction / "observations.txt").exists():
        points = read_points(reconstruction / "points3d.txt")
        observed = read_observations(reconstruction / "observations.txt", version, len(points))
    return KaptureFolder(root, sensors, mounts, poses, images, depths, points, observed)
