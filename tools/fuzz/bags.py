"""Readers of bags of ROS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fuzz.asking import write
from fuzz.parser import Parser, Place
from fuzz.sensors import read_all

if TYPE_CHECKING:
    from made_bags import Bag

_START = 1_700_000_000 * 10**9
_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4")])


def write_bags(root: Path) -> None:
    """One short drive in every format."""
    from made_bags import Bag

    for name, ros1, storage in (("one.bag", True, "rosbag1"), ("two", False, "rosbag2"), ("three", False, "mcap")):
        bag = Bag(ros1)
        sensors = [(frame, (0.5, 0.0, 1.5, -0.5, 0.5, -0.5, 0.5)) for frame in ("lidar", "cam_optical")]
        bag.tf(_START, *(("base_link", frame, pose) for frame, pose in sensors))
        for k in range(4):
            time = _START + k * 10**8
            points = np.zeros(12, _POINT)
            points["x"], points["y"], points["z"] = np.arange(12) + 1, 8.0, np.arange(12) % 5
            points["time"] = np.linspace(0, 0.09, 12)
            bag.cloud("/points", time, points)
            bag.odometry("/odom", time, (0.5 * k, 0, 0, 0, 0, 0, 1))
            bag.fix("/fix", time, (48.0, 11.5, 500.0))
            bag.image("/cam/image_raw", time, np.full((6, 8), k, np.uint8), "mono8")
            bag.info("/cam/camera_info", time, (8, 6))
        bag.write(root / name, storage)
        if ros1:
            bag.write_mcap(root / "four.mcap", "ros1")
            _kill_recorder(root / name, root / "five.bag.active")
            _blank(root / name, bag, root / "six.bag")
        elif storage == "rosbag2":
            bag.write_mcap(root / "seven.mcap", "ros2", messages_indexed=False)
    write(
        root / "extrinsics.yaml",
        "rig_axes: forward-left-up",
        "lidars:",
        "  /points: {T_rig_lidar: {translation_m: [1, 0, 1.8], quaternion_xyzw: [0, 0, 0, 1]}}",
        "cameras:",
        "  cam: {T_rig_cam: {translation_m: [1, 0, 1.5], quaternion_xyzw: [-0.5, 0.5, -0.5, 0.5]}}",
    )


def _kill_recorder(whole: Path, killed: Path) -> None:
    """A bag of ROS 1 without its index and the end of its last chunk."""
    data = whole.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[at : at + 8], "little")
    killed.write_bytes(data[:at] + bytes(8) + data[at + 8 : index])


def _blank(whole: Path, bag: Bag, blanked: Path) -> None:
    """A bag of ROS 1 whose clouds have an empty definition and the checksum of an empty text."""
    text, checksum = bag.store.generate_msgdef("sensor_msgs/msg/PointCloud2")
    data = whole.read_bytes().replace(text.encode(), b" " * len(text))
    blanked.write_bytes(data.replace(checksum.encode(), b"d41d8cd98f00b204e9800998ecf8427e"))


def _read(path: Path, place: Place, **settings: object) -> None:
    from relocbench.datasets.importers.rosbag.reading import BagSettings
    from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
    from relocbench.datasets.importers.rosbag.roles import Wanted

    how = BagSettings(wanted=Wanted(odometry="/odom"), **settings)  # type: ignore[arg-type]
    recording, _ = read_bag(open_bag(path, how.wanted), "drive", how, kept=place.out / "index.npz")
    read_all(recording)


def _rosbag1(place: Place) -> None:
    _read(place.root / "one.bag", place)


def _rosbag2(place: Place) -> None:
    _read(place.root / "two", place)


def _file(place: Place) -> None:
    _read(place.target, place)


def _extrinsics(place: Place) -> None:
    from relocbench.datasets.importers.rosbag.extrinsics import read_extrinsics

    told = place.root / "extrinsics.yaml"
    _read(place.root / "one.bag", place, extrinsics=read_extrinsics(told), extrinsics_file=told)


SEEDS = {"bags": write_bags}
PARSERS = (
    Parser("rosbag1", "bags", ("one.bag",), _rosbag1),
    Parser("rosbag2", "bags", ("two/*",), _rosbag2),
    Parser("rosbag2-mcap", "bags", ("three/*.mcap",), _file),
    Parser("mcap-ros1", "bags", ("four.mcap",), _file),
    Parser("rosbag1-unclosed", "bags", ("five.bag.active",), _file),
    Parser("rosbag1-undefined", "bags", ("six.bag",), _file),
    Parser("mcap-chunks-alone", "bags", ("seven.mcap",), _file),
    Parser("rosbag-extrinsics", "bags", ("extrinsics.yaml",), _extrinsics, text=True),
)
