"""Depth maps of kapture: 32-bit floats, row by row, metres from the plane of the sensor's origin, along z."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from relocbench.arrays import Floats
from relocbench.datasets.importers.kapture.folder import KaptureFolder
from relocbench.datasets.importers.kapture.tables import Record
from relocbench.datasets.importers.photos.collection import ModelPoints, Photo
from relocbench.datasets.sensors.undistortion import undistort
from relocbench.errors import DatasetError
from relocbench.files import read_bytes
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

_BYTES = 4
"""of a value"""


def read_depth_map(path: Path, size: tuple[int, int]) -> Floats:
    """A depth map (H, W) in metres, 0 where unknown: where the file's value is not finite or not positive.

    Args:
        size: width and height of its sensor, pixels.

    Raises:
        DatasetError: the file is missing or has not as many values as the sensor has pixels.
    """
    width, height = size
    wanted = _BYTES * width * height
    data = read_bytes(path, "a depth map", DatasetError, max(wanted, 1 << 30))
    if len(data) != wanted:
        raise DatasetError(f"holds {len(data)} bytes, expected {wanted} (32-bit floats, {width}x{height})", path)
    depth = np.frombuffer(data, dtype="<f4").reshape(height, width)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0.0)).astype(np.float32)


def seen_by(depth: Floats, sensor: Camera, camera: Camera) -> Floats:
    """The depth (H, W) that the pinhole camera of an image sees, 0 where unknown.

    A map of the same camera is undistorted. One of other intrinsics, such as a smaller one, puts each of its values
    into the pixel that shows it, the nearest one where several are shown by one pixel, and into no other.

    Args:
        depth: (h, w) metres along z, 0 where unknown.
        sensor: the camera of the depth map; it stands and looks as ``camera`` does.
    """
    if sensor == camera:
        return undistort(depth, camera, nearest=True)
    v, u = np.nonzero(depth)
    rays, valid = sensor.unproject(np.stack([u, v], axis=-1).astype(np.float64))
    valid = valid & (rays[:, 2] > 0)
    z = depth[v, u][valid]
    pinhole = camera.pinhole()
    pixels, shown = pinhole.project(rays[valid])  # of a pinhole, the pixel of a ray is that of every point on it
    shown = shown & pinhole.contains(pixels, border=-0.5 + 1e-9)
    column, row = np.rint(pixels[shown]).astype(np.int64).T
    found = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    np.minimum.at(found, (row, column), z[shown])
    return np.where(np.isfinite(found), found, np.float32(0.0))


@dataclass(frozen=True, eq=False)
class Depth:
    """The depth of a photo is that of a depth map, or else of the points that it observes."""

    folder: KaptureFolder
    maps: dict[str, Record]
    """photo name -> its depth map"""
    model: ModelPoints

    @property
    def unit(self) -> tuple[str, float]:
        return "depth maps in metres", 1.0

    def image(self, photo: Photo) -> Callable[[], Floats] | None:
        """What reads the depth map of a photo, if there is one."""
        record = self.maps.get(photo.name)
        return None if record is None else partial(self._read, record, photo)

    def _read(self, record: Record, photo: Photo) -> Floats:
        sensor = self.folder.camera(record.device)
        return seen_by(read_depth_map(self.folder.path(record), sensor.size), sensor, photo.camera)

    def points(self, photo: Photo) -> KeyframePoints | None:
        """The points that a photo observes; None if there are none."""
        return self.model.points(photo)
