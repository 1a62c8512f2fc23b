"""The drives of ``recorded_street`` written as logs of the Ford Multi-AV Seasonal dataset, by its description alone.

Poses of the lidars are those of the dataset's own URDF (``fusion_description``, github.com/Ford/AVData).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from lidar_layouts import Mounted, pose_times, write
from made_bags import Bag
from recorded_street import StreetDrive
from scipy.spatial.transform import Rotation
from velodyne_packets import BLOCK_US, ELEVATION_DEG, FIRING_US, PACKET_US, packet

from relocbench.arrays import Array
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.lidar import Lidar, LidarScene
from relocbench.datasets.synthetic.lidar.lidar import scan as simulate
from relocbench.geometry import make_transform, transform_to_tq

Axes = Literal["ros", "velodyne"]
TURN_NS = 100_000_000
PACKETS = 180
"""of a turn in 0.1 s"""
EVERY = 8
"""one block of so many has returns"""
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
T_CAR_BODY = make_transform(np.diag([1.0, -1.0, -1.0]), [-1.3, 0.0, 0.35])
"""of the rear axle below the drive's car"""
URDF = {
    "lidar_red": ((1.12706, -0.40647, -1.33966), (-3.139, 0.0086, 1.5774)),
    "lidar_yellow": ((1.11239, -0.531997, -1.21451), (-3.1413, 0.4440, 1.5695)),
    "lidar_green": ((1.11862, 0.506078, -1.22352), (-3.1302, -0.4406, 1.5691)),
    "lidar_blue": ((1.11524, 0.367061, -1.33293), (-3.1338, -0.0038, 1.5667)),
    "camera_front_left": ((1.184931, -0.332952, -1.203022), (1.5651, -0.0066, 1.5833)),
    "camera_side_left": ((1.224634, -0.449533, -1.123144), (1.5757, -0.0041, 0.1495)),
    "camera_side_right": ((1.242781, 0.410513, -1.127880), (1.5723, 0.0007, 2.9603)),
    "camera_rear_left": ((1.050033, -0.297993, -1.198604), (1.5569, 0.0133, -1.5919)),
}
"""position and roll, pitch, yaw of sensors on the body"""


def urdf_pose(name: str) -> Array:
    """``T_body_sensor``; angles of URDF are about the fixed axes x, y, z."""
    position, rpy = URDF[name]
    return make_transform(Rotation.from_euler("xyz", rpy).as_matrix(), np.array(position))


@dataclass(frozen=True)
class Made:
    """A log that was written."""

    folder: Path
    bag: Path
    calibration: Path


def calibration_file(sensor: str) -> str:
    """``lidar_red`` is ``lidarRed_body.yaml``."""
    first, *rest = sensor.split("_")
    return f"{first}{''.join(word.capitalize() for word in rest)}_body.yaml"


def stamped(T_body_sensor: Array, sensor: str) -> dict[str, Any]:
    t, q = (v.tolist() for v in transform_to_tq(T_body_sensor))
    return {
        "header": {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": "body"},
        "child_frame_id": sensor,
        "transform": {
            "translation": dict(zip("xyz", t, strict=True)),
            "rotation": dict(zip("xyzw", q, strict=True)),
        },
    }


def write_yaml(path: Path, values: Mapping[str, Any]) -> None:
    """JSON is YAML."""
    write(path, json.dumps(values, indent=1))


def turn_packets(
    drive: StreetDrive, scene: LidarScene, T_car_lidar: Array, start_ns: int, axes: Axes, seed: int
) -> list[tuple[int, bytes]]:
    """The packets of a turn, which begins with azimuth 90 degrees."""
    since_us = np.arange(12 * PACKETS) * BLOCK_US
    fired = np.arange(0, len(since_us), EVERY)
    at_us = since_us[fired, None] + np.arange(32) * FIRING_US
    azimuth = np.radians(90.0 + at_us * 1e-6 * 3600.0)
    level = np.cos(np.radians(ELEVATION_DEG))
    across, along = np.sin(azimuth) * level, np.cos(azimuth) * level
    up = np.broadcast_to(np.sin(np.radians(ELEVATION_DEG)), across.shape)
    directions = np.stack([along, -across, up] if axes == "ros" else [across, along, up], axis=-1).reshape(-1, 3)
    offsets = np.rint(at_us * 1000).astype(np.int64).ravel()
    model = Lidar(directions, offsets, TURN_NS, 0.02, 1.1, 90.0, 50.0)
    found = simulate(model, scene, Mounted(drive, T_car_lidar), start_ns, Factors(), np.random.default_rng(seed))
    ranges = np.zeros((len(since_us), 32))
    hits = np.where(found.returned, np.linalg.norm(found.points, axis=1), 0.0)
    ranges[fired] = hits.reshape(-1, 32)
    hundredths = np.rint((90.0 + since_us * 1e-6 * 3600.0) * 100).astype(np.int64)
    out = []
    for k in range(PACKETS):
        block = slice(12 * k, 12 * k + 12)
        time = start_ns + round(k * PACKET_US * 1000)
        out.append((time, packet(hundredths[block], ranges[block], time // 1000)))
    return out


def write_ford(
    drive: StreetDrive,
    root: Path,
    scene: LidarScene,
    name: str = "2017-08-04-V2-Log1",
    lidars: tuple[str, ...] = ("lidar_red", "lidar_yellow"),
    axes: Axes = "velodyne",
) -> Made:
    """Write ``DATE/VEHICLE/LOG`` with bag and images, and the calibration of the vehicle."""
    *date, vehicle, log = name.split("-")
    folder = root / "-".join(date) / vehicle / log
    calibration = root / f"Calibration-{vehicle}" / vehicle
    bag = Bag()
    times = pose_times(drive, 5_000_000)
    T_ned_body = DOWN @ north_west_up(drive.T_world_car(times)) @ T_CAR_BODY
    for time, row in zip(times.tolist(), np.hstack(transform_to_tq(T_ned_body)).tolist(), strict=True):
        bag.pose_stamped("/pose_ground_truth", time, row)
        bag.pose_stamped("/pose_raw", time, [*(v + 0.4 for v in row[:3]), *row[3:]])
        bag.tf(time, ("map", "body", row), topic="/tf")
        bag.fix("/gps", time, (42.3, -83.1, 150.0), frame="gps")
    for k, sensor in enumerate(lidars):
        T_body_lidar = urdf_pose(sensor)
        write_yaml(calibration / calibration_file(sensor), stamped(T_body_lidar, sensor))
        for number, start in enumerate(pose_times(drive, TURN_NS).tolist()[:-2]):
            packets = turn_packets(drive, scene, T_CAR_BODY @ T_body_lidar, start, axes, 100 * k + number)
            bag.packets(f"/{sensor}_scan", packets[-1][0], packets, sensor)
    camera = drive.layout.cameras["camera"].camera
    T_body_cam = np.linalg.inv(T_CAR_BODY) @ drive.T_car_cam
    write_yaml(calibration / "cameraFrontLeft_body.yaml", stamped(T_body_cam, "camera_front_left"))
    projection = np.column_stack([camera.matrix, np.zeros(3)]).ravel().tolist()
    intrinsics = {"height": camera.height, "width": camera.width, "K": camera.matrix.ravel().tolist()}
    write_yaml(calibration / "cameraFrontLeftIntrinsics.yaml", intrinsics | {"D": [0.0] * 5, "P": projection})
    paths = sorted((drive.folder / "camera").iterdir())
    for time, path in zip(drive.layout.times["camera"].tolist(), paths, strict=True):
        write(folder / f"{name}-FL" / f"{time // 1000}.png", path.read_bytes())
        pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert pixels is not None
        small = cv2.resize(pixels, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        bag.image("/image_front_left", time, small, "bgr8", "camera_front_left")
    bag.write(folder / f"{name}.bag")
    return Made(folder, folder / f"{name}.bag", calibration)


def north_west_up(T_world_car: Array) -> Array:
    """The drive in a map whose x axis points north, which is not that of the street, and far from its origin."""
    turn = make_transform(Rotation.from_euler("z", 40, degrees=True).as_matrix(), [1200.0, -3400.0, 25.0])
    return np.asarray(turn @ T_world_car)
