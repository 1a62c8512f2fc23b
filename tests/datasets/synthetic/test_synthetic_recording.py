"""Recordings of a made-up drive keep to the formats of real ones, and to the truth beside them."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from killing import Fault, run_until_killed
from recording_reading import RobotCarReading, Truth, hashes, matrix_of, read_vo
from refusals import refused
from small_street import SolidTexture, StraightRoad, Street, street_mesh

from relocbench.arrays import Array
from relocbench.datasets.importers.kitti import dataset as kitti
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS, Factors
from relocbench.datasets.synthetic.drives import odometry
from relocbench.datasets.synthetic.drives.utm import latitude_longitude
from relocbench.datasets.synthetic.jobs.recording import DriveOptions, Recorded, path_length, prepare, record
from relocbench.datasets.synthetic.jobs.recording_jobs import carry_out
from relocbench.datasets.synthetic.layouts import robotcar as robotcar_layout
from relocbench.datasets.synthetic.layouts.kitti import KittiLayout
from relocbench.datasets.synthetic.layouts.robotcar import mosaic, tags
from relocbench.datasets.synthetic.layouts.robotcar_odometry import vo_text
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.datasets.synthetic.town.town import make_district
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import interpolate_trajectory, invert, rotation_angle, so3_exp
from relocbench.progress import Silent

TRAFFIC = Factors(traffic=3.0)
SCALE = 0.1


def drive(out: Path, layout: Any = "robotcar", workers: int = 1, **options: Any) -> Recorded:
    settings: dict[str, Any] = {"frames": 6, "scale": SCALE, "rings": 16, "azimuths": 400, **options}
    return record(
        Street(),
        settings.pop("path", StraightRoad()),
        settings.pop("factors", TRAFFIC),
        out,
        layout,
        run=Run(workers),
        renderer_factory=settings.pop("renderer_factory", SolidTexture),
        compose=street_mesh,
        **settings,
    )


@pytest.fixture(scope="module")
def robotcar(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return drive(tmp_path_factory.mktemp("robotcar"), frames=24)


@pytest.fixture(scope="module")
def reading(robotcar: Recorded) -> RobotCarReading:
    return RobotCarReading(robotcar.folder.parent, robotcar.name)


@pytest.fixture(scope="module")
def truth(robotcar: Recorded) -> Truth:
    return Truth(robotcar.truth)


SENSORS = {
    "stereo": (["stereo/left", "stereo/centre", "stereo/right"], 62_500),
    "mono_left": (["mono_left"], 90_000),
    "mono_right": (["mono_right"], 90_000),
    "mono_rear": (["mono_rear"], 90_000),
    "lms_front": (["lms_front"], 20_000),
    "lms_rear": (["lms_rear"], 20_000),
}


@pytest.mark.thorough
@pytest.mark.parametrize("sensor", SENSORS)
def test_every_sensor_has_a_file_for_each_of_its_timestamps(reading: RobotCarReading, sensor: str) -> None:
    folders, period_us = SENSORS[sensor]
    stamps, chunks = zip(*reading.timestamps(sensor), strict=True)
    np.testing.assert_array_equal(np.diff(stamps), period_us)
    assert 1_300_000_000_000_000 < stamps[0] < 2_000_000_000_000_000
    assert set(chunks) == {1}
    for folder in folders:
        assert list(reading.files(folder, ".bin" if "lms" in sensor else ".png")) == list(stamps)


@pytest.mark.thorough
@pytest.mark.parametrize(("camera", "size"), [("stereo/left", (128, 96)), ("mono_rear", (102, 102))])
def test_images_are_eight_bit_mosaics(reading: RobotCarReading, camera: str, size: tuple[int, int]) -> None:
    for path in reading.files(camera, ".png").values():
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert image.dtype == np.uint8
        assert image.shape == size[::-1]


@pytest.mark.parametrize(("pattern", "code"), [("GBRG", cv2.COLOR_BayerGBRG2RGB), ("RGGB", cv2.COLOR_BayerRGGB2RGB)])
def test_opencv_restores_the_colours_of_a_mosaic(pattern: str, code: int) -> None:
    v, u = np.mgrid[:40, :60]
    rgb = np.stack([40 + 3 * u, 200 - 2 * v, 90 + u + v], axis=-1).astype(np.uint8)
    restored = cv2.cvtColor(mosaic(rgb, pattern), code).astype(int)
    # Linear colours are restored by linear interpolation but for rounding, and the border.
    assert np.abs(restored - rgb)[2:-2, 2:-2].max() <= 1


@pytest.mark.thorough
def test_recorded_mosaics_hold_the_rendered_colours(reading: RobotCarReading, truth: Truth) -> None:
    for camera, code in (("stereo/right", cv2.COLOR_BayerGBRG2RGB), ("mono_left", cv2.COLOR_BayerRGGB2RGB)):
        stamp, path = next(iter(reading.files(camera, ".png").items()))
        values = robotcar_layout.RobotCarLayout(reading.root, 2, SCALE, (camera,), 0).cameras[camera]
        pose = truth.rig(stamp * 1000) @ truth.T_rig[camera]
        renderer = SolidTexture(street_mesh(Street(), TRAFFIC), TRAFFIC, np.zeros((0, 3)), Street().seed)
        frame = renderer.render(values.camera, pose, 0)
        mosaicked = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert mosaicked is not None
        colour = cv2.cvtColor(mosaicked, code).astype(int)
        # Further away the texture is finer than the mosaic.
        near = (frame.depth > 0) & (frame.depth < 9)
        assert near.sum() > 500
        right, swapped = (np.abs(c - frame.rgb.astype(int))[near].mean() for c in (colour, colour[..., ::-1]))
        assert right < 15
        assert swapped > 3 * right


@pytest.mark.thorough
def test_scans_hold_541_beams_half_a_degree_apart(reading: RobotCarReading) -> None:
    angles = np.radians(np.linspace(-135, 135, 541))
    for sensor in ("lms_front", "lms_rear"):
        for path in reading.files(sensor, ".bin").values():
            scan = reading.scan(path)
            assert scan.shape == (541, 3)
            distance = np.hypot(scan[:, 0], scan[:, 1])
            seen = distance > 0
            assert seen.mean() > 0.4
            assert (distance[seen] >= 0.5).all()
            assert (distance[seen] <= 50).all()
            np.testing.assert_allclose(np.arctan2(scan[seen, 1], scan[seen, 0]), angles[seen], atol=1e-9)
            assert ((scan[:, 2] >= 0) & (scan[:, 2] <= 1)).all()
            assert not scan[~seen].any()


def nearest_surface(points: Array) -> Array:
    """Distance of points (N, 3) from the street, found by short rays along all axes."""
    scene = LidarScene(street_mesh(Street(), TRAFFIC))
    out = np.full(len(points), np.inf)
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        out = np.minimum(out, scene.hits(points - 1e-3 * axis, np.broadcast_to(axis, points.shape)).range)
    return out


@pytest.mark.thorough
@pytest.mark.parametrize("sensor", ["lms_front", "lms_rear"])
def test_scans_lie_on_the_street_by_the_files_calibration_and_the_true_poses(
    reading: RobotCarReading, truth: Truth, sensor: str
) -> None:
    _, left_image = reading.model("stereo_wide_left")
    T_rig_vehicle = truth.T_rig["stereo/left"] @ invert(left_image)
    T_vehicle_laser = reading.extrinsics(sensor)
    errors = []
    for stamp, path in list(reading.files(sensor, ".bin").items())[::4]:
        scan = reading.scan(path)
        beams = np.flatnonzero(np.hypot(scan[:, 0], scan[:, 1]) > 0)
        # A turn takes 20 ms, the middle beam is fired at the timestamp.
        fired = stamp * 1000 + np.rint((beams - 270) * 0.5 / 360 * 20e6).astype(np.int64)
        T_world_laser = interpolate_trajectory(truth.times, truth.poses, fired) @ T_rig_vehicle @ T_vehicle_laser
        points = np.column_stack([scan[beams, :2], np.zeros(len(beams)), np.ones(len(beams))])
        errors.append(nearest_surface(np.einsum("nij,nj->ni", T_world_laser, points)[:, :3]))
    error = np.concatenate(errors)
    # The rest fell on other cars.
    assert np.mean(error < 0.06) > 0.9
    assert np.median(error) < 0.012


@pytest.mark.thorough
def test_cars_of_the_traffic_stand_in_the_scans_at_their_own_places(
    reading: RobotCarReading, truth: Truth, robotcar: Recorded
) -> None:
    rows = list(csv.DictReader((robotcar.truth / "moving_cars.csv").open()))
    cars_x = {r["variant"] for r in rows}
    assert len(cars_x) >= 4
    T_rig_laser = truth.T_rig["lms_front"]
    near = 0
    for stamp, path in reading.files("lms_front", ".bin").items():
        scan = reading.scan(path)
        scan = scan[np.hypot(scan[:, 0], scan[:, 1]) > 0]
        points = np.column_stack([scan[:, :2], np.zeros(len(scan)), np.ones(len(scan))])
        world = (points @ (truth.rig(stamp * 1000) @ T_rig_laser).T)[:, :3]
        off = world[(np.abs(world[:, 1]) < 5.5) & (world[:, 2] > 0.25)]
        step = min({int(r["timestamp_ns"]) for r in rows}, key=lambda t: abs(t - stamp * 1000))
        places = np.array([[float(r["tx"]), float(r["ty"])] for r in rows if int(r["timestamp_ns"]) == step])
        for point in off:
            near += 1
            assert np.linalg.norm(places - point[:2], axis=1).min() < 3.5
    assert near > 20


@pytest.mark.thorough
def test_model_files_place_the_cameras_where_the_truth_has_them(reading: RobotCarReading, truth: Truth) -> None:
    _, left_image = reading.model("stereo_wide_left")
    T_rig_vehicle = truth.T_rig["stereo/left"] @ invert(left_image)
    # z down, x forward as the car's.
    np.testing.assert_allclose(T_rig_vehicle[:3, :3], np.diag([1, -1, -1]), atol=1e-12)
    models = {
        "stereo/left": "stereo_wide_left",
        "stereo/centre": "stereo_narrow_left",
        "stereo/right": "stereo_wide_right",
        "mono_left": "mono_left",
        "mono_right": "mono_right",
        "mono_rear": "mono_rear",
    }
    for camera, model in models.items():
        (fx, fy, cx, cy), T_camera_image = reading.model(model)
        entry = truth.cameras[camera]
        np.testing.assert_allclose([fx, fy, cx, cy], [entry[k] for k in ("fx", "fy", "cx", "cy")], atol=1e-6)
        T_camera_vehicle = reading.extrinsics(camera.split("/")[0])
        expected = T_rig_vehicle @ invert(T_camera_vehicle) @ T_camera_image
        np.testing.assert_allclose(truth.T_rig[camera], expected, atol=1e-6)
    # The left camera looks to the left and stands there.
    assert truth.T_rig["mono_left"][1, 2] > 0.9
    assert truth.T_rig["mono_left"][1, 3] > truth.T_rig["mono_right"][1, 3] + 1


@pytest.mark.thorough
def test_look_up_tables_lead_to_the_pixel_that_sees_the_same_ray(reading: RobotCarReading) -> None:
    for model, recorded in (
        ("stereo_wide_left", "stereo_wide_left"),
        ("stereo_narrow_right", "stereo_wide_right"),
    ):
        table = np.fromfile(reading.root / "models" / f"{model}_distortion_lut.bin", np.float64).reshape(2, -1)
        u, v = table.reshape(2, 96, 128)[:, 70, 31]
        (fx, fy, cx, cy), _ = reading.model(model)
        (rfx, rfy, rcx, rcy), _ = reading.model(recorded)
        np.testing.assert_allclose([(u - rcx) / rfx, (v - rcy) / rfy], [(31 - cx) / fx, (70 - cy) / fy], atol=1e-6)


def test_calibration_is_that_of_the_real_car(real_data: Callable[[str], Path]) -> None:
    real = real_data("robotcar_sdk_calibration")
    for name, values in robotcar_layout.EXTRINSICS.items():
        published = [float(v) for v in (real / "extrinsics" / f"{name}.txt").read_text().split()]
        np.testing.assert_allclose(values, published, atol=1e-9)
    for name, lens in robotcar_layout.LENSES.items():
        lines = (real / "models" / f"{name}.txt").read_text().splitlines()
        focal, cx, cy = lens.intrinsics
        np.testing.assert_allclose([focal, focal, cx, cy], [float(v) for v in lines[0].split()], atol=1e-9)
        own = robotcar_layout.model_text(
            robotcar_layout.RobotCarLayout(real, 2, 1.0, robotcar_layout.CAMERAS, 0).camera(name), lens
        )
        published_rotation = [[float(v) for v in line.split()[:3]] for line in lines[1:4]]
        own_rotation = [[float(v) for v in line.split()[:3]] for line in own.splitlines()[1:4]]
        np.testing.assert_allclose(own_rotation, published_rotation, atol=1e-9)
    words = {line.strip("- \n") for p in (real / "tags").glob("*.yaml") for line in p.open()}
    for condition in CONDITIONS.values():
        assert set(tags(condition.factors)) <= words


@pytest.mark.thorough
def test_tags_are_a_list_of_the_datasets_words(reading: RobotCarReading, robotcar: Recorded) -> None:
    assert yaml.safe_load((reading.root / "tags" / f"{robotcar.name}.yaml").read_text()) == ["sun"]
    assert tags(CONDITIONS["Snow"].factors) == ["overcast", "snow"]
    assert tags(CONDITIONS["ClearSnow"].factors) == ["sun", "snow"]
    assert tags(CONDITIONS["Night"].factors) == ["night"]


@given(st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)))
def test_roll_pitch_and_yaw_come_back(angles: tuple[float, float, float]) -> None:
    rotation = odometry.rotation_from_rpy(angles)
    np.testing.assert_allclose(rotation, matrix_of(0, 0, 0, *angles)[:3, :3], atol=1e-12)
    np.testing.assert_allclose(odometry.rpy_from_rotation(rotation), angles, atol=1e-9)


def curve(metres: float) -> Array:
    """A drive of half-metre steps through a long bend."""
    step = np.eye(4)
    step[:3, :3], step[0, 3] = so3_exp([0.0, 0.0, 0.004]), 0.5
    poses = [np.eye(4)]
    for _ in range(int(metres * 2)):
        poses.append(poses[-1] @ step)
    return np.array(poses)


def integrate(steps: Array) -> Array:
    pose = np.eye(4)
    for step in steps:
        pose = pose @ step
    return pose


def test_odometry_without_errors_integrates_to_the_truth() -> None:
    poses = curve(100)
    end = integrate(odometry.visual_odometry(poses, odometry.EXACT, np.random.default_rng(0)))
    np.testing.assert_allclose(end, poses[-1], atol=1e-9)


def test_odometry_drifts_by_about_a_percent() -> None:
    drift = {}
    for metres in (30, 100):
        poses = curve(metres)
        ends = []
        for seed in range(60):
            steps = odometry.visual_odometry(poses, odometry.OdometryErrors(), np.random.default_rng(seed))
            ends.append(invert(poses[-1]) @ integrate(steps))
        away = np.linalg.norm(np.array(ends)[:, :3, 3], axis=1)
        turned = np.degrees(rotation_angle(np.array(ends)[:, :3, :3]))
        drift[metres] = (np.sqrt(np.mean(away**2)) / metres, np.sqrt(np.mean(turned**2)))
    for share, _ in drift.values():
        assert 0.004 < share < 0.02
    assert 0.1 < drift[30][1] < drift[100][1] < 1.5


def test_exact_odometry_written_and_read_integrates_to_the_truth() -> None:
    poses, times = curve(40), np.arange(81, dtype=np.int64) * 62_500_000
    text = vo_text(times, poses, np.random.default_rng(0), odometry.EXACT)
    steps = read_vo(list(csv.DictReader(text.splitlines())))
    np.testing.assert_allclose(integrate(np.array([s for _, _, s in steps])), poses[-1], atol=1e-6)
    assert [(later, earlier) for later, earlier, _ in steps[:2]] == [(62_500, 0), (125_000, 62_500)]


@pytest.mark.thorough
def test_recorded_odometry_follows_the_car(reading: RobotCarReading, truth: Truth) -> None:
    steps = read_vo(reading.table("vo/vo.csv"))
    _, left_image = reading.model("stereo_wide_left")
    T_rig_vehicle = truth.T_rig["stereo/left"] @ invert(left_image)
    start, end = steps[0][1] * 1000, steps[-1][0] * 1000
    assert [s[1] for s in steps[1:]] == [s[0] for s in steps[:-1]]
    T_start_end = invert(truth.rig(start) @ T_rig_vehicle) @ truth.rig(end) @ T_rig_vehicle
    error = invert(T_start_end) @ integrate(np.array([s for _, _, s in steps]))
    way = np.linalg.norm(T_start_end[:3, 3])
    assert way > 8
    assert 1e-4 < np.linalg.norm(error[:3, 3]) < 0.04 * way
    assert rotation_angle(error[:3, :3]) < np.radians(1)


def ins_errors(root: Path, recorded: Recorded) -> tuple[Array, Array]:
    """East, north and up errors of the INS's positions (N, 3), and the angles (N,) of its attitudes' errors."""
    reading, truth = RobotCarReading(root, recorded.name), Truth(recorded.truth)
    _, left_image = reading.model("stereo_wide_left")
    T_rig_ins = truth.T_rig["stereo/left"] @ invert(left_image) @ reading.extrinsics("ins")
    origin = truth.drawn["grid_origin_m"]
    ned_of_world = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    positions, angles = [], []
    for row in reading.table("gps/ins.csv"):
        pose = truth.rig(int(row["timestamp"]) * 1000) @ T_rig_ins
        measured = [float(row["easting"]) - origin["easting"], float(row["northing"]) - origin["northing"]]
        positions.append(np.array([*measured, -float(row["down"])]) - pose[:3, 3])
        attitude = matrix_of(0, 0, 0, *(float(row[n]) for n in ("roll", "pitch", "yaw")))[:3, :3]
        angles.append(float(rotation_angle(attitude.T @ ned_of_world @ pose[:3, :3])))
    return np.array(positions), np.array(angles)


@pytest.mark.thorough
def test_the_ins_is_off_by_metres_that_hold_for_a_drive_and_differ_between_drives(
    robotcar: Recorded, tmp_path: Path
) -> None:
    first, angles = ins_errors(robotcar.folder.parent, robotcar)
    other = drive(tmp_path, number=1, cameras=("stereo/left",))
    second, _ = ins_errors(tmp_path, other)
    assert first.std(axis=0).max() < 0.1
    np.testing.assert_allclose(first.mean(axis=0), Truth(robotcar.truth).drawn["ins_offset_east_north_up_m"], atol=0.15)
    assert np.linalg.norm(first.mean(axis=0)[:2] - second.mean(axis=0)[:2]) > 0.5
    assert angles.max() < np.radians(1.5)
    assert angles.std() < 1e-5


@pytest.mark.thorough
def test_ins_rows_agree_with_themselves(reading: RobotCarReading) -> None:
    rows = reading.table("gps/ins.csv")
    assert ",".join(rows[0]) == (
        "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
        "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
    )
    assert {r["ins_status"] for r in rows} == {"INS_SOLUTION_GOOD"}
    assert {r["utm_zone"] for r in rows} == {"30U"}
    times = np.array([int(r["timestamp"]) for r in rows])
    np.testing.assert_array_equal(np.diff(times), 20_000)
    north = np.array([float(r["northing"]) for r in rows])
    east = np.array([float(r["easting"]) for r in rows])
    speed = np.mean([float(r["velocity_east"]) for r in rows])
    assert abs((east[-1] - east[0]) / (times[-1] - times[0]) * 1e6 - speed) < 0.2
    # Heading east, as the road runs.
    assert abs(np.mean([float(r["yaw"]) for r in rows]) - np.pi / 2) < np.radians(5)
    # 111.2 km a degree of latitude, times cos(51.75 deg) a degree of longitude.
    latitude, longitude = (np.array([float(r[n]) for r in rows]) for n in ("latitude", "longitude"))
    assert abs((longitude[-1] - longitude[0]) * 111_320 * math.cos(math.radians(51.75)) - (east[-1] - east[0])) < 0.4
    assert abs((latitude[-1] - latitude[0]) * 111_250 - (north[-1] - north[0])) < 0.4
    assert len(reading.table("gps/gps.csv")) == -(-len(rows) // 10)
    assert 4 <= int(reading.table("gps/gps.csv")[0]["num_satellites"]) <= 20


def test_geographic_coordinates_on_the_central_meridian_follow_the_meridians_arc() -> None:
    # Length of the meridian by its radius of curvature, times the grid's 0.9996.
    a, e2 = 6378137.0, 2 / 298.257223563 - (1 / 298.257223563) ** 2
    phi = np.linspace(0, np.radians(52), 200_001)
    radius = a * (1 - e2) / (1 - e2 * np.sin(phi) ** 2) ** 1.5
    northing = 0.9996 * np.trapezoid(radius, phi)
    latitude, longitude = latitude_longitude(northing, 500_000.0, 30)
    np.testing.assert_allclose([latitude, longitude], [52.0, -3.0], atol=1e-8)


def test_the_grid_is_conformal_away_from_the_central_meridian() -> None:
    def metres(d_north: float, d_east: float) -> Array:
        (lat0, lon0), (lat1, lon1) = (
            latitude_longitude(5_735_000.0 + k * d_north, 620_000.0 + k * d_east, 30) for k in (-0.5, 0.5)
        )
        a, e2, phi = 6378137.0, 2 / 298.257223563 - (1 / 298.257223563) ** 2, np.radians((lat0 + lat1) / 2)
        w = 1 - e2 * np.sin(phi) ** 2
        return np.radians([(lat1 - lat0), (lon1 - lon0)]) * [
            a * (1 - e2) / w**1.5,
            a * np.cos(phi) / np.sqrt(w),
        ]

    north, east = metres(100.0, 0.0), metres(0.0, 100.0)
    # Scale factor 0.9996 (1 + (120 km)^2 / 2 R^2).
    expected = 100 / (0.9996 * (1 + 120_000**2 / (2 * 6_381_000**2)))
    np.testing.assert_allclose([np.linalg.norm(north), np.linalg.norm(east)], expected, atol=1e-3)
    assert abs(north @ east) < 1e-6 * 100**2


@pytest.mark.thorough
def test_splines_pass_through_the_drive_and_change_speed_steadily(truth: Truth) -> None:
    np.testing.assert_array_equal(np.diff(truth.times), 10_000_000)
    speed = np.linalg.norm(np.diff(truth.poses[:, :3, 3], axis=0), axis=1) * 100
    assert 4 < speed.min() < speed.max() < 13
    # Straight lines between the steps of the drive would change it by half a metre a second at once.
    assert np.abs(np.diff(speed)).max() < 0.15


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return drive(
        tmp_path_factory.mktemp("kitti"),
        "kitti",
        frames=4,
        scale=0.35,
        rings=64,
        azimuths=1200,
        factors=Factors(),
    )


@pytest.mark.thorough
@pytest.mark.parametrize(("depth", "typical_m"), [("velodyne", 0.06), ("stereo", 0.5)])
def test_the_kitti_importer_reads_a_recording_and_agrees_with_the_truth(
    sequence: Recorded, tmp_path: Path, depth: str, typical_m: float
) -> None:
    settings = {"correspondences": 50, "max_disparity": 48, "depth": depth, "pair_step": (1, 2)}
    root = tmp_path / "exact"
    shutil.copytree(sequence.folder.parent.parent, root)
    shutil.copy(sequence.truth / "poses_cam0.txt", root / "poses" / "00.txt")
    dataset = kitti.build([root], kitti.Options.model_validate(settings), tmp_path / "out", Silent(), Run())
    truth = Truth(sequence.truth)
    T_world_cam = {t: truth.rig(t) @ truth.T_rig["image_0"] for t in range(0, 400_000_000, 100_000_000)}
    pairs = dataset.pair_set("kitti_00__kitti_00__image_0").pairs
    assert len(pairs) == 5
    for pair in pairs:
        assert pair.T_query_ref is not None
        expected = invert(T_world_cam[pair.query_timestamp_ns]) @ T_world_cam[pair.ref_timestamp_ns]
        np.testing.assert_allclose(pair.T_query_ref, expected, atol=1e-6)
    traversal = dataset.traversal("kitti_00")
    camera = KittiLayout(root, 4, 0.35, ("image_0",), "00", 64, 2000, True).cameras["image_0"].camera
    renderer = SolidTexture(street_mesh(Street(), Factors()), Factors(), np.zeros((0, 3)), 0)
    errors = []
    for time_ns, pose in T_world_cam.items():
        measured = traversal.depth("image_0", time_ns)
        assert measured is not None
        exact = renderer.render(camera, pose, 0).depth
        known = (measured > 0) & (exact > 0) & (exact < 20)
        errors.append((measured - exact)[known])
    error = np.concatenate(errors)
    assert len(error) > 2000
    assert np.median(np.abs(error)) < typical_m


@pytest.mark.thorough
def test_the_poses_of_a_kitti_sequence_are_those_of_a_gnss_in_a_world_of_their_own(sequence: Recorded) -> None:
    def read(path: Path) -> Array:
        rows = [[*map(float, line.split()), 0, 0, 0, 1] for line in path.read_text().splitlines()]
        return np.array(rows).reshape(-1, 4, 4)

    measured = read(sequence.folder.parent.parent / "poses" / "00.txt")
    exact = read(sequence.truth / "poses_cam0.txt")
    truth = Truth(sequence.truth)
    for i, pose in enumerate(exact):
        np.testing.assert_allclose(pose, truth.rig(100_000_000 * i) @ truth.T_rig["image_0"], atol=1e-9)
    np.testing.assert_allclose(measured[0], np.eye(4), atol=1e-12)
    error = invert(invert(exact[0]) @ exact) @ measured
    away = np.linalg.norm(error[1:, :3, 3], axis=1)
    assert (away > 1e-3).all()
    assert (away < 0.15).all()


def test_scans_of_kitti_are_compensated_unless_distorted_ones_are_asked_for(tmp_path: Path) -> None:
    shares = {}
    for distorted in (False, True):
        recorded = drive(
            tmp_path / str(distorted),
            "kitti",
            motion_distorted=distorted,
            cameras=(),
            factors=Factors(),
            frames=3,
        )
        truth = Truth(recorded.truth)
        points = np.fromfile(recorded.folder / "velodyne" / "000001.bin", np.float32).reshape(-1, 4).astype(float)
        points[:, 3] = 1.0
        world = (points @ (truth.rig(100_000_000) @ truth.T_rig["velodyne"]).T)[:, :3]
        walls = np.abs(world[:, 1]) > 5
        shares[distorted] = np.mean(nearest_surface(world[walls]) < 0.06)
    assert shares[False] > 0.99
    assert shares[True] < 0.96


def test_scans_of_drives_recorded_together_show_each_its_own_traffic(tmp_path: Path) -> None:
    options = DriveOptions("kitti", frames=2, scale=SCALE, cameras=(), rings=16, azimuths=400)
    street = Street()
    both = [prepare(street, StraightRoad(), TRAFFIC, tmp_path, replace(options, number=k)) for k in range(2)]
    carry_out([job for _, job in both], Silent(), Run(), SolidTexture, street_mesh)
    alone = drive(tmp_path / "alone", "kitti", frames=2, cameras=(), number=1)
    assert hashes(both[1][0].folder / "velodyne") == hashes(alone.folder / "velodyne")


def test_seeds_change_the_drive_and_numbers_the_day(tmp_path: Path) -> None:
    paths = [drive(tmp_path / str(k), cameras=(), seed=k, frames=3) for k in range(2)]
    assert paths[0].name == paths[1].name
    poses = [(p.truth / "poses.csv").read_text() for p in paths]
    assert poses[0] != poses[1]
    another = drive(tmp_path / "0", cameras=(), number=1, frames=3)
    assert another.name == "2024-03-02-10-00-00"
    assert another.folder.parent == paths[0].folder.parent


DRIVEN = """
import sys
from pathlib import Path
from test_synthetic_recording import drive
if __name__ == "__main__":
    drive(Path(sys.argv[1]), cameras=("stereo/left", "mono_rear"), frames=8)
"""


@pytest.mark.thorough
def test_a_killed_recording_is_finished_by_two_workers_with_the_same_bytes(tmp_path: Path) -> None:
    whole = drive(tmp_path / "whole", cameras=("stereo/left", "mono_rear"), frames=8)
    out = tmp_path / "killed"
    run_until_killed(["python", "-c", DRIVEN, out], Fault(r"stereo/left/\d+\.png$", 4), tmp_path / "trace")
    images = list(out.glob("*/stereo/left/[0-9]*.png"))
    assert len(images) == 3
    # Files from elsewhere that end too soon are noticed as well.
    kept = out / images[0].relative_to(out)
    kept.write_bytes(kept.read_bytes()[:-20])
    scan = next((out / whole.name / "lms_front").glob("*.bin"))
    scan.write_bytes(scan.read_bytes()[:-8])
    drive(out, workers=2, cameras=("stereo/left", "mono_rear"), frames=8)
    assert hashes(out) == hashes(tmp_path / "whole")


def test_a_finished_recording_is_left_alone(tmp_path: Path) -> None:
    recorded = drive(tmp_path, cameras=("stereo/left",), frames=3)
    before = {p: p.stat().st_mtime_ns for p in recorded.folder.rglob("*.png")}
    drive(tmp_path, cameras=("stereo/left",), frames=3)
    assert before == {p: p.stat().st_mtime_ns for p in recorded.folder.rglob("*.png")}


def test_another_recording_of_the_name_is_refused(tmp_path: Path) -> None:
    drive(tmp_path, cameras=(), frames=3)
    with refused(DatasetError, "settings.yaml", None, "recording"):
        drive(tmp_path, cameras=(), frames=4)
    with refused(DatasetError, "models/stereo_wide_left.txt", None, "image size"):
        drive(tmp_path, cameras=(), frames=3, number=1, scale=0.2)


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({"layout": "euroc"}, ("euroc", "robotcar", "kitti")),
        ({"frames": 1}, ("frames", 2, 1)),
        ({"scale": 0.0}, ("scale", "0.0")),
        ({"cameras": ("stereo/top",)}, ("stereo/top",)),
        ({"cameras": ("left",), "layout": "kitti"}, ("left",)),
        ({"path": StraightRoad(90.0)}, ("90.0 m",)),
    ],
)
def test_what_cannot_be_recorded_is_refused(tmp_path: Path, options: dict[str, Any], names: tuple[object, ...]) -> None:
    with refused(ConfigError, "", None, *names):
        drive(tmp_path, **options)
    assert not list(tmp_path.rglob("*"))


def test_path_length_is_enough(tmp_path: Path) -> None:
    drive(tmp_path, frames=5, cameras=(), path=StraightRoad(path_length(5, "robotcar")))


@pytest.mark.thorough
def test_a_drive_through_a_district_sees_its_houses(tmp_path: Path) -> None:
    town = make_district(3, extent_m=180.0)
    route = town.network.drive(path_length(8, "robotcar") + 1.0, seed=2)
    recorded = record(
        town, route, CONDITIONS["Rain"].factors, tmp_path, frames=8, cameras=(), number=4, run=Run(workers=2)
    )
    reading = RobotCarReading(tmp_path, recorded.name)
    ranges = []
    for sensor in ("lms_front", "lms_rear"):
        for path in reading.files(sensor, ".bin").values():
            ranges.append(np.hypot(*reading.scan(path)[:, :2].T))
    seen = np.array(ranges)
    assert seen.shape == (44, 541)
    assert 0.3 < np.mean(seen > 0) < 0.95
    assert np.mean(seen > 8) > 0.05
