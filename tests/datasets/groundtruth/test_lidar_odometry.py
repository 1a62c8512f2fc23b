"""Odometry from spinning lidars, and the readers of KITTI and generic folders that use it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import yaml
from refusals import refused

from relocbench.arrays import Array, Mask
from relocbench.datasets.core import images
from relocbench.datasets.groundtruth.odometry.jitter import white_noise
from relocbench.datasets.groundtruth.odometry.lidar_odometry import deskewed, lidar_odometry
from relocbench.datasets.importers.generic.recording import read_generic
from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.importers.kitti.recording import VelodyneStream, raised, read_kitti
from relocbench.datasets.importers.robotcar.sensors import LmsStream
from relocbench.datasets.sensors.recording import Scan, Trajectory
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.jobs.recording import path_length, record
from relocbench.datasets.synthetic.town.town import make_district
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import apply, invert, make_transform, rotation_angle, se3_exp, transform_to_tq

FRAMES = 12


@pytest.fixture(
    scope="module", params=[pytest.param(how, marks=pytest.mark.thorough) for how in ("distorted", "compensated")]
)
def simulated(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A drive of 1.1 s, 9 m, with the car's motion in the scans or out of them."""
    out = tmp_path_factory.mktemp(request.param)
    town = make_district(0, "train", 180.0)
    road = town.network.drive(path_length(FRAMES, "kitti") + 1.0, 0)
    options = {"frames": FRAMES, "azimuths": 700, "cameras": (), "motion_distorted": request.param == "distorted"}
    record(town, road, condition_named("Sunny").factors, out, "kitti", **options)
    return out, request.param


def true_poses(root: Path) -> Array:
    """(N, 4, 4) ``T_world_lidar``"""
    rows = np.loadtxt(root / "truth" / "00" / "poses_cam0.txt").reshape(-1, 3, 4)
    T_world_cam0 = make_transform(rows[:, :, :3], rows[:, :, 3])
    return np.asarray(T_world_cam0 @ KittiSequence(root, "00").calibration.T_cam0_lidar())


@pytest.fixture(scope="module")
def measured(simulated: tuple[Path, Any]) -> Trajectory:
    """Odometry of the drive, as its scans tell it."""
    root, motion = simulated
    return read_kitti(root, "00", motion=motion).odometry


def test_odometry_of_a_simulated_drive_agrees_with_its_truth(simulated: tuple[Path, Any], measured: Trajectory) -> None:
    found = measured
    T_world_rig = true_poses(simulated[0])
    assert found.times_ns.tolist() == [i * 100_000_000 for i in range(FRAMES)]
    error = invert(found.T_odom_rig) @ invert(T_world_rig[0]) @ T_world_rig
    driven = np.linalg.norm(T_world_rig[-1, :3, 3] - T_world_rig[0, :3, 3])
    assert driven > 6
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.05
    assert np.degrees(rotation_angle(error[:, :3, :3])).max() < 0.25


def test_points_of_a_scan_have_the_times_of_their_beams(simulated: tuple[Path, Any]) -> None:
    """Scans of two moments of a drive put together by the true motion agree only if their times are understood."""
    root, motion = simulated
    lidar = read_kitti(root, "00", odometry="poses", motion=motion).lidars[0]
    scan = lidar.read(3)
    since = scan.times_ns - lidar.times_ns[3]
    if motion == "compensated":
        assert not since.any()
        return
    assert since.min() > -50_000_000 - 1
    assert since.max() < 50_000_000 + 1
    left = scan.points[:, 1] > np.abs(scan.points[:, 0])
    # Clockwise from behind: what lies to the left is seen before what lies ahead.
    assert np.all(since[left] < 0)


@pytest.mark.thorough
def test_odometry_is_the_same_bytes_twice(simulated: tuple[Path, Any], measured: Trajectory) -> None:
    root, motion = simulated
    again = read_kitti(root, "00", motion=motion).odometry
    assert again.T_odom_rig.tobytes() == measured.T_odom_rig.tobytes()


def test_the_files_own_poses_can_be_taken(simulated: tuple[Path, Any]) -> None:
    root, motion = simulated
    found = read_kitti(root, "00", odometry="poses", motion=motion).odometry
    T_world_rig = true_poses(root)
    error = invert(found.T_odom_rig) @ invert(T_world_rig[0]) @ T_world_rig
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.4
    np.testing.assert_allclose(found.T_odom_rig[0], np.eye(4), atol=1e-12)


def test_a_scan_is_deskewed_to_its_time() -> None:
    rng = np.random.default_rng(0)
    twist = np.array([10e-9, 1e-9, 0, 0, 0, 0.3e-9])
    still = rng.uniform(-30, 30, size=(500, 3))
    offsets = rng.integers(-50_000_000, 50_000_000, size=500)
    measured = np.array([apply(se3_exp(-twist * t), p[None])[0] for t, p in zip(offsets, still, strict=True)])
    found = deskewed(Scan(measured, 7 + offsets), 7, twist)
    np.testing.assert_allclose(found, still, atol=1e-4)


def test_turning_beams_up_keeps_ranges_and_azimuths() -> None:
    points = np.random.default_rng(1).uniform(-20, 20, size=(50, 3))
    found = raised(points, 0.205)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.linalg.norm(points, axis=1))
    np.testing.assert_allclose(np.arctan2(found[:, 1], found[:, 0]), np.arctan2(points[:, 1], points[:, 0]))
    elevation = [np.degrees(np.arctan2(p[:, 2], np.hypot(p[:, 0], p[:, 1]))) for p in (points, found)]
    np.testing.assert_allclose(elevation[1] - elevation[0], 0.205)


def test_a_push_broom_lidar_has_no_odometry() -> None:
    lidar = LmsStream("lms_front", (), np.eye(4), np.array([0]))
    with refused(ConfigError, "", None, "lms_front"):
        lidar_odometry(lidar)


@pytest.mark.parametrize("count", [5, 500], ids=["few points", "all within reach of the car"])
def test_too_few_points_for_odometry_is_an_error(count: int, tmp_path: Path) -> None:
    files = []
    for i in range(3):
        files.append(tmp_path / f"{i}.bin")
        np.random.default_rng(i).uniform(0.5, 1, size=(count, 4)).astype("<f4").tofile(files[-1])
    lidar = VelodyneStream(tuple(files), np.arange(3), "compensated", 0.0)
    with refused(DatasetError, "", None, "velodyne", 0):
        lidar_odometry(lidar)


def room(count: int, seed: int) -> Array:
    """(N, 3) points on the floor and walls of a room of 20 m x 12 m x 6 m."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-10, -6, -2], [10, 6, 4], size=(count, 3))
    side = rng.integers(0, 5, size=count)
    for k, (axis, value) in enumerate(((0, -10), (0, 10), (1, -6), (1, 6), (2, -2))):
        p[side == k, axis] = value
    return p


def written_scan(path: Path, points: Array, times: Array) -> None:
    """With the time of each point in seconds, in the format that the file's name says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".bin":
        np.column_stack([points, times]).astype("<f4").tofile(path)
    elif path.suffix == ".npy":
        np.save(path, np.column_stack([points, times]))
    else:
        cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(points.astype(np.float32)))
        cloud.point["t"] = o3d.core.Tensor.from_numpy(times.reshape(-1, 1))
        o3d.t.io.write_point_cloud(path, cloud)


def generic_folder(root: Path, suffix: str, poses: bool, **lidar: Any) -> Path:
    """Five scans of the room while the rig goes 0.2 m forward each 0.1 s; scans of still moments."""
    settings = {"pattern": "spinning", "columns": ["x", "y", "z", "t"], "time": "t", **lidar}
    root.mkdir()
    (root / "lidar.yaml").write_text(yaml.safe_dump({"lidars": {"top": settings}}))
    rows = []
    for i in range(5):
        time = 1_600_000_000_000_000_000 + i * 100_000_000
        T_world_rig = make_transform(np.eye(3), [0.2 * i, 0.0, 0.0])
        points = apply(invert(T_world_rig), room(6000, i))
        written_scan(root / "lidar" / "top" / f"{time}{suffix}", points, np.zeros(len(points)))
        t, q = transform_to_tq(T_world_rig)
        rows.append(f"{time} " + " ".join(map(repr, [*t.tolist(), *q.tolist()])))
    if poses:
        (root / "poses.txt").write_text("\n".join(rows) + "\n")
    return root


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".ply", ".pcd"])
def test_generic_scans_of_all_formats_are_read(tmp_path: Path, suffix: str) -> None:
    found = read_generic(generic_folder(tmp_path / "drive", suffix, poses=True))
    lidar = found.lidars[0]
    assert (lidar.name, lidar.pattern, len(lidar.times_ns)) == ("top", "spinning", 5)
    scan = lidar.read(2)
    np.testing.assert_allclose(scan.points, room(6000, 2) - [0.4, 0, 0], atol=1e-5)
    assert set(scan.times_ns.tolist()) == {int(lidar.times_ns[2])}
    np.testing.assert_allclose(found.odometry.T_odom_rig[:, 0, 3], [0, 0.2, 0.4, 0.6, 0.8], atol=1e-12)


def test_a_generic_folder_without_poses_gets_odometry_from_its_lidar(tmp_path: Path) -> None:
    found = read_generic(generic_folder(tmp_path / "drive", ".npy", poses=False, min_range=0.5))
    np.testing.assert_allclose(found.odometry.T_odom_rig[:, 0, 3], [0, 0.2, 0.4, 0.6, 0.8], atol=0.02)


def test_times_of_points_have_the_unit_that_is_said(tmp_path: Path) -> None:
    folder = generic_folder(tmp_path / "drive", ".npy", poses=True, time_unit="us")
    path = sorted((folder / "lidar" / "top").iterdir())[1]
    values = np.load(path)
    values[:, 3] = np.arange(len(values))
    np.save(path, values)
    lidar = read_generic(folder).lidars[0]
    assert (lidar.read(1).times_ns - lidar.times_ns[1])[:3].tolist() == [0, 1000, 2000]
    values[0, 3] = 2e6
    np.save(path, values)
    with refused(DatasetError, path.name):
        read_generic(folder).lidars[0].read(1)


def test_axes_of_a_camera_become_those_of_the_rig(tmp_path: Path) -> None:
    """The folder's rig is its camera: z forward. The recording's is x forward."""
    folder = generic_folder(tmp_path / "drive", ".npy", poses=True)
    header = yaml.safe_load((folder / "lidar.yaml").read_text())
    (folder / "lidar.yaml").write_text(yaml.safe_dump({**header, "rig_axes": "right-down-forward"}))
    camera = {"model": "pinhole", "width": 8, "height": 6, "fx": 5, "fy": 5, "cx": 3.5, "cy": 2.5}
    (folder / "camera.yaml").write_text(yaml.safe_dump({**camera, "condition": {"weather": "rain"}}))
    poses = (folder / "poses.txt").read_text().splitlines()
    moved = [line.split() for line in poses]
    rows = [" ".join([time, y, z, x, *q]) for time, x, y, z, *q in moved]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    image = np.arange(48, dtype=np.uint8).reshape(6, 8)
    images.write_image(folder / "images" / f"{moved[0][0]}.png", image)
    found = read_generic(folder)
    np.testing.assert_allclose(found.odometry.T_odom_rig[:, 0, 3], [0, 0.2, 0.4, 0.6, 0.8], atol=1e-12)
    stream = found.cameras["cam0"]
    np.testing.assert_allclose(apply(stream.T_rig_cam, [[0, 0, 1]]), [[1, 0, 0]], atol=1e-12)
    np.testing.assert_array_equal(stream.read(0), image)
    assert stream.file(0) == folder / "images" / f"{moved[0][0]}.png"
    assert found.condition.weather == "rain"


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".ply", ".pcd"])
def test_a_generic_scan_that_is_cut_off_is_named(tmp_path: Path, suffix: str) -> None:
    folder = generic_folder(tmp_path / "drive", suffix, poses=True)
    path = sorted((folder / "lidar" / "top").iterdir())[3]
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2 + 1])
    with pytest.raises(DatasetError) as caught:
        read_generic(folder).lidars[0].read(3)
    assert caught.value.path == path


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"time": "when"}, ("when",)),
        ({"columns": ["x", "y", "z"]}, (4, "lidar.yaml", 3)),
        ({"patern": "spinning"}, ("lidars.top.patern",)),
        ({"columns": ["x", "y"]}, ("columns", "x", "y", "z")),
        ({"pattern": "push-broom"}, ("lidar.yaml",)),
    ],
)
def test_mistakes_in_lidar_yaml_are_named(tmp_path: Path, change: dict[str, Any], names: tuple[object, ...]) -> None:
    folder = generic_folder(tmp_path / "drive", ".npy", poses=False, **change)
    with refused(DatasetError, "", None, *names):
        read_generic(folder).lidars[0].read(0)


def noisy(motion: Array, noise: list[float], seed: int) -> Trajectory:
    """Poses ten times a second along (N, 3) positions, with white noise of these six standard deviations."""
    rng, count = np.random.default_rng(seed), len(motion)
    xi = rng.normal(size=(count, 6)) * noise
    times = np.arange(count, dtype=np.int64) * 100_000_000
    return Trajectory(times, make_transform(np.eye(3), motion) @ np.array([se3_exp(one) for one in xi]))


def test_white_noise_of_odometry_is_that_of_its_poses() -> None:
    noise = [0.01, 0.004, 0.002, 0.001, 0.0005, 0.0002]
    motion = np.array([[0.8 * k, 0.3 * np.sin(k / 20), 0] for k in range(400)])
    odometry = noisy(motion, noise, seed=2)
    np.testing.assert_allclose(white_noise(odometry), noise, rtol=0.25)
    for few in (2, 6, 10, 22):
        assert not white_noise(Trajectory(odometry.times_ns[:few], odometry.T_odom_rig[:few])).any()


@pytest.mark.parametrize(
    "kept",
    [np.arange(600) % 8 > 0, np.random.default_rng(4).uniform(size=600) > 0.35, np.arange(600) < 24],
    ids=["every eighth scan is missing", "a third of them is missing", "a short drive"],
)
def test_white_noise_is_told_where_few_scans_follow_each_other(kept: Mask) -> None:
    noise = [0.01, 0.004, 0.004, 0.001, 0.0005, 0.0002]
    odometry = noisy(np.array([[0.8 * k, 0.0, 0.0] for k in range(600)]), noise, seed=2)
    found = white_noise(Trajectory(odometry.times_ns[kept], odometry.T_odom_rig[kept]))
    assert np.all((found > 0.4 * np.array(noise)) & (found < 2.5 * np.array(noise)))


def test_a_body_that_sways_and_heaves_is_not_noise_of_odometry() -> None:
    seconds = np.arange(400) / 10
    motion = np.column_stack([8 * seconds, 0.03 * np.sin(8 * seconds), 0.05 * np.sin(8.5 * seconds)])
    along, across, height, *_ = white_noise(noisy(motion, [0.002, 0.001, 0.0005, 0, 0, 0], seed=3))
    assert along == pytest.approx(0.002, rel=0.25)
    assert across == pytest.approx(0.001, rel=0.25)
    assert height <= across
    # A heave so fast that differences leave all of it is not taken for noise either.
    along, across, height, *_ = white_noise(noisy(motion, [0.002, 0.001, 0.005, 0, 0, 0], seed=3))
    assert height == min(along, across)
