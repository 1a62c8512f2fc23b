"""Bags written by the package rosbags, read as recordings: topics, frames, times, streams and faults."""

from __future__ import annotations

import gc
import os
import pickle
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import relocbench
from made_bags import SECOND, Bag, latitude_longitude
from numpy.typing import NDArray
from refusals import ErrorData, Notes, noted, refused

from relocbench.datasets.core.schema import Transform
from relocbench.datasets.groundtruth.odometry.deferred import computed, is_pending, later
from relocbench.datasets.importers.rosbag.bag import Part, parts_of
from relocbench.datasets.importers.rosbag.extrinsics import read_extrinsics
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin, east_north_up
from relocbench.datasets.importers.rosbag.reading import BagSettings
from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Trajectory
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import invert, make_transform, se3_exp, transform_from_tq, transform_to_tq
from relocbench.progress import SILENT, Reporter, Silent

START = 1_700_000_000 * SECOND
SCANS = 12
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])
LIDAR = (1.0, 0.0, 1.8, 0.0, 0.0, 0.0, 1.0)
OPTICAL = (0.5, 0.1, 1.5, -0.5, 0.5, -0.5, 0.5)
"""x right, y down, z forward on a rig with x forward, y left, z up"""
FORMATS = ("rosbag1", "rosbag2", "mcap")


def points(k: int, count: int = 40) -> NDArray[Any]:
    """A scan whose points have the times of a turn."""
    out = np.zeros(count, POINT)
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    out["x"], out["y"], out["z"] = 10 * np.cos(angle) + k, -10 * np.sin(angle), np.linspace(-1, 2, count)
    out["time"], out["ring"] = angle / (2 * np.pi) * 0.1, np.arange(count) % 16
    return out


def pose_at(k: int) -> tuple[float, ...]:
    t, q = transform_to_tq(se3_exp(np.array([0.5 * k, 0.01 * k, 0.0, 0.0, 0.0, 0.02 * k])))
    return (*t.tolist(), *q.tolist())


def drive(ros1: bool = True, **without: bool) -> Bag:
    """A spinning lidar, a camera, odometry, fixes and transforms of one second of road; parts can be left out."""
    bag = Bag(ros1)
    if without.get("tf", True):
        bag.tf(START, ("base_link", "lidar", LIDAR), ("base_link", "cam_optical", OPTICAL))
    for k in range(SCANS):
        time = START + k * SECOND // 10
        if without.get("lidar", True):
            bag.cloud("/points", time, points(k))
        if without.get("odometry", True):
            bag.odometry("/odom", time, pose_at(k))
        if without.get("camera", True):
            bag.image("/cam/image_raw", time + 5, np.full((8, 12, 3), k, np.uint8), "rgb8")
            bag.info("/cam/camera_info", time + 5, (12, 8))
    return bag


def read(path: Path, notes: Reporter = SILENT, wanted: Wanted | None = None, **settings: Any) -> FieldRecording:
    how = BagSettings(wanted=wanted or Wanted(), **settings)
    opened = open_bag(path, how.wanted, notes)
    return read_bag(opened, "drive", how, reporter=notes)[0]


@pytest.fixture(params=FORMATS)
def write(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[Callable[[bool], Bag]], Path]:
    """Writes a bag in each of the formats."""

    def written(made: Callable[[bool], Bag]) -> Path:
        ros1 = request.param == "rosbag1"
        return made(ros1).write(tmp_path / ("a drive.bag" if ros1 else "a drive"), request.param)

    return written


def test_every_format_gives_the_recording_that_was_written(write: Callable[..., Path]) -> None:
    notes = Notes()
    recording = read(write(drive), notes)
    (lidar,) = recording.lidars
    assert (lidar.pattern, lidar.name) == ("spinning", "points")
    assert np.allclose(lidar.T_rig_lidar, transform_from_tq(LIDAR[:3], LIDAR[3:]))
    assert lidar.times_ns.tolist() == [START + k * SECOND // 10 for k in range(SCANS)]
    for k in (7, 3, 3, 4, 11, 0):  # in any order
        scan, there = lidar.read(k), points(k)
        assert np.array_equal(scan.points, np.column_stack([there[a].astype(float) for a in "xyz"]))
        assert np.abs(scan.times_ns - lidar.times_ns[k] - there["time"] * 1e9).max() < 20
    camera = recording.cameras["cam"]
    assert camera.camera.size == (12, 8)
    assert np.allclose(camera.T_rig_cam, transform_from_tq(OPTICAL[:3], OPTICAL[3:]))
    assert [int(camera.read(k)[0, 0, 0]) for k in (5, 2, 11)] == [5, 2, 11]
    T = np.array([transform_from_tq(p[:3], p[3:]) for p in map(pose_at, range(SCANS))])
    assert np.allclose(recording.odometry.T_odom_rig, invert(T[0]) @ T, atol=1e-12)
    assert "points: spinning lidar, times of points: field 'time', s from the scan's stamp" in notes
    assert "the rig is the frame 'base_link'" in notes


def test_streams_are_picklable_and_read_the_same_elsewhere(write: Callable[..., Path]) -> None:
    recording = read(write(drive))
    again = pickle.loads(pickle.dumps(recording))
    assert np.array_equal(again.lidars[0].read(5).points, recording.lidars[0].read(5).points)
    assert np.array_equal(again.cameras["cam"].read(5), recording.cameras["cam"].read(5))


@pytest.mark.parametrize(("ros1", "profile"), [(True, "ros1"), (True, ""), (False, "")])
def test_mcap_of_ros_1_and_without_a_profile_is_read_too(tmp_path: Path, ros1: bool, profile: str) -> None:
    recording, plain = (
        read(drive(ros1).write_mcap(tmp_path / "d.mcap", profile)),
        read(drive().write(tmp_path / "d.bag")),
    )
    assert np.allclose(recording.odometry.T_odom_rig, plain.odometry.T_odom_rig)
    assert len(recording.lidars[0].times_ns) == SCANS
    for k in (8, 2, 3):
        assert np.array_equal(recording.lidars[0].read(k).points, plain.lidars[0].read(k).points)
        assert np.array_equal(recording.lidars[0].read(k).times_ns, plain.lidars[0].read(k).times_ns)
        assert np.array_equal(recording.cameras["cam"].read(k), plain.cameras["cam"].read(k))


def test_topics_of_other_encodings_are_listed_and_not_read(tmp_path: Path) -> None:
    bag, notes = drive(), Notes()
    path = bag.write_mcap(tmp_path / "d.mcap", "ros1", others={"/scene": ("foxglove.SceneUpdate", "protobuf", b"abc")})
    assert len(read(path, notes).lidars) == 1
    assert "/scene            foxglove.SceneUpdate (protobuf)" in notes
    data = path.read_bytes()
    for length in (30, len(data) // 2, len(data) - 9):
        path.write_bytes(data[:length])
        with refused(DatasetError, "d.mcap"):
            read(path)


def test_compressed_chunks_are_read(tmp_path: Path) -> None:
    for compression in ("BZ2", "LZ4"):
        path = drive().write(tmp_path / f"{compression}.bag", compression=compression)
        assert len(read(path).lidars[0].read(3).points) == 40


def test_messages_that_were_received_at_one_time_are_told_apart(tmp_path: Path) -> None:
    bag = drive(lidar=False)
    for k in range(SCANS):
        bag.cloud("/points", START + k * SECOND // 10, points(k), received=START + (k // 3) * SECOND // 2)
    lidar = read(bag.write(tmp_path / "burst.bag")).lidars[0]
    assert [round(float(lidar.read(k).points[0, 0])) for k in range(SCANS)] == [10 + k for k in range(SCANS)]
    assert [round(float(lidar.read(k).points[0, 0])) for k in (8, 7, 1)] == [18, 17, 11]


def test_a_folder_of_files_is_one_drive_and_files_far_apart_are_not(tmp_path: Path) -> None:
    whole = drive()
    folder = tmp_path / "split"
    folder.mkdir()
    for k, name in enumerate(("drive_0.bag", "drive_1.bag")):
        part = Bag()
        part.rows = [row for row in whole.rows if (row[0] >= START + SECOND // 2) == bool(k)]
        part.write(folder / name)
    recording = read(folder)
    assert len(recording.lidars[0].times_ns) == SCANS
    assert round(float(recording.lidars[0].read(9).points[0, 0])) == 19
    late = Bag()
    late.odometry("/odom", START + 500 * SECOND, pose_at(0))
    late.write(folder / "drive_2.bag")
    with refused(DatasetError, "drive_2.bag", None, "drive_1.bag"):
        read(folder)


def test_the_index_is_kept_and_made_anew_for_other_files_and_topics(tmp_path: Path) -> None:
    bag, kept = drive(), tmp_path / "index.npz"
    for k in range(SCANS):
        bag.pose_stamped("/cam/pose", START + k * SECOND // 10, pose_at(k))
    path = bag.write(tmp_path / "drive.bag")

    stages: list[str] = []

    class Stages(Notes):
        def stage(self, description: str, total: int) -> Any:
            stages.append(description)
            return super().stage(description, total)

    def again(wanted: Wanted | None = None) -> FieldRecording:
        how = BagSettings(wanted=wanted or Wanted())
        return read_bag(open_bag(path, how.wanted), "drive", how, kept=kept, reporter=Stages())[0]

    first, content = again(), kept.read_bytes()
    second = again()
    assert stages == ["reading drive.bag"]
    assert kept.read_bytes() == content
    assert np.array_equal(first.odometry.T_odom_rig, second.odometry.T_odom_rig)
    assert np.array_equal(first.lidars[0].read(4).points, second.lidars[0].read(4).points)
    kept.write_bytes(content[:200])
    again()
    assert kept.read_bytes() == content
    assert len(stages) == 2
    os.utime(path, ns=(START, START))
    again()
    assert len(stages) == 3
    again(Wanted(gnss="/cam/pose", lidars=("/points",)))
    assert len(stages) == 4


def test_guesses_say_why_and_take_the_rectified_images(tmp_path: Path) -> None:
    bag = drive()
    for k in range(SCANS):
        time = START + k * SECOND // 10
        bag.image("/cam/image_rect", time, np.full((8, 12), k, np.uint8), "mono8")
        bag.image("/depth/image_raw", time, np.full((8, 12), k, np.uint16), "16UC1")
        bag.cloud("/map_cloud", time, points(k), frame="odom")
        bag.cloud("/points/plain", time, points(k)[["x", "y", "z"]].astype([(a, "<f4") for a in "xyz"]))
    notes = Notes()
    recording = read(bag.write(tmp_path / "many.bag"), notes)
    assert [lidar.messages.topic for lidar in recording.lidars] == ["/points"]  # type: ignore[attr-defined]
    assert recording.cameras["cam"].read(2).ndim == 2
    for words in (
        "camera       images of the camera 'cam'",
        "same camera as /cam/image_rect",
        "depth (16UC1)",
        "is in the frame odom, not in that of a sensor",
        "same frame as /points, without times",
        "the only topic with odometry",
    ):
        assert words in notes, words


@pytest.mark.parametrize(
    ("change", "wanted", "complaint"),
    [
        (
            lambda bag, t: bag.odometry("/ekf", t, pose_at(0)),
            Wanted(),
            ("", None, "--odometry"),
        ),
        (
            lambda bag, t: bag.cloud("/again", t, points(0)),
            Wanted(),
            ("", None, "lidar", "--lidars"),
        ),
        (None, Wanted(odometry="/nothing"), ("", None, "/nothing", "--odometry")),
        (None, Wanted(lidars=("/odom",)), ("", None, "--lidars", "nav_msgs/Odometry", "sensor_msgs/PointCloud2")),
        (None, Wanted(cameras=("/points",)), ("", None, "--cameras", "sensor_msgs/PointCloud2")),
        (None, Wanted(gnss="/cam/image_raw"), ("", None, "--gnss", "cam/image_raw", "sensor_msgs/Image")),
        (None, Wanted(odometry="tf"), ("", None, "base_link", "--odometry")),
    ],
)
def test_what_cannot_be_decided_is_refused_by_the_option_that_decides(
    tmp_path: Path, change: Callable[[Bag, int], None] | None, wanted: Wanted, complaint: ErrorData
) -> None:
    bag = drive()
    for k in range(SCANS if change else 0):
        assert change is not None
        change(bag, START + k * SECOND // 10)
    with refused((DatasetError, ConfigError), *complaint):
        read(bag.write(tmp_path / "drive.bag"), wanted=wanted)


def test_odometry_in_a_map_is_not_guessed_where_there_is_a_continuous_one(tmp_path: Path) -> None:
    bag, notes = drive(), Notes()
    for k in range(SCANS):
        bag.odometry("/odometry/gps", START + k * SECOND // 10, pose_at(2 * k), frame="map")
    recording = read(bag.write(tmp_path / "drive.bag"), notes)
    assert recording.odometry.T_odom_rig[-1, 0, 3] < 0.6 * SCANS
    assert "poses in the frame 'map' may jump" in notes
    alone = drive(odometry=False)
    for k in range(SCANS):
        alone.pose_stamped("/gnss/pose", START + k * SECOND // 10, pose_at(k), frame="map")
        alone.tf(START + k * SECOND // 10, ("odom", "base_link", pose_at(k)), topic="/tf")
    notes = Notes()
    read(alone.write(tmp_path / "alone.bag"), notes)
    assert "odometry is that of tf" in notes


def test_topics_by_name_are_taken_as_they_are(tmp_path: Path) -> None:
    bag = drive()
    for k in range(SCANS):
        bag.pose_stamped("/pose", START + k * SECOND // 10, pose_at(2 * k))
        bag.laser("/scan", START + k * SECOND // 10, np.linspace(1, 5, 200))
    path = bag.write(tmp_path / "drive.bag")
    recording = read(path, wanted=Wanted(lidars=("/scan", "points"), odometry="/pose", gnss="/odom"))
    assert [lidar.pattern for lidar in recording.lidars] == ["push-broom", "spinning"]
    assert recording.odometry.T_odom_rig[-1, 0, 3] > 1.5 * 0.5 * SCANS
    assert recording.prior is not None
    scan = recording.lidars[0].read(1)
    assert abs(np.ptp(scan.times_ns) - 199 * 100_000) < 10
    assert recording.lidars[0].max_range_m == 50.0


def test_links_are_chained_and_fixed_ones_may_come_again_and_again_on_tf(tmp_path: Path) -> None:
    bag = drive(tf=False, odometry=False)
    bag.tf(START, ("base_link", "mast", (0, 0, 2, 0, 0, 0, 1)), ("cam_optical", "cam_body", (0, 0, 0, 0, 0, 0, 1)))
    bag.tf(START, ("base_link", "cam_optical", OPTICAL))
    for k in range(SCANS):
        time = START + k * SECOND // 10
        bag.tf(time, ("lidar", "mast", (-1, 0, 0, 0, 0, 0, 1)), topic="/tf")
        bag.tf(time, ("odom", "/base_link", pose_at(k)), ("map", "odom", pose_at(3 * k)), topic="/tf")
    notes = Notes()
    recording = read(bag.write(tmp_path / "drive.bag"), notes)
    assert np.allclose(recording.lidars[0].T_rig_lidar, make_transform(np.eye(3), [1.0, 0.0, 2.0]))
    assert "odometry is that of tf, 'base_link' in 'odom'" in notes
    last = pose_at(SCANS - 1)
    assert np.allclose(recording.odometry.T_odom_rig[-1], transform_from_tq(last[:3], last[3:]))


def test_odometry_of_another_frame_is_moved_to_the_rig(tmp_path: Path) -> None:
    bag = drive(odometry=False)
    T_base_imu = se3_exp(np.array([0.3, -0.2, 0.5, 0.1, 0.2, 1.0]))
    t, q = transform_to_tq(T_base_imu)
    bag.tf(START, ("base_link", "imu", (*t.tolist(), *q.tolist())))
    T_odom_base = np.array([transform_from_tq(p[:3], p[3:]) for p in map(pose_at, range(SCANS))])
    for k, T in enumerate(T_odom_base @ T_base_imu):
        t, q = transform_to_tq(T)
        bag.odometry("/odom", START + k * SECOND // 10, (*t.tolist(), *q.tolist()), child="imu")
    recording = read(bag.write(tmp_path / "drive.bag"))
    assert np.allclose(recording.odometry.T_odom_rig, invert(T_odom_base[0]) @ T_odom_base, atol=1e-12)


def test_a_missing_transform_names_both_frames(tmp_path: Path) -> None:
    bag = drive(tf=False)
    bag.tf(START, ("base_link", "cam_optical", OPTICAL))
    path = bag.write(tmp_path / "drive.bag")
    with refused(DatasetError, "", None, "base_link", "lidar", "tf_static"):
        read(path, base_frame="base_link")
    with refused(DatasetError, "", None, "car", "--base-frame", "base_link", "cam_optical"):
        read(path, base_frame="car")


EXTRINSICS = """
lidars:
  /points: {T_rig_lidar: {translation_m: [1.0, 0.0, 1.8], quaternion_xyzw: [0, 0, 0, 1]}}
cameras:
  cam: {T_rig_cam: {translation_m: [0.5, 0.1, 1.5], quaternion_xyzw: [-0.5, 0.5, -0.5, 0.5]}}
"""


def test_without_tf_a_file_gives_the_poses_of_sensors(tmp_path: Path) -> None:
    path, told = drive(tf=False).write(tmp_path / "drive.bag"), tmp_path / "extrinsics.yaml"
    told.write_text(EXTRINSICS)
    recording = read(path, extrinsics=read_extrinsics(told), extrinsics_file=told)
    plain = read(drive().write(tmp_path / "with_tf.bag"))
    assert np.allclose(recording.lidars[0].T_rig_lidar, plain.lidars[0].T_rig_lidar)
    assert np.allclose(recording.cameras["cam"].T_rig_cam, plain.cameras["cam"].T_rig_cam)
    assert np.allclose(recording.odometry.T_odom_rig, plain.odometry.T_odom_rig)
    told.write_text(EXTRINSICS.replace("/points", "/velodyne"))
    with refused(ConfigError, "extrinsics.yaml", None, "/velodyne"):
        read(path, extrinsics=read_extrinsics(told), extrinsics_file=told)
    told.write_text(EXTRINSICS.replace("T_rig_lidar", "T_lidar_rig"))
    with refused(DatasetError, "extrinsics.yaml", 3, "lidars./points.T_rig_lidar"):
        read_extrinsics(told)


def test_rig_axes_of_a_camera_are_turned_to_those_of_a_vehicle(tmp_path: Path) -> None:
    told = tmp_path / "extrinsics.yaml"
    T_rig_cam = Transform(translation_m=(0.0, 0.0, 0.0), quaternion_xyzw=(0.0, 0.0, 0.0, 1.0))
    told.write_text(
        "rig_axes: right-down-forward\ncameras:\n  cam: {T_rig_cam: {translation_m: [0, 0, 0], quaternion_xyzw: "
        f"{list(T_rig_cam.quaternion_xyzw)}}}}}\nlidars:\n  points: {{T_rig_lidar: {{translation_m: [0, 0.5, 0], "
        "quaternion_xyzw: [-0.5, 0.5, -0.5, -0.5]}}\n"
    )
    recording = read(drive(tf=False).write(tmp_path / "d.bag"), extrinsics=read_extrinsics(told), extrinsics_file=told)
    assert np.allclose(recording.cameras["cam"].T_rig_cam[:3, 2], [1, 0, 0])
    assert np.allclose(recording.lidars[0].T_rig_lidar[:3, 3], [0, 0, -0.5])


def test_a_camera_frame_with_the_axes_of_a_vehicle_is_noticed(tmp_path: Path) -> None:
    bag = drive(tf=False)
    bag.tf(START, ("base_link", "lidar", LIDAR), ("base_link", "camera_link", (0.5, 0, 1.5, 0, 0, 0, 1)))
    for k in range(SCANS):
        bag.image("/front/image_raw", START + k, np.zeros((8, 12, 3), np.uint8), "rgb8", frame="camera_link")
        bag.info("/front/camera_info", START + k, (12, 8))
    path = bag.write(tmp_path / "drive.bag")
    with refused(DatasetError, "", None, "camera_link", "front/image_raw"):
        read(path, wanted=Wanted(cameras=("front",)))
    notes = Notes()
    assert "front" not in read(path, notes).cameras
    assert "the camera 'front' is not read" in notes


def zero(time: int, k: int) -> int:
    return 0


def backwards(time: int, k: int) -> int:
    return time - (k % 2) * SECOND // 2


def second_run(time: int, k: int) -> int:
    return time - (k >= SCANS // 2) * 2 * SECOND


@pytest.mark.parametrize("stamps", [zero, backwards, second_run])
def test_stamps_that_cannot_be_right_give_way_to_times_of_receipt(
    tmp_path: Path, stamps: Callable[[int, int], int]
) -> None:
    bag, notes = drive(lidar=False), Notes()
    for k in range(SCANS):
        time = START + k * SECOND // 10
        bag.cloud("/points", stamps(time, k), points(k), received=time)
    lidar = read(bag.write(tmp_path / "drive.bag"), notes).lidars[0]
    assert lidar.times_ns.tolist() == [START + k * SECOND // 10 for k in range(SCANS)]
    assert "stamps" in notes


def test_a_scan_that_came_twice_is_left_out_and_counted(tmp_path: Path) -> None:
    bag, notes = drive(), Notes()
    bag.cloud("/points", START + 2 * SECOND // 10, points(99), received=START + 2 * SECOND)
    lidar = read(bag.write(tmp_path / "drive.bag"), notes).lidars[0]
    assert len(lidar.times_ns) == SCANS
    assert round(float(lidar.read(2).points[0, 0])) == 12
    assert "1 of 13 messages are left out" in notes


def test_messages_without_a_pose_are_left_out_and_counted(tmp_path: Path) -> None:
    bag, notes = drive(), Notes()
    bag.odometry("/odom", START + SECOND // 3, [np.nan] * 7)
    odometry = read(bag.write(tmp_path / "drive.bag"), notes).odometry
    assert START + SECOND // 3 not in odometry.times_ns.tolist()
    assert noted(notes.notes, "1 of", "NaN")


def test_stamps_of_different_clocks_are_refused(tmp_path: Path) -> None:
    bag = drive(lidar=False)
    for k in range(SCANS):
        bag.cloud("/points", 100 * SECOND + k * SECOND // 10, points(k), received=START + k * SECOND // 10)
    path = bag.write(tmp_path / "drive.bag")
    with refused(DatasetError, "", None, "/points", "--stamps"):
        read(path)
    assert read(path, stamps="receive").lidars[0].times_ns[0] == START


def test_scans_without_times_are_compensated_or_turned_by_azimuth(tmp_path: Path) -> None:
    bag = drive(lidar=False)
    for k in range(SCANS):
        plain = points(k)[["x", "y", "z"]].astype([(a, "<f4") for a in "xyz"])
        bag.cloud("/points", START + k * SECOND // 10, plain)
    path, notes = bag.write(tmp_path / "drive.bag"), Notes()
    assert np.ptp(read(path, notes).lidars[0].read(3).times_ns) == 0
    assert "none: scans are taken as motion compensated" in notes
    scan = read(path, motion="distorted").lidars[0].read(0)
    assert 0.9 * SECOND / 10 < np.ptp(scan.times_ns) < SECOND / 10


def test_points_without_a_return_are_left_out(tmp_path: Path) -> None:
    bag = drive(lidar=False)
    for k in range(SCANS):
        found = points(k)
        found["x"][3], found["y"][4] = np.nan, np.inf
        found["x"][5] = found["y"][5] = found["z"][5] = 0
        found["x"][6], found["time"][3] = 1e30, np.nan
        bag.cloud("/points", START + k * SECOND // 10, found)
    assert len(read(bag.write(tmp_path / "drive.bag")).lidars[0].read(1).points) == 36


def test_beams_without_a_return_do_not_hide_the_unit_of_the_times(tmp_path: Path) -> None:
    bag, notes = drive(lidar=False), Notes()
    kind = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", "<f8")])
    for k in range(SCANS):
        time, there = START + k * SECOND // 10, points(k)
        found = np.zeros(40, kind)
        for axis in "xyz":
            found[axis] = there[axis]
        found["timestamp"] = time / 1e9 + there["time"].astype(np.float64)
        found[::5] = 0
        bag.cloud("/points", time, found)
    lidar = read(bag.write(tmp_path / "drive.bag"), notes).lidars[0]
    assert "field 'timestamp', s since 1970" in notes
    assert len(lidar.read(2).points) == 32


def test_flat_scans_are_push_broom_and_odd_times_name_the_option(tmp_path: Path) -> None:
    bag = drive(lidar=False)
    for k in range(SCANS):
        found = points(k)
        found["z"], found["x"] = 0, found["x"] - k
        found["time"] *= 1e-3
        bag.cloud("/points", START + k * SECOND // 10, found)
    path = bag.write(tmp_path / "drive.bag")
    with refused(DatasetError, "", None, "time", "--point-time"):
        read(path)
    assert read(path, motion="compensated").lidars[0].pattern == "push-broom"


def test_positions_on_the_globe_and_back() -> None:
    origin = GeodeticOrigin(51.75, -1.26, 60.0)
    there = np.array([[0, 0, 0], [1000.0, -2000.0, 30.0], [-30_000.0, 40_000.0, 100.0]])
    assert np.abs(east_north_up(latitude_longitude(there, origin), origin) - there).max() < 1e-6
    # One degree of latitude at the equator is 110574.4 m, and of longitude 111319.5 m (WGS 84).
    at = east_north_up(np.array([[1e-3, 0, 0], [0, 1e-3, 0]]), GeodeticOrigin(0, 0, 0))
    assert np.allclose(at, [[0, 110.5743, 0], [111.3195, 0, 0]], atol=2e-3)


def test_fixes_become_poses_in_a_map_that_drives_share(tmp_path: Path) -> None:
    """Headings follow from the odometry, also where the rig reverses; the antenna's place on the rig is heeded."""
    origin, antenna = GeodeticOrigin(48.12, 11.56, 500.0), np.array([-0.5, 0.3, 1.0])
    yaw = np.cos(2.1), np.sin(2.1)
    T_map_odom = make_transform(np.array([[yaw[0], -yaw[1], 0], [yaw[1], yaw[0], 0], [0, 0, 1]]), [300.0, -200.0, 5.0])
    bag, truth, times = drive(odometry=False, lidar=False), [], []
    bag.tf(START, ("base_link", "gps", (*antenna.tolist(), 0, 0, 0, 1)))
    for k in range(60):
        x = 1.0 * k if k < 40 else 78.0 - 1.0 * k
        T = make_transform(np.eye(3), [x, 0.02 * x**2 / 10, 0.0])
        time = START + k * SECOND // 10
        t, q = transform_to_tq(T)
        bag.odometry("/odom", time, (*t.tolist(), *q.tolist()))
        bag.cloud("/points", time, points(0))
        place = latitude_longitude((T_map_odom @ T @ np.append(antenna, 1))[None, :3], origin)[0]
        bag.fix("/fix", time, place.tolist(), status=-1 if k == 7 else 0, frame="gps")
        times.append(time)
        truth.append(T_map_odom @ T)
    path, notes = bag.write(tmp_path / "drive.bag"), Notes()
    how = BagSettings()
    recording, start = read_bag(open_bag(path, how.wanted), "drive", how, origin=origin, reporter=notes)
    assert start == origin
    how_later = BagSettings(wanted=Wanted(odometry="lidar"))
    pending, _ = read_bag(open_bag(path, how_later.wanted), "drive", how_later, origin=origin, from_lidar=later)
    assert is_pending(pending)
    assert pending.prior is None
    whole = computed(pending, lambda lidar, reporter=None, /, *, max_gap_ns=0: recording.odometry, Silent())
    assert whole.prior is not None
    assert recording.prior is not None
    np.testing.assert_array_equal(whole.prior.T_odom_rig, recording.prior.T_odom_rig)
    prior = recording.prior
    assert isinstance(prior, Trajectory)
    assert len(prior.times_ns) == 59
    kept = np.array(times) != times[7]
    assert np.abs(prior.T_odom_rig - np.array(truth)[kept]).max() < 1e-4
    assert "1 messages without a fix are left out" in notes
    alone = read_bag(open_bag(path, how.wanted), "drive", how)[1]
    assert alone == GeodeticOrigin(48.12, 11.56, 506.0)
    assert (
        alone == GeodeticOrigin(48.12, 11.56, 504.0)
        or alone == GeodeticOrigin(48.12, 11.56, 505.0)
        or alone is not None
    )


@pytest.fixture
def whole(tmp_path: Path) -> dict[str, Path]:
    bags = {
        name: drive(name == "rosbag1").write(tmp_path / f"{name}{'.bag' if name == 'rosbag1' else ''}", name)
        for name in FORMATS
    }
    return {"bag": bags["rosbag1"], "db3": bags["rosbag2"] / "rosbag2.db3", "mcap": bags["mcap"] / "mcap.mcap"}


def test_single_files_of_a_folder_are_recordings_too(whole: dict[str, Path]) -> None:
    for path in whole.values():
        assert len(read(path).lidars[0].times_ns) == SCANS


def damaged(data: bytes) -> Iterator[tuple[str, bytes]]:
    yield "empty", b""
    yield "cut", data[: len(data) // 2]
    yield "cut at its end", data[:-20]
    yield "other", b"\0" * 4000
    rng = np.random.default_rng(1)
    for number in range(12):
        noise = np.frombuffer(data, np.uint8).copy()
        at = int(rng.integers(0, len(noise) - 200))
        noise[at : at + 200] = rng.integers(0, 256, 200)
        yield f"overwritten {number}", noise.tobytes()


def everything_of(path: Path) -> str:
    """Read all scans of a bag; what is said if that fails."""
    try:
        for lidar in read(path).lidars:
            for index in range(len(lidar.times_ns)):
                lidar.read(index)
    except DatasetError as bad:
        return str(bad)
    return ""


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_damaged_file_is_one_line_with_its_name(whole: dict[str, Path], tmp_path: Path, kind: str) -> None:
    data, refused = whole[kind].read_bytes(), 0
    for name, content in damaged(data):
        path = tmp_path / f"{name}.{kind}"
        path.write_bytes(content)
        told = everything_of(path)
        if told:
            refused += 1
            assert name in told
            assert "\n" not in told
    assert refused >= 4


def test_files_are_closed_when_nothing_refers_to_them(whole: dict[str, Path], tmp_path: Path) -> None:
    paths = [*whole.values(), drive().write_mcap(tmp_path / "of ros 1.mcap", "ros1")]
    for path in tuple(paths):
        paths.append(tmp_path / f"damaged {path.name}")
        paths[-1].write_bytes(path.read_bytes()[:-200])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for path in paths:
            with suppress(DatasetError):
                next(Part(path).messages(["/points"]))
        gc.collect()
    assert [str(one.message) for one in caught if one.category is ResourceWarning] == []


def data_end(data: bytes) -> int:
    """Where the index of a bag of ROS 1 begins."""
    return int.from_bytes(data[(at := data.index(b"index_pos=") + 10) : at + 8], "little")


def test_truncated_bags_say_what_helps(whole: dict[str, Path], tmp_path: Path) -> None:
    data = whole["bag"].read_bytes()
    cut_bag = tmp_path / "cut.bag"
    cut_bag.write_bytes(data[: len(data) // 2])
    with refused(DatasetError, "cut.bag", None, len(data) // 2, data_end(data), "rosbag reindex"):
        read(cut_bag)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole["mcap"].read_bytes()[:-500])
    with refused(DatasetError, "cut.mcap", None, "mcap recover"):
        read(cut)


def test_what_is_no_bag_is_told(tmp_path: Path) -> None:
    with refused(DatasetError, "nothing.bag", None, "missing"):
        parts_of(tmp_path / "nothing.bag")
    (tmp_path / "drive.txt").write_text("")
    with refused(DatasetError, "drive.txt", None, "db3"):
        parts_of(tmp_path / "drive.txt")
    folder = tmp_path / "folder"
    folder.mkdir()
    with refused(DatasetError, folder, None, "no bag", ".bag"):
        parts_of(folder)
    drive(ros1=False).write(folder / "summer")
    with refused(DatasetError, folder, None, "summer"):
        parts_of(folder)
    (folder / "a.bag").touch()
    (folder / "b.mcap").touch()
    with refused(DatasetError, folder, None, "several formats", ".bag", ".mcap"):
        parts_of(folder)
    metadata = folder / "summer" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("compression_mode: ''", "compression_mode: FILE"))
    with refused(DatasetError, "metadata.yaml", None, "ros2 bag convert"):
        parts_of(folder / "summer")


def test_an_empty_bag_and_one_without_lidar_are_told(tmp_path: Path) -> None:
    with refused(DatasetError, "empty.bag", None, "message"):
        read(Bag().write(tmp_path / "empty.bag"))
    with refused(DatasetError, "blind.bag", None, "lidar"):
        read(drive(lidar=False).write(tmp_path / "blind.bag"))


def test_packets_name_what_converts_them(tmp_path: Path) -> None:
    from rosbags.typesys import get_types_from_msg

    bag = drive(lidar=False)
    definition = "std_msgs/Header header\nuint8[] packets"
    bag.store.register(get_types_from_msg(definition, "ouster_ros/msg/PacketMsg"))
    for k in range(SCANS):
        time = START + k * SECOND // 10
        bag.add(
            "/ouster_packets",
            time,
            bag.new("ouster_ros/PacketMsg", bag.header(time, "lidar"), np.zeros(4, np.uint8)),
        )
    path = bag.write(tmp_path / "drive.bag")
    with refused(DatasetError, "", None, "ouster_packets", "ouster_ros"):
        read(path)
    with refused(ConfigError, "", None, "--lidars", "ouster_packets", "ouster_ros/PacketMsg"):
        read(path, wanted=Wanted(lidars=("/ouster_packets",)))


def test_a_damaged_message_names_topic_and_time(tmp_path: Path) -> None:
    bag = drive()
    k = 4
    next(m for t, name, m in bag.rows if name == "/points" and t == START + k * SECOND // 10).width = 9000
    lidar = read(bag.write(tmp_path / "drive.bag")).lidars[0]
    with refused(DatasetError, "drive.bag", None, "/points", START + k * SECOND // 10):
        lidar.read(k)


def test_a_topic_that_nobody_needs_may_be_unreadable(tmp_path: Path) -> None:
    bag, notes = drive(), Notes()
    for k in range(SCANS):
        bag.laser("/other_scan", START + k * SECOND // 10, np.linspace(1, 5, 20))
    path = bag.write(tmp_path / "drive.bag")
    checksum = bag.store.generate_msgdef("sensor_msgs/msg/LaserScan")[1].encode()
    content = path.read_bytes().replace(checksum, b"0" * len(checksum))
    path.write_bytes(content.replace(b"float32 scan_time", b"float64 scan_time"))
    assert len(read(path, notes).lidars) == 1
    assert noted(notes.notes, "cannot be read", "/other_scan", "sensor_msgs/LaserScan", "float64 scan_time", "float32")
    with refused(DatasetError, "drive.bag", None, "--lidars", "other_scan", "sensor_msgs/LaserScan"):
        read(path, wanted=Wanted(lidars=("/other_scan",)))


def test_an_impossible_pose_names_topic_and_time(tmp_path: Path) -> None:
    bag = drive()
    bag.odometry("/odom", START + 2 * SECOND, (0, 0, 0, 0, 0, 0, 0))
    with refused(DatasetError, "drive.bag", None, "/odom", START + 2 * SECOND):
        read(bag.write(tmp_path / "drive.bag"))


def test_distorted_and_compressed_images_are_undistorted_when_read(tmp_path: Path) -> None:
    bag = drive(camera=False)
    picture = np.zeros((40, 60, 3), np.uint8)
    picture[10:30, 15:45] = (250, 120, 10)
    for k in range(SCANS):
        data = cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
        bag.compressed("/cam/image_raw/compressed", START + k * SECOND // 10, data, "bgr8; png compressed bgr8")
        bag.info("/cam/camera_info", START + k * SECOND // 10, (60, 40), D=(-0.3, 0.1, 0, 0, 0))
    camera = read(bag.write(tmp_path / "drive.bag")).cameras["cam"]
    image = camera.read(0)
    assert camera.camera.model == "pinhole"
    assert camera.file(0) is None
    assert image.shape == (40, 60, 3)
    assert not np.array_equal(image, picture)
    assert image[20, 30].tolist() == [250, 120, 10]


def test_odometry_is_computed_from_a_spinning_lidar_where_there_is_none(tmp_path: Path) -> None:
    asked: list[LidarStream] = []

    def made(lidar: LidarStream, reporter: Any = None, /, *, max_gap_ns: int = 0) -> Trajectory:
        asked.append(lidar)
        return Trajectory(lidar.times_ns, np.tile(np.eye(4), (len(lidar.times_ns), 1, 1)), max_gap_ns)

    path, how = drive(odometry=False).write(tmp_path / "drive.bag"), BagSettings()
    recording, _ = read_bag(open_bag(path, how.wanted), "drive", how, from_lidar=made)
    assert [lidar.name for lidar in asked] == ["points"]
    assert len(recording.odometry.times_ns) == SCANS


def test_the_faults_of_all_bags_are_told_before_odometry_is_computed(tmp_path: Path) -> None:
    paths = []
    for name in ("summer", "winter"):
        bag = drive(odometry=False)
        clouds = [message for _, topic, message in bag.rows if topic == "/points"]
        clouds[-1].width = 9000
        paths.append(bag.write(tmp_path / f"{name}.bag"))
    out = tmp_path / "out"
    outcome = relocbench(
        "build-dataset", "rosbag", *paths, "--cameras", "none", "--motion", "compensated", "--out", out
    )
    assert outcome.status == 2
    for name in ("summer", "winter"):
        assert f"{name}.bag: /points, message received at" in outcome.err
    assert "odometry from" not in outcome.err
    assert not (out / "groundtruth" / "odometry").exists()
