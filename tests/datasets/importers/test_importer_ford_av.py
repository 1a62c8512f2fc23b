"""Logs of the Ford Multi-AV Seasonal dataset: conventions by the true depth, axes of the lidars, faults, a build."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from ford_layout import URDF, Made, calibration_file, stamped, urdf_pose, write_ford, write_yaml
from made_bags import Bag
from projected_depth import agrees
from recorded_street import SMALL, StreetDrive, assert_pairs_are_right, errors_of, from_poses
from refusals import ErrorData, Notes, assert_names, noted, refused

from relocbench.datasets.importers.ford_av.calibration import read_camera_pose, read_lidar_pose
from relocbench.datasets.importers.ford_av.files import find_logs
from relocbench.datasets.importers.ford_av.recording import ReadingOptions, read_ford
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import invert

NAMES = ("2017-08-04-V2-Log1", "2017-10-26-V2-Log1")


@pytest.fixture(scope="module")
def logs(drives: list[StreetDrive], scene: LidarScene, tmp_path_factory: pytest.TempPathFactory) -> list[Made]:
    root = tmp_path_factory.mktemp("ford logs") / "Ford AV"
    return [write_ford(drive, root, scene, name) for drive, name in zip(drives, NAMES, strict=True)]


def read(source: Path, how: ReadingOptions | None = None, calibration: Path | None = None) -> tuple[DriveFiles, Notes]:
    spoken = Notes()
    return read_ford(find_logs([source], calibration)[0], how or ReadingOptions(), spoken), spoken


@pytest.mark.thorough
@pytest.mark.parametrize("lidar", [0, 1], ids=["red", "yellow, tilted to the side"])
def test_lidar_points_are_where_the_camera_sees_their_surfaces(
    drives: list[StreetDrive], logs: list[Made], scene: LidarScene, lidar: int
) -> None:
    recording = from_poses(read(logs[0].folder)[0])
    for index in (4, 13, 22):
        assert agrees(errors_of(drives[0], recording, "front_left", index, scene, lidar=lidar))


@pytest.mark.thorough
def test_a_calibration_in_the_axes_of_the_ros_driver_is_told_by_scans(
    drives: list[StreetDrive], logs: list[Made], scene: LidarScene, tmp_path: Path
) -> None:
    made = write_ford(drives[0], tmp_path, scene, axes="ros", lidars=("lidar_red",))
    drive, spoken = read(made.folder)
    assert noted(spoken.notes, "azimuth 0", "(ros)")
    assert agrees(errors_of(drives[0], from_poses(drive), "front_left", 13, scene))
    wrong = from_poses(read(made.folder, ReadingOptions(axes="velodyne"))[0])
    assert not agrees(errors_of(drives[0], wrong, "front_left", 13, scene))
    _, spoken = read(logs[0].folder)
    assert noted(spoken.notes, "azimuth 0", "(velodyne)")


def changed(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


def swapped_frames(values: dict[str, Any]) -> None:
    values["header"]["frame_id"], values["child_frame_id"] = values["child_frame_id"], "body"


def quaternion_from_w(values: dict[str, Any]) -> None:
    x, y, z, w = (values["transform"]["rotation"][k] for k in "xyzw")
    values["transform"]["rotation"] = dict(zip("xyzw", (w, x, y, z), strict=True))


def left_for_right(values: dict[str, Any]) -> None:
    values["transform"]["translation"]["y"] *= -1


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("sensor", "change"),
    [("camera_front_left", swapped_frames), ("lidar_red", swapped_frames), ("lidar_red", left_for_right)],
    ids=["inverse camera", "inverse lidar", "left for right"],
)
def test_a_wrong_convention_shows_in_the_depths(
    drives: list[StreetDrive],
    logs: list[Made],
    scene: LidarScene,
    tmp_path: Path,
    sensor: str,
    change: Callable[[dict[str, Any]], None],
) -> None:
    calibration = shutil.copytree(logs[0].calibration, tmp_path / "calibration")
    changed(calibration / calibration_file(sensor), change)
    how = ReadingOptions(lidars=("red",), axes="velodyne")
    recording = from_poses(read(logs[0].folder, how, calibration)[0])
    assert not agrees(errors_of(drives[0], recording, "front_left", 13, scene))


def test_frames_say_which_pose_a_file_holds(logs: list[Made], tmp_path: Path) -> None:
    path = tmp_path / "lidarRed_body.yaml"
    expected = read_lidar_pose(logs[0].calibration / path.name)
    values = stamped(invert(urdf_pose("lidar_red")), "body")
    values["header"]["frame_id"] = "/lidar_red"
    write_yaml(path, values)
    np.testing.assert_allclose(read_lidar_pose(path), expected, atol=1e-9)


@pytest.mark.parametrize("sensor", URDF)
def test_published_poses_fit_a_car(sensor: str, tmp_path: Path) -> None:
    """Positions and angles of the dataset's URDF: where a sensor is, which way is up, and where it looks."""
    path = tmp_path / calibration_file(sensor)
    write_yaml(path, stamped(urdf_pose(sensor), sensor))
    kind, *place = sensor.split("_")
    T_rig_sensor = read_lidar_pose(path) if kind == "lidar" else read_camera_pose(path)
    assert 1.1 < T_rig_sensor[2, 3] < 1.45  # above the axle, on the roof
    on_the_left = place[-1] in ("left", "red", "yellow")
    assert (T_rig_sensor[1, 3] > 0.2) == on_the_left
    if kind == "lidar":
        tilt = np.degrees(np.arccos(T_rig_sensor[2, 2]))
        assert tilt == pytest.approx(25.3 if place[0] in ("yellow", "green") else 0.4, abs=0.6)
        if place[0] in ("yellow", "green"):
            assert (T_rig_sensor[1, 2] > 0) == on_the_left  # the outer side of the lidar is the lower one
        return
    looks = {"front": 0.0, "rear": 180.0, "side": 90.0 if on_the_left else -90.0}[place[0]]
    x, y, z = T_rig_sensor[:3, 2]
    away = np.degrees(np.arctan2(y, x)) - looks
    assert abs((away + 180) % 360 - 180) < 12
    assert abs(z) < 0.05
    assert T_rig_sensor[2, 1] < -0.99  # the image's y is down


@pytest.mark.thorough
def test_poses_are_those_of_the_topic_and_prior_of_the_map(drives: list[StreetDrive], logs: list[Made]) -> None:
    drive, spoken = read(logs[0].folder)
    assert drive.poses is not None
    assert drive.prior is drive.poses
    assert drive.poses_from == "/pose_ground_truth"
    assert (drive.name, drive.condition.season) == (NAMES[0], "summer")
    times = drive.poses.times_ns[::50]
    moved = drive.poses.at(times)
    truth = drives[0].T_world_car(times)
    steps = [np.linalg.inv(T[:-1]) @ T[1:] for T in (moved, truth)]
    np.testing.assert_allclose(steps[0][:, :3, :3], steps[1][:, :3, :3], atol=1e-5)
    assert np.all(moved[:, 2, 2] > 0.99)  # the map's z is up
    raw = read(logs[0].folder, ReadingOptions(odometry="raw"))[0].poses
    assert raw is not None
    np.testing.assert_allclose(raw.at(times)[:, :3, 3] - moved[:, :3, 3], np.tile([0.4, -0.4, -0.4], (len(times), 1)))
    bare, _ = read(logs[0].folder, ReadingOptions(odometry="lidar"))
    assert bare.poses is None
    assert bare.prior is not None
    with refused(DatasetError, "2017-08-04-V2-Log1.bag", None, "pose_localized", "--odometry"):
        read(logs[0].folder, ReadingOptions(odometry="localized"))
    assert noted(spoken.notes, "/gps")


@pytest.mark.thorough
def test_small_images_of_the_bag_stand_in_for_missing_ones(
    drives: list[StreetDrive], logs: list[Made], scene: LidarScene, tmp_path: Path
) -> None:
    bag = tmp_path / logs[0].bag.name
    shutil.copy(logs[0].bag, bag)
    (tmp_path / f"{bag.stem}-FL").mkdir()  # without images
    whole = read(logs[0].folder)[0].cameras["front_left"].camera
    drive, spoken = read(bag, calibration=logs[0].calibration)
    small = drive.cameras["front_left"].camera
    assert small.size == (whole.width // 2, whole.height // 2)
    assert noted(spoken.notes, "image_front_left")
    pixels = np.array([[0.0, 0.0], [7.0, 3.0], [small.width - 1.0, small.height - 1.0]])
    np.testing.assert_allclose(small.unproject(pixels)[0], whole.unproject(2 * pixels + 0.5)[0], atol=1e-12)
    assert np.median(np.abs(errors_of(drives[0], from_poses(drive), "front_left", 13, scene))) < 0.06
    calibration = shutil.copytree(logs[0].calibration, tmp_path / "calibration")
    changed(calibration / "cameraFrontLeftIntrinsics.yaml", lambda values: values.update(width=whole.width * 2))
    drive, spoken = read(bag, calibration=calibration)
    assert not drive.cameras
    assert any("are not smaller copies of images of" in note for note in spoken.notes)
    (calibration / "cameraFrontLeft_body.yaml").unlink()
    _, spoken = read(bag, calibration=calibration)
    assert noted(spoken.notes, "front_left", "cameraFrontLeft_body.yaml")


def test_calibrations_are_found_where_users_keep_them(logs: list[Made], tmp_path: Path) -> None:
    def touched(*places: str) -> None:
        for place in places:
            (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / place).touch()

    touched("2017-08-04/V2/Log1/2017-08-04-V2-Log1.bag", "2017-10-26/V3/Log1/2017-10-26-V3-Log1.bag", "sample.bag")
    touched("Calibration-V2/lidarRed_body.yaml", "Calibration-V3/V3/lidarRed_body.yaml", "own/lidarBlue_body.yaml")
    bags = [tmp_path / "2017-08-04" / "V2" / "Log1", tmp_path / "2017-10-26" / "V3" / "Log1"]
    found = find_logs(bags, None)
    assert [log.calibration for log in found] == [tmp_path / "Calibration-V2", tmp_path / "Calibration-V3" / "V3"]
    assert [(log.vehicle, log.month) for log in found] == [("V2", 8), ("V3", 10)]
    assert find_logs(bags[:1], tmp_path / "own")[0].calibration == tmp_path / "own"
    with refused((DatasetError, ConfigError), "", None, "V2", "V3"):
        find_logs(bags, tmp_path / "own")
    with refused(DatasetError, tmp_path, None, "sample.bag", "Calibration-V2", "V3"):
        find_logs([tmp_path / "sample.bag"], None)
    with refused(DatasetError, "", None, "V2"):
        find_logs(bags[:1], bags[0])


RED, INTRINSICS = "lidarRed_body.yaml", "cameraFrontLeftIntrinsics.yaml"


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        (RED, lambda v: v.pop("transform"), (RED, 1, "transform")),
        (RED, lambda v: v.update(child_frame_id="body"), (RED, None, "body")),
        (
            RED,
            lambda v: v["header"].update(frame_id="imu"),
            (RED, None, "lidar_red", "imu"),
        ),
        (
            RED,
            lambda v: v["transform"]["rotation"].update(x=2.0),
            (RED, None, "norm"),
        ),
        (RED, quaternion_from_w, (RED, None, "z axis")),
        (
            "cameraFrontLeft_body.yaml",
            lambda v: v["transform"].update(rotation={"x": 0, "y": 0, "z": 0, "w": 1}),
            ("cameraFrontLeft_body.yaml", None, "axes"),
        ),
        (
            INTRINSICS,
            lambda v: v.update(P=[1.0, 2.0]),
            (INTRINSICS, None, "P", 12),
        ),
        (
            INTRINSICS,
            lambda v: v.update(P=[0.0] * 12),
            (INTRINSICS, None, "focal lengths", 0),
        ),
        (
            INTRINSICS,
            lambda v: (v.pop("P"), v.pop("K")),
            (INTRINSICS, None, "neither P nor K"),
        ),
        (
            INTRINSICS,
            lambda v: v.update(width=9),
            ("2017-08-04-V2-Log1-FL/1709287200000000.png", None, "196x164", "9x164"),
        ),
    ],
)
def test_a_fault_of_the_calibration_is_told_with_its_file(
    logs: list[Made], tmp_path: Path, file: str, change: Callable[[dict[str, Any]], None], words: ErrorData
) -> None:
    calibration = shutil.copytree(logs[0].calibration, tmp_path / "calibration")
    changed(calibration / file, change)
    with refused(DatasetError, *words):
        read(logs[0].folder, calibration=calibration)


@pytest.mark.thorough
def test_logs_are_brought_together_by_one_command(drives: list[StreetDrive], logs: list[Made], tmp_path: Path) -> None:
    out = tmp_path / "data set"
    arguments = ("--lidars", "red", "-j", 1, *SMALL)
    outcome = relocbench("build-dataset", "ford-av", *(log.folder for log in logs), "--out", out, *arguments)
    assert outcome.status == 0, outcome.err
    assert "/pose_ground_truth" in outcome.err
    assert "/lidar_red_scan" in outcome.err
    assert_pairs_are_right(out, f"{NAMES[0]}__{NAMES[1]}__front_left", *drives)
    assert relocbench("validate", out).status == 0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{0}"], ("", None, "reference", "query", "got 1")),
        (["{0}", "{1}", "--cameras", "center"], ("", None, "center", "front_left")),
        (["{0}", "{1}", "--lidars", "pink"], ("", None, "pink")),
        (["{0}", "{1}", "--lidars", "green"], ("", None, "lidar_green_scan", "lidar_green_pointcloud")),
        (["{0}/..", "{1}"], ("2017-08-04-V2-Log1.bag",)),
        (["{0}/none.bag", "{1}"], ("none.bag",)),
        (["{0}", "{1}", "--calibration-folder", "{0}/none"], ("Log1/none",)),
        (["{0}", "{1}", "--lidar-intrinsics", "{0}/none"], ("Log1/none",)),
        (["{0}", "{1}", "--odometry", "imu"], ("", None, "odometry")),
    ],
)
def test_wrong_use_is_told_in_one_line(
    logs: list[Made], tmp_path: Path, arguments: list[str], words: ErrorData
) -> None:
    places = [log.folder for log in logs]
    outcome = relocbench("build-dataset", "ford-av", *(a.format(*places) for a in arguments), "--out", tmp_path / "d")
    assert outcome.status == 2
    assert_names(outcome.err, *words)


@pytest.mark.parametrize("timed", [False, True])
def test_converted_clouds_are_read_if_their_points_have_times(logs: list[Made], tmp_path: Path, timed: bool) -> None:
    columns = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *([("time", "<f4")] if timed else [])]
    cloud = np.zeros(400, np.dtype(columns))
    cloud["x"], cloud["y"], cloud["z"] = 8.0, np.linspace(-5, 5, 400), np.tile([0.0, 1.0], 200)
    if timed:
        cloud["time"] = np.linspace(-0.1, 0.0, 400)
    bag = Bag()
    for k in range(12):
        time = 1_501_822_800_000_000_000 + k * 100_000_000
        bag.cloud("/lidar_red_pointcloud", time, cloud, "lidar_red")
        bag.pose_stamped("/pose_ground_truth", time, (k, 0, 0, 0, 0, 0, 1))
    path, how = bag.write(tmp_path / "2017-08-04-V2-Log9.bag"), ReadingOptions(axes="ros")
    if timed:
        drive, _ = read(path, how, logs[0].calibration)
        scan = drive.lidars[0].read(3)
        assert np.ptp(scan.times_ns) == pytest.approx(1e8, abs=10)
        return
    with refused(DatasetError, "", None, "lidar_red_pointcloud", "lidar_red_scan"):
        read(path, how, logs[0].calibration)


def test_axes_that_nothing_tells_have_to_be_named(logs: list[Made], tmp_path: Path) -> None:
    """A car that stands, and one without poses."""
    for topic in ("/pose_ground_truth", None):
        bag = tmp_path / (topic or "none").strip("/") / logs[0].bag.name
        bag.parent.mkdir()
        rewritten(logs[0].bag, bag, topic)
        with refused(DatasetError, "", None, "--lidar-axes"):
            read(bag, calibration=logs[0].calibration)
        named, spoken = read(bag, ReadingOptions(axes="velodyne"), logs[0].calibration)
        assert (named.poses is None) == (topic is None)
        assert noted(spoken.notes, "(velodyne)", "--lidar-axes")


def rewritten(source: Path, target: Path, standing: str | None) -> None:
    """A bag in which the car stands by the poses of one topic, or which has no poses."""
    from rosbags.rosbag1 import Reader, Writer

    from relocbench.datasets.importers.rosbag.definitions import typestore

    store = typestore(True)
    with Reader(source) as old, Writer(target) as new:
        kept = {c.topic: c for c in old.connections if not c.topic.startswith(("/pose", "/tf")) or c.topic == standing}
        made = {
            topic: new.add_connection(topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for topic, c in kept.items()
        }
        first = None
        for connection, time, raw in old.messages(connections=list(kept.values())):
            if connection.topic == standing:
                message = store.deserialize_ros1(raw, connection.msgtype)
                first = first or message.pose
                message.pose = first
                raw = store.serialize_ros1(message, connection.msgtype)
            new.write(made[connection.topic], time, raw)
