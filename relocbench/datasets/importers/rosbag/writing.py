"""Writing a recording as a bag, without loss: for tests, and to show a recording to the tools of ROS.

Topics: ``/LIDAR/points`` (PointCloud2, x, y, z as float64 and the nanoseconds ``t`` of each point after the stamp),
``/CAMERA/image_raw`` and ``/CAMERA/camera_info``, ``/odometry`` (Odometry), ``/gnss/pose`` (PoseStamped in the map of
the prior), ``/gnss/fix`` (NavSatFix, positions alone) and ``/tf_static``.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.definitions import typestore
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin, latitude_longitude
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, LidarStream, Trajectory
from relocbench.errors import ConfigError, available
from relocbench.geometry import transform_to_tq

Storage = Literal["rosbag1", "rosbag2", "mcap"]
ORIGIN = GeodeticOrigin(51.75, -1.26, 60.0)
"""where the map of a recording is put on the globe"""
_BASE = "base_link"
_FIELDS = (("x", 0, 8), ("y", 8, 8), ("z", 16, 8), ("t", 24, 5))
"""name, offset and type of the fields of a cloud: 8 is float64, 5 int32"""
_POINT = np.dtype({"names": ["x", "y", "z", "t"], "formats": ["<f8"] * 3 + ["<i4"], "itemsize": 28})

Messages = Iterator[tuple[int, str, Any]]
"""time in nanoseconds, topic, message"""


def write_bag(recording: FieldRecording, path: Path, storage: Storage = "rosbag1") -> None:
    """Write a recording as a bag.

    Args:
        path: the file (``rosbag1``) or folder (``rosbag2`` with SQLite, ``mcap``) to make.

    Raises:
        ConfigError: the path exists, or there is no such storage.
    """
    if storage not in get_args(Storage):
        raise ConfigError(f"no storage '{storage}'{available(storage, get_args(Storage))}")
    if path.exists():
        raise ConfigError("exists already; expected a new file or folder", path)
    made = _Messages(storage == "rosbag1")
    streams = [made.static(recording)]
    streams += [made.clouds(lidar) for lidar in recording.lidars]
    streams += [made.images(camera) for camera in recording.cameras.values()]
    streams.append(made.poses(recording.odometry, "/odometry", kinds.ODOMETRY, "odom"))
    if recording.prior is not None:
        streams.append(made.poses(recording.prior, "/gnss/pose", kinds.POSE, "map"))
        streams.append(made.fixes(recording.prior))
    with _writer(path, storage) as writer:
        connections: dict[str, Any] = {}
        for time, topic, message in heapq.merge(*streams, key=lambda row: row[0]):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=made.store)
            writer.write(connections[topic], time, made.serialised(message, kind))


def _writer(path: Path, storage: Storage) -> Any:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    if storage == "rosbag1":
        return Writer1(path)
    return Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3)


class _Messages:
    """Makes messages of ROS 1 or 2."""

    def __init__(self, ros1: bool) -> None:
        self.ros1, self.store = ros1, typestore(ros1)
        self.serialised: Callable[[Any, str], bytes] = self.store.serialize_ros1 if ros1 else self.store.serialize_cdr

    def _new(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def _header(self, time: int, frame: str) -> Any:
        stamp = self._new("builtin_interfaces/msg/Time", time // 10**9, time % 10**9)
        return self._new("std_msgs/msg/Header", *((0,) if self.ros1 else ()), stamp, frame)

    def _pose(self, T: Array) -> Any:
        t, q = (v.tolist() for v in transform_to_tq(T))
        point = self._new("geometry_msgs/msg/Point", *t)
        return self._new("geometry_msgs/msg/Pose", point, self._new("geometry_msgs/msg/Quaternion", *q))

    def static(self, recording: FieldRecording) -> Messages:
        mounts = {lidar.name: lidar.T_rig_lidar for lidar in recording.lidars}
        mounts |= {f"{name}_optical": camera.T_rig_cam for name, camera in recording.cameras.items()}
        time = min(int(lidar.times_ns[0]) for lidar in recording.lidars)
        transforms = []
        for frame, T in mounts.items():
            pose = self._pose(T)
            vector = self._new("geometry_msgs/msg/Vector3", pose.position.x, pose.position.y, pose.position.z)
            moved = self._new("geometry_msgs/msg/Transform", vector, pose.orientation)
            transforms.append(self._new(kinds.TRANSFORM, self._header(time, _BASE), frame, moved))
        yield time, "/tf_static", self._new(kinds.TRANSFORMS, transforms)

    def clouds(self, lidar: LidarStream) -> Messages:
        fields = [self._new("sensor_msgs/msg/PointField", name, offset, code, 1) for name, offset, code in _FIELDS]
        for index, time in enumerate(lidar.times_ns.tolist()):
            scan = lidar.read(index)
            points = np.zeros(len(scan.points), _POINT)
            for axis, values in zip("xyz", scan.points.T, strict=True):
                points[axis] = values
            points["t"] = scan.times_ns - time
            data = np.frombuffer(points.tobytes(), dtype=np.uint8)
            header, width, size = self._header(time, lidar.name), len(points), _POINT.itemsize
            cloud = self._new(kinds.CLOUD, header, 1, width, fields, False, size, width * size, data, True)
            yield time, f"/{lidar.name}/points", cloud

    def images(self, camera: CameraStream) -> Messages:
        frame = f"{camera.name}_optical"
        found = camera.camera
        region = self._new("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        matrix = found.matrix
        projection = np.column_stack([matrix, np.zeros(3)]).ravel()
        for index, time in enumerate(camera.times_ns.tolist()):
            picture = camera.read(index)
            height, width = picture.shape[:2]
            encoding = "mono8" if picture.ndim == 2 else "rgb8"
            row = width * (1 if picture.ndim == 2 else 3)
            header = self._header(time, frame)
            data = np.ascontiguousarray(picture).reshape(-1)
            image = self._new(kinds.IMAGE, header, height, width, encoding, 0, row, data)
            info = self._new(
                kinds.CAMERA_INFO, header, height, width, "plumb_bob", np.zeros(5), matrix.ravel(), np.eye(3).ravel(),
                projection, 0, 0, region,
            )  # fmt: skip
            yield time, f"/{camera.name}/image_raw", image
            yield time, f"/{camera.name}/camera_info", info

    def poses(self, trajectory: Trajectory, topic: str, kind: str, frame: str) -> Messages:
        zero = self._new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        still = self._new("geometry_msgs/msg/Twist", zero, zero)
        for time, T in zip(trajectory.times_ns.tolist(), trajectory.T_odom_rig, strict=True):
            header, pose = self._header(time, frame), self._pose(T)
            if kind == kinds.POSE:
                yield time, topic, self._new(kind, header, pose)
                continue
            uncertain = self._new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
            speed = self._new("geometry_msgs/msg/TwistWithCovariance", still, np.zeros(36))
            yield time, topic, self._new(kind, header, _BASE, uncertain, speed)

    def fixes(self, prior: Trajectory) -> Messages:
        status = self._new("sensor_msgs/msg/NavSatStatus", 0, 1)
        places = latitude_longitude(prior.T_odom_rig[:, :3, 3], ORIGIN)
        for time, place in zip(prior.times_ns.tolist(), places.tolist(), strict=True):
            header = self._header(time, _BASE)
            yield time, "/gnss/fix", self._new(kinds.FIX, header, status, *place, np.diag([4.0, 4.0, 9.0]).ravel(), 2)
