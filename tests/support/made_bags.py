"""Bags, written by the package rosbags message by message: ``from made_bags import Bag``."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from relocbench.arrays import Array
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin
from relocbench.datasets.sensors.geodesy import ECCENTRICITY2, prime_vertical_radius
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.geometry import transform_to_tq

CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
SECOND = 10**9
Storage = Literal["rosbag1", "rosbag2", "mcap"]
ORIGIN = GeodeticOrigin(51.75, -1.26, 60.0)
"""where the map of a recording is put on the globe"""


class Bag:
    """Messages that are collected, and written in the order of their times of receipt."""

    def __init__(self, ros1: bool = True) -> None:
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:
            self.store.register(
                get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
            )
        stamp = "time" if ros1 else "builtin_interfaces/Time"
        packet = get_types_from_msg(f"{stamp} stamp\nuint8[1206] data", "velodyne_msgs/msg/VelodynePacket")
        scan = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets"
        self.store.register({**packet, **get_types_from_msg(scan, "velodyne_msgs/msg/VelodyneScan")})
        self.rows: list[tuple[int, str, Any]] = []

    def new(self, kind: str, *values: Any) -> Any:
        package, name = kind.split("/")
        return self.store.types[f"{package}/msg/{name}"](*values)

    def header(self, time: int, frame: str) -> Any:
        stamp = self.new("builtin_interfaces/Time", time // SECOND, time % SECOND)
        return self.new("std_msgs/Header", *((0,) if self.ros1 else ()), stamp, frame)

    def add(self, topic: str, time: int, message: Any) -> None:
        self.rows.append((time, topic, message))

    def cloud(
        self,
        topic: str,
        time: int,
        points: NDArray[Any],
        frame: str = "lidar",
        received: int | None = None,
        **changes: Any,
    ) -> None:
        """A cloud of a structured array, whose layout becomes that of the message."""
        assert points.dtype.fields is not None
        fields = [
            self.new("sensor_msgs/PointField", name, int(place[1]), CODES[place[0].str[1:]], 1)
            for name, place in points.dtype.fields.items()
        ]
        step, count = points.dtype.itemsize, len(points)
        data = np.frombuffer(points.tobytes(), np.uint8)
        big = any(place[0].str[0] == ">" for place in points.dtype.fields.values())
        header = self.header(time, frame)
        message = self.new("sensor_msgs/PointCloud2", header, 1, count, fields, big, step, step * count, data, True)
        for name, value in changes.items():
            setattr(message, name, value)
        self.add(topic, time if received is None else received, message)

    def packets(self, topic: str, time: int, packets: Sequence[tuple[int, bytes]], frame: str = "lidar") -> None:
        """A scan of a Velodyne: nanoseconds and bytes of its packets."""
        found = [
            self.new(
                "velodyne_msgs/VelodynePacket",
                self.new("builtin_interfaces/Time", at // SECOND, at % SECOND),
                np.frombuffer(raw, np.uint8).copy(),
            )
            for at, raw in packets
        ]
        self.add(topic, time, self.new("velodyne_msgs/VelodyneScan", self.header(time, frame), found))

    def laser(self, topic: str, time: int, ranges: ArrayLike, frame: str = "lidar", **changes: float) -> None:
        values = {"angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.01, "time_increment": 1e-4,
                  "scan_time": 0.02, "range_min": 0.1, "range_max": 50.0} | changes  # fmt: skip
        found = np.asarray(ranges, dtype=np.float32)
        header = self.header(time, frame)
        self.add(
            topic, time, self.new("sensor_msgs/LaserScan", header, *values.values(), found, np.zeros(0, np.float32))
        )

    def image(self, topic: str, time: int, pixels: NDArray[Any], encoding: str, frame: str = "cam_optical") -> None:
        height, width = pixels.shape[:2]
        data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
        values = (self.header(time, frame), height, width, encoding, 0, len(data) // height, data)
        self.add(topic, time, self.new("sensor_msgs/Image", *values))

    def compressed(self, topic: str, time: int, data: bytes, told: str, frame: str = "cam_optical") -> None:
        found = np.frombuffer(data, np.uint8)
        self.add(topic, time, self.new("sensor_msgs/CompressedImage", self.header(time, frame), told, found))

    def info(
        self,
        topic: str,
        time: int,
        size: tuple[int, int],
        model: str = "plumb_bob",
        D: Sequence[float] = (0, 0, 0, 0, 0),
        K: Sequence[float] | None = None,
        **changes: Any,
    ) -> Any:
        width, height = size
        found = np.array(K or (50.0, 0, width / 2, 0, 50.0, height / 2, 0, 0, 1), dtype=np.float64)
        P = np.column_stack([found.reshape(3, 3), np.zeros(3)]).ravel()
        region = self.new("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
        coefficients = np.array(D, dtype=np.float64)
        values = (
            self.header(time, "cam_optical"),
            height,
            width,
            model,
            coefficients,
            found,
            np.eye(3).ravel(),
            P,
            0,
            0,
        )
        message = self.new("sensor_msgs/CameraInfo", *values, region)
        for name, value in changes.items():
            setattr(message, name, value)
        self.add(topic, time, message)
        return message

    def pose(self, values: Sequence[float]) -> Any:
        """tx, ty, tz, qx, qy, qz, qw"""
        point = self.new("geometry_msgs/Point", *map(float, values[:3]))
        return self.new("geometry_msgs/Pose", point, self.new("geometry_msgs/Quaternion", *map(float, values[3:])))

    def odometry(
        self, topic: str, time: int, values: Sequence[float], frame: str = "odom", child: str = "base_link"
    ) -> None:
        zero = self.new("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
        twist = self.new("geometry_msgs/TwistWithCovariance", self.new("geometry_msgs/Twist", zero, zero), np.zeros(36))
        pose = self.new("geometry_msgs/PoseWithCovariance", self.pose(values), np.zeros(36))
        self.add(topic, time, self.new("nav_msgs/Odometry", self.header(time, frame), child, pose, twist))

    def pose_stamped(self, topic: str, time: int, values: Sequence[float], frame: str = "map") -> None:
        self.add(topic, time, self.new("geometry_msgs/PoseStamped", self.header(time, frame), self.pose(values)))

    def transform(self, time: int, parent: str, child: str, values: Sequence[float]) -> Any:
        moved = self.new("geometry_msgs/Vector3", *map(float, values[:3]))
        turned = self.new("geometry_msgs/Quaternion", *map(float, values[3:]))
        rigid = self.new("geometry_msgs/Transform", moved, turned)
        return self.new("geometry_msgs/TransformStamped", self.header(time, parent), child, rigid)

    def tf(self, time: int, *links: tuple[str, str, Sequence[float]], topic: str = "/tf_static") -> None:
        found = [self.transform(time, *link) for link in links]
        self.add(topic, time, self.new("tf2_msgs/TFMessage", found))

    def fix(self, topic: str, time: int, place: Sequence[float], status: int = 0, frame: str = "base_link") -> None:
        state = self.new("sensor_msgs/NavSatStatus", status, 1)
        values = (self.header(time, frame), state, *map(float, place), np.diag([4.0, 4.0, 9.0]).ravel(), 2)
        self.add(topic, time, self.new("sensor_msgs/NavSatFix", *values))

    def write(self, path: Path, storage: str | None = None, compression: str = "", *, in_order: bool = True) -> Path:
        """Write the bag: ``rosbag1`` to a file; ``rosbag2`` or ``mcap`` to a folder.

        Args:
            in_order: by the times of receipt; else in the order of the rows.
        """
        made: Any
        if self.ros1:
            made = Writer1(path)
            if compression:
                made.set_compression(Writer1.CompressionFormat[compression])
            serialised = self.store.serialize_ros1
        else:
            plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
            made, serialised = Writer2(path, version=9, storage_plugin=plugin), self.store.serialize_cdr
        connections: dict[str, Any] = {}
        with contextlib.ExitStack() as stack:
            writer = stack.enter_context(made)
            for time, topic, message in sorted(self.rows, key=lambda row: row[0]) if in_order else self.rows:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(connections[topic], time, serialised(message, kind))
        return path

    def write_mcap(
        self,
        path: Path,
        profile: str,
        others: Mapping[str, tuple[str, str, bytes]] | None = None,
        *,
        messages_indexed: bool = True,
        statistics: bool = True,
        again_after: int = 0,
    ) -> Path:
        """Write an MCAP file by the package mcap.

        Args:
            others: topics with messages of other encodings: name of the schema, encoding, content.
            messages_indexed: else chunks alone are, of which there are several.
            statistics: write how many messages each topic has.
            again_after: write all messages once more, received so many nanoseconds later.
        """
        from mcap.writer import IndexType, Writer

        index = IndexType.ALL if messages_indexed else IndexType.CHUNK
        size = 2**20 if messages_indexed else 2000
        serialised = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=size, index_types=index, use_statistics=statistics)
            writer.start(profile=profile, library="")
            channels: dict[str, int] = {}
            rows = sorted(self.rows, key=lambda row: row[0])
            rows += [(time + again_after, *rest) for time, *rest in rows] if again_after else []
            for time, topic, message in rows:
                kind = message.__msgtype__
                if topic not in channels:
                    name = kind.replace("/msg/", "/") if self.ros1 else kind
                    text = self.store.generate_msgdef(kind)[0].encode()
                    schema = writer.register_schema(name, "ros1msg" if self.ros1 else "ros2msg", text)
                    channels[topic] = writer.register_channel(topic, "ros1" if self.ros1 else "cdr", schema)
                writer.add_message(channels[topic], time, bytes(serialised(message, kind)), time)
            for topic, (name, encoding, content) in (others or {}).items():
                channel = writer.register_channel(topic, encoding, writer.register_schema(name, encoding, b""))
                writer.add_message(channel, self.rows[0][0], content, self.rows[0][0])
            writer.finish()  # type: ignore[no-untyped-call]
        return path


def write_bag(recording: FieldRecording, path: Path, storage: Storage = "rosbag1") -> None:
    """Write a recording as a bag, without loss; its messages are held in memory.

    Topics: ``/LIDAR/points`` (with the nanoseconds ``t`` of each point after the stamp), ``/CAMERA/image_raw``,
    ``/CAMERA/camera_info``, ``/odometry``, ``/gnss/pose`` (in the map of the prior), ``/gnss/fix`` and ``/tf_static``.
    """
    bag = Bag(storage == "rosbag1")
    mounts = {lidar.name: lidar.T_rig_lidar for lidar in recording.lidars}
    mounts |= {f"{name}_optical": camera.T_rig_cam for name, camera in recording.cameras.items()}
    first = min(int(lidar.times_ns[0]) for lidar in recording.lidars)
    bag.tf(first, *(("base_link", frame, _numbers(T)) for frame, T in mounts.items()))
    for lidar in recording.lidars:
        for index, time in enumerate(lidar.times_ns.tolist()):
            scan = lidar.read(index)
            points = np.zeros(len(scan.points), [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("t", "<i4")])
            points["x"], points["y"], points["z"] = scan.points.T
            points["t"] = scan.times_ns - time
            bag.cloud(f"/{lidar.name}/points", time, points, lidar.name)
    for name, camera in recording.cameras.items():
        frame, K = f"{name}_optical", camera.camera.matrix.ravel().tolist()
        for index, time in enumerate(camera.times_ns.tolist()):
            picture = camera.read(index)
            bag.image(f"/{name}/image_raw", time, picture, "mono8" if picture.ndim == 2 else "rgb8", frame)
            size = picture.shape[1], picture.shape[0]
            bag.info(f"/{name}/camera_info", time, size, K=K, header=bag.header(time, frame))
    for time, T in zip(recording.odometry.times_ns.tolist(), recording.odometry.T_odom_rig, strict=True):
        bag.odometry("/odometry", time, _numbers(T))
    if recording.prior is not None:
        T_map_rig = recording.prior.T_odom_rig
        places = latitude_longitude(T_map_rig[:, :3, 3], ORIGIN).tolist()
        for time, T, place in zip(recording.prior.times_ns.tolist(), T_map_rig, places, strict=True):
            bag.pose_stamped("/gnss/pose", time, _numbers(T))
            bag.fix("/gnss/fix", time, place)
    bag.write(path, storage)


def _numbers(T: Array) -> list[float]:
    """tx, ty, tz, qx, qy, qz, qw"""
    return [*map(float, np.concatenate(transform_to_tq(T)))]


def latitude_longitude(enu: Array, origin: GeodeticOrigin) -> Array:
    """Latitudes and longitudes in degrees and altitudes in metres (N, 3) of positions (N, 3): the inverse.

    Latitude and altitude by fixed-point iteration, which gains more than two digits a step near the ground.
    """
    x, y, z = (origin.ecef + enu @ origin.R_enu_ecef).T
    level = np.hypot(x, y)
    phi, height = np.arctan2(z, level * (1 - ECCENTRICITY2)), np.zeros(len(x))
    for _ in range(8):
        normal = prime_vertical_radius(phi)
        height = level / np.cos(phi) - normal
        phi = np.arctan2(z, level * (1 - ECCENTRICITY2 * normal / (normal + height)))
    return np.column_stack([np.degrees(phi), np.degrees(np.arctan2(y, x)), height])
