"""Bags that look whole and are not, or look damaged and are whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from made_bags import SECOND, Bag
from odd_inputs import odd_input
from refusals import Notes, noted, refused

from relocbench.datasets.importers.rosbag.reading import BagSettings
from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import DatasetError

START = 1_700_000_000 * SECOND
SCANS = 12


def drive(ros1: bool = True, **cloud: Any) -> Bag:
    """A spinning lidar at 10 Hz and odometry at 20 Hz; ``cloud`` changes fields of all clouds."""
    bag = Bag(ros1)
    bag.tf(START, ("base_link", "lidar", (0, 0, 1, 0, 0, 0, 1)))
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    points = np.zeros(len(angle), [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    points["x"], points["y"], points["z"] = 10 * np.cos(angle), 10 * np.sin(angle), np.linspace(-1, 2, len(angle))
    for k in range(2 * SCANS):
        bag.odometry("/odom", START + k * SECOND // 20, (0.2 * k, 0, 0, 0, 0, 0, 1))
    for k in range(SCANS):
        bag.cloud("/points", START + k * SECOND // 10, points, **cloud)
    return bag


def read(path: Path) -> FieldRecording:
    return read_bag(open_bag(path, Wanted()), "drive", BagSettings(motion="compensated"))[0]


@pytest.mark.parametrize("statistics", [True, False])
def test_chunks_whose_messages_are_not_indexed_are_read(tmp_path: Path, statistics: bool) -> None:
    path = drive(ros1=False).write_mcap(tmp_path / "drive.mcap", "ros2", messages_indexed=False, statistics=statistics)
    recording = read(path)
    assert recording.lidars[0].times_ns.tolist() == [START + k * SECOND // 10 for k in range(SCANS)]
    assert len(recording.odometry.times_ns) == 2 * SCANS
    assert [len(recording.lidars[0].read(k).points) for k in (7, 2)] == [30, 30]


def test_the_recorded_bag_with_an_index_of_chunks_alone_is_read() -> None:
    for name in ("a.mcap", "b.mcap"):
        found = open_bag(odd_input("35_mcap_chunk_index_only") / name, Wanted()).survey.topics
        assert (found["/points"].count, found["/odom"].count) == (12, 80)
        assert not found["/points"].fault


@pytest.mark.parametrize("checksum", ["d41d8cd98f00b204e9800998ecf8427e", "0" * 32])
def test_an_empty_definition_is_that_of_the_types_name_whatever_its_checksum(tmp_path: Path, checksum: str) -> None:
    bag = drive()
    text, true_sum = bag.store.generate_msgdef("sensor_msgs/msg/PointCloud2")
    path = bag.write(tmp_path / "drive.bag")
    whole = path.read_bytes()
    emptied = whole.replace(text.encode(), b" " * len(text)).replace(true_sum.encode(), checksum.encode())
    assert emptied != whole
    path.write_bytes(emptied)
    assert len(read(path).lidars[0].times_ns) == SCANS
    path.write_bytes(whole.replace(true_sum.encode(), checksum.encode()))  # the definition tells that it is standard
    assert len(read(path).lidars[0].times_ns) == SCANS
    other = whole.replace(true_sum.encode(), checksum.encode()).replace(b"uint32 point_step", b"uint64 point_step")
    path.write_bytes(other)
    with refused(DatasetError, "drive.bag", None, "/points", "sensor_msgs/PointCloud2", "uint64 point_step", "uint32"):
        read(path)


@pytest.mark.parametrize("ros1", [True, False])
def test_packets_of_another_length_are_named_with_both_lengths(tmp_path: Path, ros1: bool) -> None:
    from rosbags.typesys import get_types_from_msg

    stamp = "time" if ros1 else "builtin_interfaces/Time"
    packet = get_types_from_msg(f"{stamp} stamp\nuint8[1248] data", "velodyne_msgs/msg/VelodynePacket")
    scan = get_types_from_msg(
        "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets", "velodyne_msgs/msg/VelodyneScan"
    )
    fresh = Bag(ros1)
    fresh.store.fielddefs.pop("velodyne_msgs/msg/VelodynePacket")
    fresh.store.fielddefs.pop("velodyne_msgs/msg/VelodyneScan")
    fresh.store.register({**packet, **scan})
    for k in range(SCANS):
        time = START + k * SECOND // 10
        fresh.packets("/packets", time, [(time, bytes(1248))])
        fresh.odometry("/odom", time, (0.2 * k, 0, 0, 0, 0, 0, 1))
    path = fresh.write(tmp_path / ("drive.bag" if ros1 else "drive"), "rosbag1" if ros1 else "mcap")
    with refused(DatasetError, path.name, None, "/packets", "velodyne_msgs/VelodynePacket", 1248, 1206):
        read(path)


def test_the_recorded_bag_with_the_checksum_of_an_empty_text_is_read() -> None:
    for name in ("a.bag", "b.bag"):
        found = open_bag(odd_input("38_md5_of_empty") / name, Wanted())
        assert found.roles.lidars == {"points": "/points"}


def test_a_bag_without_a_usable_lidar_says_why_each_topic_is_none(tmp_path: Path) -> None:
    with refused(DatasetError, "drive.bag", None, "/points", START, "9000"):
        read(drive(width=9000, point_step=12, row_step=12 * 9000).write(tmp_path / "drive.bag"))
    bag = drive()
    bag.rows = [row for row in bag.rows if row[1] != "/points"]
    flat = np.zeros(3, [("u", "<f4"), ("v", "<f4")])
    for k in range(SCANS):
        bag.cloud("/features", START + k * SECOND // 10, flat)
        bag.cloud("/map", START + k * SECOND // 10, np.zeros(3, [(a, "<f4") for a in "xyz"]), frame="odom")
    bag.laser("/slow", START, np.ones(20))
    bag.laser("/slow", START + SECOND, np.ones(20), frame="base_link")
    with refused(DatasetError, "drive_1.bag", None, "/features", "u, v", "x, y, z", "/map", "odom"):
        read(bag.write(tmp_path / "drive_1.bag"))


def unclosed(path: Path, cut: int, last_chunk_open: bool) -> Path:
    """A bag of ROS 1 as a killed recorder leaves it: without index, the last ``cut`` bytes not written."""
    data = path.read_bytes()
    at = data.index(b"index_pos=") + 10
    end = int.from_bytes(data[at : at + 8], "little")
    if last_chunk_open:  # neither its index nor its length was written
        begin = data.rindex(b"compression=none")
        head = data.index(b"size=", begin) + 5 if data[begin - 30 : begin].find(b"size=") < 0 else begin
        length_at = max(head + 4, begin + 16)
        length = int.from_bytes(data[length_at : length_at + 4], "little")
        end = length_at + 4 + length
        data = data[:length_at] + bytes(4) + data[length_at + 4 :]
    killed = path.with_suffix(".bag.active")
    killed.write_bytes(data[:at] + bytes(8) + data[at + 8 : end - cut])
    return killed


@pytest.mark.parametrize("compression", ["", "LZ4", "BZ2"])
def test_a_bag_whose_recorder_was_killed_is_read_in_the_order_of_the_file(tmp_path: Path, compression: str) -> None:
    whole = drive().write(tmp_path / "drive.bag", compression=compression)
    notes = Notes()
    found = open_bag(unclosed(whole, 0, False), Wanted(), notes)
    recording = read_bag(found, "drive", BagSettings(motion="compensated"))[0]
    expected = read(whole)
    assert recording.lidars[0].times_ns.tolist() == expected.lidars[0].times_ns.tolist()
    np.testing.assert_array_equal(recording.odometry.T_odom_rig, expected.odometry.T_odom_rig)
    for k in (5, 1):
        np.testing.assert_array_equal(recording.lidars[0].read(k).points, expected.lidars[0].read(k).points)
    assert noted(notes.notes, "drive.bag.active", str(3 * SCANS + 1))


def test_of_a_chunk_that_was_not_finished_the_whole_messages_are_read(tmp_path: Path) -> None:
    whole = drive().write(tmp_path / "drive.bag")
    notes = Notes()
    found = open_bag(unclosed(whole, 100, True), Wanted(), notes).survey
    count = sum(topic.count for topic in found.topics.values())
    assert count == 3 * SCANS
    assert noted(notes.notes, "drive.bag.active", str(count), "bytes")
    assert len(read(tmp_path / "drive.bag.active").lidars[0].times_ns) >= SCANS - 1


def test_a_chunk_of_unknown_compression_is_named(tmp_path: Path) -> None:
    whole = drive().write(tmp_path / "drive.bag", compression="LZ4")
    data = whole.read_bytes().replace(b"compression=lz4", b"compression=xyz")
    whole.write_bytes(data)
    with refused(DatasetError, "drive.bag", None, "xyz"):
        read(whole)
    with refused(DatasetError, "drive.bag.active", None, "xyz", "lz4"):
        read(unclosed(whole, 0, False))


@pytest.mark.parametrize("storage", ["rosbag1", "rosbag2", "mcap"])
def test_a_recording_that_was_looped_is_refused_at_its_second_run(tmp_path: Path, storage: str) -> None:
    first = drive(storage == "rosbag1")
    for shift, looped in ((SECOND // 2, True), (-4 * SECOND, False)):
        bag = drive(storage == "rosbag1")
        rows = sorted(first.rows, key=lambda row: row[0])
        again = [(time + shift - SECOND, topic, message) for time, topic, message in rows]
        bag.rows = [*rows, *again]
        path = bag.write(tmp_path / f"{looped}{'.bag' * (storage == 'rosbag1')}", storage, in_order=False)
        if looped:
            with refused(DatasetError, path.name, None, START - SECOND // 2):
                read(path)
        else:
            assert open_bag(path, Wanted()).survey.topics["/points"].count == 2 * SCANS


def test_an_mcap_file_of_ros_1_that_was_looped_is_refused(tmp_path: Path) -> None:
    path = drive().write_mcap(tmp_path / "drive.mcap", "ros1", again_after=-SECOND // 2)
    with refused(DatasetError, path.name, None, START - SECOND // 2):
        read(path)


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("fault", ["stamps", "poses", "beside", "frames"])
def test_two_runs_or_publishers_that_are_mixed_in_one_topic_are_refused(tmp_path: Path, ros1: bool, fault: str) -> None:
    """Of another day, at the same times, some milliseconds beside them, or of another lidar."""
    bag = drive(ros1)
    for k in range(2 * SCANS):
        time = START + k * SECOND // 20
        if fault == "frames":
            bag.cloud("/points", time + SECOND // 90, np.zeros(3, [(a, "<f4") for a in "xyz"]), frame="rear")
            continue
        stamp = time + {"stamps": 5000 * SECOND, "poses": 0, "beside": SECOND // 50}[fault]
        bag.odometry("/odom", stamp, (-0.2 * k, 80, 0, 0, 0, 0, 1))
        bag.rows[-1] = (time + SECOND // 50, *bag.rows[-1][1:])
    path = bag.write(tmp_path / ("drive.bag" if ros1 else "drive"), "rosbag1" if ros1 else "mcap")
    told = {"stamps": ("/odom", "5000 s"), "poses": ("/odom", "80.5 m", START), "beside": (), "frames": ("rear",)}
    with refused(DatasetError, path.name, None, *told[fault]):
        read(path)


def test_a_topic_that_falls_silent_is_noted(tmp_path: Path) -> None:
    bag = drive()
    for k in range(2 * SCANS, 400):
        bag.odometry("/odom", START + k * SECOND // 20 + 5 * SECOND * (k > 200), (0.2 * k, 0, 0, 0, 0, 0, 1))
    notes = Notes()
    opened = open_bag(bag.write(tmp_path / "drive.bag"), Wanted(lidars=("/points",)))
    read_bag(opened, "drive", BagSettings(motion="compensated"), reporter=notes)
    assert noted(notes.notes, "/points", "23.9 s")
    assert noted(notes.notes, "/odom", "5.0 s", START + 10 * SECOND)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("Fisheye", 4), ("kannala_brandt", 5), ("equidistant", 8), ("rational_polynomial", 8), ("omni", 5), ("mei", 4)],
)
def test_wide_cameras_are_undistorted_or_refused_by_name(tmp_path: Path, model: str, coefficients: int) -> None:
    """Coefficients beyond those of the model are zeros, as some drivers pad them."""
    known = 4 if "rational" not in model else 8
    D = [0.05, -0.01, 0.002, 0.001, 0.01, 0.02, 0.003, 0.001][:known] + [0.0] * (coefficients - known)
    bag = drive()
    bag.tf(START, ("base_link", "cam_optical", (0.5, 0, 1, -0.5, 0.5, -0.5, 0.5)))
    grid = np.kron(np.indices((6, 8)).sum(axis=0) % 2 * 200, np.ones((8, 8))).astype(np.uint8)
    for k in range(SCANS):
        bag.image("/cam/image_raw", START + k * SECOND // 10, grid, "mono8")
        bag.info("/cam/camera_info", START + k * SECOND // 10, (64, 48), model, D)
    path = bag.write(tmp_path / "drive.bag")
    settings = BagSettings(Wanted(cameras=("cam",)), motion="compensated")
    opened = open_bag(path, settings.wanted)
    if model in ("omni", "mei"):
        with refused(DatasetError, "drive.bag", None, "/cam/camera_info", model, coefficients, "equidistant"):
            read_bag(opened, "drive", settings)
        return
    camera = read_bag(opened, "drive", settings)[0].cameras["cam"]
    assert camera.camera.model == "pinhole"
    K, lens = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), np.array(D[:known])
    if known == 4:
        maps = cv2.fisheye.initUndistortRectifyMap(K, lens, np.eye(3), K, (64, 48), cv2.CV_32FC1)
    else:
        maps = cv2.initUndistortRectifyMap(K, lens, np.eye(3), K, (64, 48), cv2.CV_32FC1)
    inside = (maps[0] >= 0) & (maps[0] <= 63) & (maps[1] >= 0) & (maps[1] <= 47)
    expected = cv2.remap(grid, maps[0], maps[1], cv2.INTER_LINEAR)
    difference = np.abs(camera.read(3).astype(int) - expected.astype(int))[inside]
    assert inside.mean() > 0.5
    assert difference.max() <= 8
