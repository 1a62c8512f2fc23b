"""The Velodynes of the Oxford Radar RobotCar dataset: raw and binary scans against the true depth of a street."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from lidar_layouts import pose_times, write, write_velodynes
from projected_depth import agrees
from recorded_street import StreetDrive, errors_of, record_street
from refusals import Notes, noted, refused

from relocbench.datasets.importers.lidar_drives.texts import transform_from_xyzrpy
from relocbench.datasets.importers.robotcar.recording import read_robotcar
from relocbench.datasets.importers.robotcar.track import T_RIG_VEHICLE
from relocbench.datasets.sensors.image_files import ImageFiles
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.datasets.synthetic.drives.odometry import EXACT
from relocbench.datasets.synthetic.layouts.robotcar_odometry import vo_text
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform

EXTRINSICS = {
    "velodyne_left": "-0.60072 -0.34077 -0.26837 -0.0053948 -0.041998 -3.1337",
    "velodyne_right": "-0.61153 0.55676 -0.27023 0.0027052 -0.041999 -3.1357",
}
"""as published with the dataset's SDK"""
T_CAR_VEHICLE = make_transform(np.diag([1.0, -1.0, -1.0]), [0.4, 0.1, 1.6])


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> StreetDrive:
    return record_street(tmp_path_factory.mktemp("drives"), 0, frames=6, azimuths=360)


@pytest.fixture(scope="module", params=["raw", "binary"])
def folder(
    request: pytest.FixtureRequest, drive: StreetDrive, scene: LidarScene, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    root = tmp_path_factory.mktemp(request.param)
    folder = root / "2019-01-10-11-46-21-radar-oxford-10k"
    poses = {name: T_CAR_VEHICLE @ transform_from_xyzrpy([*map(float, v.split())]) for name, v in EXTRINSICS.items()}
    write_velodynes(drive, folder, scene, poses, raw=request.param == "raw")
    for name, values in EXTRINSICS.items():
        write(root / "extrinsics" / f"{name}.txt", values + "\n")
    times = pose_times(drive, 20_000_000) // 1000 * 1000
    vehicle = drive.T_world_car(times) @ T_CAR_VEHICLE
    write(folder / "vo" / "vo.csv", vo_text(times, vehicle, np.random.default_rng(0), EXACT))
    return folder


def seen(drive: StreetDrive, recording: FieldRecording) -> FieldRecording:
    """The recording with the camera of the drive, mounted on the vehicle."""
    camera = drive.source.cameras["camera"]
    assert isinstance(camera, ImageFiles)
    T_rig_cam = T_RIG_VEHICLE @ invert(T_CAR_VEHICLE) @ drive.T_car_cam
    return replace(recording, cameras={"camera": replace(camera, T_rig_cam=T_rig_cam)})


@pytest.mark.thorough
def test_points_of_both_velodynes_are_where_the_camera_sees_surfaces(
    drive: StreetDrive, scene: LidarScene, folder: Path
) -> None:
    recording = seen(drive, read_robotcar(folder))
    assert [lidar.name for lidar in recording.lidars] == ["velodyne_left", "velodyne_right"]
    assert recording.condition.season == "winter"
    for lidar in (0, 1):
        assert agrees(errors_of(drive, recording, "camera", 3, scene, lidar=lidar))


@pytest.mark.thorough
def test_extrinsics_the_other_way_round_show_in_the_depths(
    drive: StreetDrive, scene: LidarScene, folder: Path, tmp_path: Path
) -> None:
    inverse = invert(transform_from_xyzrpy([*map(float, EXTRINSICS["velodyne_left"].split())]))
    rotated = transform_from_xyzrpy([0.6, 0.34, 0.27, 0.0054, -0.042, 3.1337])
    assert np.abs(inverse[:3, :3] - rotated[:3, :3]).max() < 0.1
    write(tmp_path / "velodyne_left.txt", " ".join(map(str, [*inverse[:3, 3].tolist(), 0.0054, -0.042, 3.1337])))
    recording = seen(drive, read_robotcar(folder, extrinsics=tmp_path, lidars=["velodyne_left"]))
    assert not agrees(errors_of(drive, recording, "camera", 3, scene))


def test_times_of_points_are_those_of_their_firings(folder: Path) -> None:
    lidar = read_robotcar(folder).lidars[0]
    scan = lidar.read(4)
    since = scan.times_ns - lidar.times_ns[4]
    assert since.min() >= 0
    assert 49_000_000 < since.max() <= 50_000_000
    azimuth = np.mod(np.arctan2(scan.points[:, 0], -scan.points[:, 1]) - 1.0, 2 * np.pi)
    expected = azimuth / (2 * np.pi) * 50_000_000
    near_the_seam = (azimuth < 0.05) | (azimuth > 2 * np.pi - 0.05)
    assert np.abs(since - expected)[~near_the_seam].max() < 400_000


def test_without_visual_odometry_motion_comes_from_the_scans(folder: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("velodyne_left", "velodyne_right"):
        (bare / name).symlink_to(folder / name)
    asked = []

    def from_lidar(lidar: object, *_: object, **__: object) -> Trajectory:
        asked.append(lidar)
        return Trajectory(np.array([0, 1]), np.tile(np.eye(4), (2, 1, 1)))

    spoken = Notes()
    where = folder.parent / "extrinsics"
    found = read_robotcar(bare, extrinsics=where, reporter=spoken, from_lidar=from_lidar)
    assert asked == [found.lidars[0]]
    assert noted(spoken.notes, "velodyne_left")
    with refused(DatasetError, "vo/vo.csv"):
        read_robotcar(bare, extrinsics=where, odometry="vo")


def test_damaged_scans_are_told_with_their_file(folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    (bad / "velodyne_left").mkdir(parents=True)
    (bad / "vo").symlink_to(folder / "vo")
    source = sorted((folder / "velodyne_left").iterdir())[3]
    target = bad / "velodyne_left" / source.name
    damaged: list[tuple[bytes, tuple[object, ...]]]
    if source.suffix == ".png":
        image = cv2.imread(str(source), cv2.IMREAD_UNCHANGED)
        assert image is not None
        late = image.copy()
        late[104] ^= 1
        encoded = [cv2.imencode(".png", each)[1].tobytes() for each in (image[:100], late)]
        damaged = [
            (source.read_bytes()[:-200], ("truncated",)),
            (encoded[0], ("PNG", 106)),
            (encoded[1], ("second",)),
        ]
    else:
        damaged = [(source.read_bytes()[:-3], ("float32",)), (b"", ("empty",))]
    for data, told in damaged:
        target.write_bytes(data)
        lidar = read_robotcar(bad, extrinsics=folder.parent / "extrinsics").lidars[0]
        with refused(DatasetError, target, None, *told):
            lidar.read(0)
