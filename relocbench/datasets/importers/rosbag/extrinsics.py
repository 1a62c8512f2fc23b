"""``--extrinsics``: poses of sensors, and cameras, where a bag does not tell them.

The conventions are those of the generic folder's ``camera.yaml`` and ``lidar.yaml``.
"""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from relocbench.arrays import Array
from relocbench.datasets.core.schema import CameraEntry, Strict, Transform
from relocbench.datasets.importers.generic.scans import T_NEW_RIG, RigAxes
from relocbench.datasets.importers.rosbag.roles import CameraTopic, Roles
from relocbench.errors import ConfigError, DatasetError, available
from relocbench.files import load_yaml


class LidarEntry(Strict):
    """A lidar's pose on the rig."""

    T_rig_lidar: Transform


class PoseOnly(Strict):
    """A camera's pose on the rig; its intrinsics are those of its CameraInfo."""

    T_rig_cam: Transform


class Extrinsics(Strict):
    """The content of the file. Keys are topics, or the names that the table of topics gives to cameras and lidars."""

    rig_axes: RigAxes = "forward-left-up"
    lidars: dict[str, LidarEntry] = Field(default={})
    cameras: dict[str, CameraEntry | PoseOnly] = Field(default={})
    T_rig_odometry: Transform | None = None
    """pose on the rig of the frame whose motion the odometry tells"""
    T_rig_gnss: Transform | None = None
    """pose on the rig of the antenna"""

    @property
    def T_new_rig(self) -> Array:
        """(4, 4) from the file's rig axes to x forward, y left, z up."""
        return T_NEW_RIG[self.rig_axes]

    def lidar(self, name: str, topic: str) -> Array | None:
        """``T_rig_lidar`` (4, 4), if the file tells it."""
        entry = self.lidars.get(topic) or self.lidars.get(name)
        return None if entry is None else self.T_new_rig @ entry.T_rig_lidar.matrix

    def camera(self, topic: CameraTopic) -> tuple[CameraEntry | PoseOnly, Array] | None:
        """The entry of a camera and ``T_rig_cam`` (4, 4), if the file has one."""
        entry = self.cameras.get(topic.images) or self.cameras.get(topic.name)
        return None if entry is None else (entry, self.T_new_rig @ entry.T_rig_cam.matrix)

    def check_used(self, roles: Roles, path: Path) -> None:
        """Raise ConfigError if the file names a sensor that is not read."""
        lidars = {*roles.lidars, *roles.lidars.values()}
        cameras = {*roles.cameras, *(camera.images for camera in roles.cameras.values())}
        for name, known, what in [(n, lidars, "lidar") for n in self.lidars] + [
            (n, cameras, "camera") for n in self.cameras
        ]:
            if name not in known:
                raise ConfigError(f"no {what} {name!r} is read{available(name, sorted(known))}", path)


def read_extrinsics(path: Path | None) -> Extrinsics:
    """Read the file; without one, everything comes from the bag. Raises DatasetError with file and line."""
    return Extrinsics() if path is None else load_yaml(path, Extrinsics, "poses of sensors", DatasetError)
