"""Text files of the Oxford RobotCar dataset: what they mean, and what is said of those that are damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import ErrorData, refused

from relocbench.datasets.importers.lidar_drives.texts import transform_from_xyzrpy
from relocbench.datasets.importers.robotcar import files
from relocbench.datasets.importers.robotcar.sensors import present_files
from relocbench.datasets.importers.robotcar.track import MapOrigin, map_trajectory, visual_trajectory
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.errors import DatasetError
from relocbench.geometry import apply, interpolate_trajectory, invert, make_transform
from relocbench.progress import Silent

VO_HEADER = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw"
INS_HEADER = (
    "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
    "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
)


def ins_row(time: int, northing: float, easting: float, yaw: float, **other: str) -> str:
    status, zone = other.get("status", "INS_SOLUTION_GOOD"), other.get("zone", "30U")
    return f"{time},{status},51.7,-1.2,100,{northing},{easting},-100,{zone},0,0,0,0,0,{yaw}"


def written(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def test_six_numbers_turn_about_fixed_x_first_and_z_last() -> None:
    roll, pitch, yaw = 0.1, -0.4, 2.0
    c, s = np.cos, np.sin
    x = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    y = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    z = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    found = transform_from_xyzrpy([1, 2, 3, roll, pitch, yaw])
    np.testing.assert_allclose(found, make_transform(z @ y @ x, [1, 2, 3]), atol=1e-15)


def test_published_extrinsics_put_each_sensor_where_it_is_on_the_car(real_data: Callable[[str], Path]) -> None:
    """Cameras map from the vehicle, other sensors to it; x forward, y right, z down. Read the other way round, the left
    camera would stand behind the car."""
    folder = real_data("robotcar_sdk_calibration") / "extrinsics"
    left = invert(files.read_extrinsics(folder / "mono_left.txt"))
    right = invert(files.read_extrinsics(folder / "mono_right.txt"))
    assert left[1, 3] < -0.3
    assert right[1, 3] > 0.3
    assert left[0, 3] == pytest.approx(right[0, 3], abs=0.15)
    # They look to their sides (camera x is the way it looks).
    assert left[1, 0] < -0.8
    assert right[1, 0] > 0.8
    front, rear = (files.read_extrinsics(folder / f"lms_{end}.txt") for end in ("front", "rear"))
    assert front[0, 3] > 1.0
    assert rear[0, 3] < -2.0
    assert (front[2, 3], rear[2, 3]) == pytest.approx((1.0, 1.0), abs=0.15)
    # Both planes are upright and across the road: the axis of rotation lies along it.
    assert abs(front[0, 2]) > 0.98
    assert abs(rear[0, 2]) > 0.9


def test_all_published_tags_and_models_can_be_read(real_data: Callable[[str], Path]) -> None:
    folder = real_data("robotcar_sdk_calibration")
    found = {path.stem: files.read_tags(path) for path in sorted((folder / "tags").glob("*.yaml"))}
    assert len(found) > 100
    conditions = {name: files.condition_of(tags, int(name[5:7])) for name, tags in found.items()}
    assert conditions["2015-02-03-08-45-10"].weather == "snow"
    assert conditions["2015-02-03-08-45-10"].season == "winter"
    assert {c.weather for c in conditions.values()} == {"sunny", "cloudy", "overcast", "rain", "snow", "unknown"}
    assert {c.time_of_day for c in conditions.values()} == {"day", "night", "dusk", "unknown"}
    assert any("roadworks" in c.tags for c in conditions.values())
    for path in (folder / "models").glob("*.txt"):
        model = files.read_lens_model(path)
        # A ray along the optical axis points along the camera's x.
        np.testing.assert_allclose(apply(model.T_camera_image, [[0, 0, 1]])[0, 0], 1.0)


def test_tags_tell_weather_before_light() -> None:
    condition = files.condition_of(["overcast", "rain", "roadworks"], 7)
    assert (condition.weather, condition.time_of_day, condition.season) == ("rain", "day", "summer")
    assert condition.tags == ("overcast", "roadworks")
    assert files.condition_of(["night"]).time_of_day == "night"
    assert files.condition_of([]).time_of_day == "unknown"


def test_source_is_the_later_time_and_steps_multiply_left_to_right(tmp_path: Path) -> None:
    """A quarter turn to the right (positive yaw about z down) after 1 m, then 2 m on: 1 m forward, 2 m to the right."""
    path = written(
        tmp_path / "vo.csv",
        VO_HEADER,
        f"1000100,1000000,1,0,0,0,0,{np.pi / 2}",
        "1000200,1000100,2,0,0,0,0,0",
    )
    track = visual_trajectory(files.read_visual_odometry(path), None)
    assert track.times_ns.tolist() == [1_000_000_000, 1_000_100_000, 1_000_200_000]
    np.testing.assert_allclose(track.T_odom_rig[:, :3, 3], [[0, 0, 0], [1, 0, 0], [1, -2, 0]], atol=1e-12)
    np.testing.assert_allclose(track.T_odom_rig[2, :3, 0], [0, -1, 0], atol=1e-12)
    # Halfway is halfway, not at the pose before.
    np.testing.assert_allclose(track.at(np.array([1_000_150_000]))[0, :3, 3], [1, -1, 0], atol=1e-12)


def straight_vo(tmp_path: Path, *starts: int) -> Path:
    rows = (f"{start + 50_000},{start},0.5,0,0,0,0,0" for start in starts)
    return written(tmp_path / "vo.csv", VO_HEADER, *rows)


def test_one_lost_row_of_odometry_is_bridged_by_the_speed_before(tmp_path: Path) -> None:
    track = visual_trajectory(files.read_visual_odometry(straight_vo(tmp_path, 0, 50_000, 150_000)), None)
    assert track.breaks == ()
    assert track.covers(np.array([120_000_000])).all()
    np.testing.assert_allclose(track.T_odom_rig[-1, 0, 3], 2.0, atol=1e-9)
    assert len(set(track.pieces(track.times_ns).tolist())) == 1


def test_a_long_gap_of_odometry_breaks_it_and_the_ins_says_where_it_goes_on(tmp_path: Path) -> None:
    steps = files.read_visual_odometry(straight_vo(tmp_path, 0, 50_000, 400_000, 450_000))
    times = np.array([0, 1_000_000_000])
    inertial = Trajectory(times, make_transform(np.eye(3), [[7.0, 0.0, 0.0], [27.0, 0.0, 0.0]]))
    track = visual_trajectory(steps, inertial)
    assert len(track.breaks) == 1
    middle, ends = np.array([250_000_000]), np.array([100_000_000, 400_000_000])
    assert not track.covers(middle).any()
    assert track.covers(ends).all()
    assert track.pieces(ends).tolist() == [0, 1]
    np.testing.assert_allclose(track.at(ends)[:, 0, 3], [1.0, 1.0 + 20 * 0.3], atol=1e-9)
    without = visual_trajectory(steps, None)
    np.testing.assert_allclose(without.at(ends)[:, 0, 3], [1.0, 1.0 + 10 * 0.3], atol=1e-9)


def test_north_east_down_becomes_east_north_up(tmp_path: Path) -> None:
    """Yaw is from north to the east: at 90 degrees the car's forward is east and its left is north."""
    rows = [ins_row(1_000_000, 5_735_100.5, 620_200.25, np.pi / 2), ins_row(1_020_000, 5_735_100.5, 620_201.25, 0.0)]
    track = files.read_inertial(written(tmp_path / "ins.csv", INS_HEADER, *rows))
    origin = MapOrigin.of(track)
    assert (origin.easting_m, origin.northing_m, origin.zone) == (620_000.0, 5_735_000.0, "30U")
    T_rig_ins = np.diag([1.0, -1.0, -1.0, 1.0])
    pose = map_trajectory(track, origin, T_rig_ins).T_odom_rig
    np.testing.assert_allclose(pose[0, :3, 3], [200.25, 100.5, 100.0], atol=1e-9)
    np.testing.assert_allclose(pose[0, :3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(pose[1, :3, 0], [0, 1, 0], atol=1e-12)


def test_solutions_that_are_not_good_are_left_out(tmp_path: Path) -> None:
    rows = [ins_row(i, 0, i, 0, status="INS_INACTIVE" if i == 2 else "INS_SOLUTION_GOOD") for i in (1, 2, 3)]
    track = files.read_inertial(written(tmp_path / "ins.csv", INS_HEADER, *rows))
    assert track.times_ns.tolist() == [1000, 3000]
    assert track.left_out == 1


@pytest.mark.parametrize(
    ("lines", "line", "message"),
    [
        ([VO_HEADER, "2,1,0,0,0,0,0,0", "3,1,0,0,0,0,0,0"], 3, ()),
        ([VO_HEADER, "2,1,0,0,0,0,0,0", "2,1,0,0,0,0,0,0"], 3, ()),
        ([VO_HEADER, "1,2,0,0,0,0,0,0"], 2, ("", None, "destination_timestamp")),
        ([VO_HEADER, "2,1,0,0,0,0,0"], 2, ("", None, "8", "7")),
        ([VO_HEADER, "2,1,0,nan,0,0,0,0"], None, ()),
        ([VO_HEADER, "2,1,0,0,0,0,0,0", "2,three,0,0,0,0,0,0"], 3, ("", None, "three")),
        (["a,b"], 1, ("", None, "source_timestamp")),
        ([VO_HEADER], None, ()),
    ],
)
def test_damaged_odometry_is_named_by_line(
    tmp_path: Path, lines: list[str], line: int | None, message: ErrorData
) -> None:
    with refused(DatasetError, *message) as caught:
        files.read_visual_odometry(written(tmp_path / "vo.csv", *lines))
    assert (caught.value.path, caught.value.line) == (tmp_path / "vo.csv", line)


@pytest.mark.parametrize(
    ("rows", "line", "message"),
    [
        ([ins_row(2, 0, 0, 0), ins_row(2, 0, 1, 0)], 3, ()),
        ([ins_row(2, 0, 0, 0), ins_row(1, 0, 0, 0)], 3, ()),
        ([ins_row(1, 0, 0, 0), ins_row(2, 0, 0, 0, zone="31U")], 3, ("", None, "utm_zone", "30U", "31U")),
        ([ins_row(1, 0, 0, 0, status="INS_INACTIVE")], None, ()),
    ],
)
def test_damaged_solutions_are_named_by_line(
    tmp_path: Path, rows: list[str], line: int | None, message: ErrorData
) -> None:
    with refused(DatasetError, *message) as caught:
        files.read_inertial(written(tmp_path / "ins.csv", INS_HEADER, *rows))
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("10 1\n20 1\n20 1\n", 3, ()),
        ("10 1\n5 1\n", 2, ()),
        ("ten 1\n", 1, ()),
        ("10 1 1\n", 1, ("", None, "3")),
    ],
)
def test_damaged_timestamps_are_named_by_line(tmp_path: Path, text: str, line: int, message: ErrorData) -> None:
    path = tmp_path / "lms_front.timestamps"
    path.write_text(text)
    with refused(DatasetError, *message) as caught:
        files.read_timestamps(path)
    assert caught.value.line == line


def test_interpolation_agrees_with_the_chain_at_every_step(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = np.hstack([rng.normal(size=(30, 3)), 0.2 * rng.normal(size=(30, 3))])
    rows = (f"{(i + 1) * 62_500},{i * 62_500}," + ",".join(repr(float(v)) for v in row) for i, row in enumerate(values))
    track = visual_trajectory(files.read_visual_odometry(written(tmp_path / "vo.csv", VO_HEADER, *rows)), None)
    assert len(track.times_ns) == 31
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    pose = np.eye(4)
    for i, row in enumerate(values):
        pose = pose @ transform_from_xyzrpy(row)
        at = interpolate_trajectory(track.times_ns, track.T_odom_rig, np.array([(i + 1) * 62_500_000]))[0]
        np.testing.assert_allclose(at, flip @ pose @ flip, atol=1e-9)


def test_a_scan_that_is_a_link_to_nowhere_is_named(tmp_path: Path) -> None:
    (tmp_path / "lms").mkdir()
    (tmp_path / "lms" / "1416316800100000.bin").symlink_to("nowhere")
    with refused(DatasetError, "1416316800100000.bin"):
        present_files(tmp_path / "lms", tmp_path / "lms.timestamps", ".bin", "scans", Silent())
