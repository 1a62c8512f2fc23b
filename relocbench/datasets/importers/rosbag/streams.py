"""Scans and images of a bag, read one by one when needed. Streams are picklable: they hold places, no files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from relocbench.arrays import Array, Image, Mask, Times
from relocbench.datasets.core import images
from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.bag import Part, open_part, read_raw
from relocbench.datasets.importers.rosbag.clouds import cloud_fields, laser_points
from relocbench.datasets.importers.rosbag.packets import PacketReading, packet_points
from relocbench.datasets.importers.rosbag.pictures import image_of
from relocbench.datasets.sensors.point_times import PointTimes
from relocbench.datasets.sensors.recording import Scan
from relocbench.datasets.sensors.scan_files import in_range
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.errors import DatasetError
from relocbench.geometry import Camera


@dataclass(frozen=True, eq=False)
class Messages:
    """The messages of one topic, in the order of the stream."""

    files: tuple[Path, ...]
    topic: str
    type: str
    part: Times
    """(N,) index of the file"""
    received_ns: Times
    """(N,)"""
    ordinal: Times
    """(N,) number among the messages of the topic that were received at this time"""

    def read(self, index: int) -> tuple[Any, Part, int]:
        """A message, the part that it is in, and its time of receipt. Raises DatasetError with file, topic and time."""
        path, received = self.files[int(self.part[index])], int(self.received_ns[index])
        raw = read_raw(path, self.topic, received, int(self.ordinal[index]))
        part = open_part(path)
        return part.decode(self.topic, raw, received), part, received


@dataclass(frozen=True, eq=False)
class BagLidar:
    """The scans of one topic of PointCloud2, VelodyneScan or LaserScan."""

    name: str
    messages: Messages
    T_rig_lidar: Array
    times_ns: Times
    pattern: Literal["spinning", "push-broom"]
    times: PointTimes
    min_range_m: float
    max_range_m: float
    sigma_m: float
    packets: PacketReading = field(default_factory=PacketReading)
    timed: bool = True
    """points of packets have the times of their firings, not that of the scan"""

    def read(self, index: int) -> Scan:
        """Read a scan without the points that are not finite or out of range. Raises DatasetError with the file."""
        message, part, received = self.messages.read(index)
        stamp = int(self.times_ns[index])
        try:
            if self.messages.type != kinds.CLOUD:
                laser = self.messages.type == kinds.LASER
                points, offsets = laser_points(message) if laser else packet_points(message, self.packets)
                near = self.in_range(points)
                return Scan(points[near], stamp + offsets[near] * self.timed)
            wanted = ("x", "y", "z", self.times.field) if self.times.field else ("x", "y", "z")
            fields = cloud_fields(message, wanted)
            with np.errstate(invalid="ignore"):  # NaN of any kind are beams without a return
                points = np.column_stack([np.asarray(fields[axis], dtype=np.float64) for axis in "xyz"])
            near = self.in_range(points)
            points = points[near]
            values = fields[self.times.field][near] if self.times.field else None
            return Scan(points, self.times.at(values, points, stamp))
        except ValueError as bad:
            raise part.fault(self.messages.topic, received, str(bad)) from None

    def in_range(self, points: Array) -> Mask:
        """Which points (N, 3) are returns of a beam: finite, and neither too near nor too far."""
        return in_range(points, self.min_range_m, self.max_range_m)


@dataclass(frozen=True, eq=False)
class BagCamera:
    """The images of one topic, undistorted when read."""

    name: str
    messages: Messages
    distorted: Camera
    T_rig_cam: Array
    times_ns: Times

    @property
    def camera(self) -> Camera:
        return self.distorted.pinhole()

    def read(self, index: int) -> Image:
        """Read an undistorted image, (H, W) or (H, W, 3) RGB. Raises DatasetError with the file."""
        image, path = read_picture(self.messages, index)
        images.ExpectedSize(self.distorted.size, f"the first image of {self.messages.topic}").check(
            (image.shape[1], image.shape[0]), path
        )
        return undistort(image, self.distorted)

    def file(self, index: int) -> Path | None:
        """Always None: the images are in the bag."""
        return None


def read_picture(messages: Messages, index: int) -> tuple[Image, Path]:
    """An image as it was recorded, and its file. Raises DatasetError with file, topic and time."""
    message, part, received = messages.read(index)
    try:
        return image_of(messages.type, message, part.path), part.path
    except ValueError as bad:
        raise part.fault(messages.topic, received, str(bad)) from None
    except DatasetError as bad:
        raise part.fault(messages.topic, received, bad.expected) from None
