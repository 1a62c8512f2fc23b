"""Drives in the layout of Complex Urban: times up to the end of a turn, calibration, a lens, SICK scans."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lidar_layouts import numbers, write, write_complex_urban
from projected_depth import agrees
from recorded_street import StreetDrive, errors_of, from_poses, record_street
from refusals import ErrorData, refused

from relocbench.datasets.importers.complex_urban.recording import decode_sick, read_calibration, read_complex_urban
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import Camera, invert, so3_exp

R_RECT_CAM = so3_exp(np.array([0.01, -0.02, 0.005]))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> StreetDrive:
    return record_street(tmp_path_factory.mktemp("drives"), 0, frames=8)


def lens_of(drive: StreetDrive) -> Camera:
    return replace(
        drive.layout.cameras["camera"].camera, model="radtan", distortion=(-0.06, 0.01, 0.0005, -0.0004, 0.0)
    )


@pytest.fixture(scope="module")
def folder(drive: StreetDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("complex urban") / "urban39"
    write_complex_urban(drive, folder, lens_of(drive), R_RECT_CAM)
    return folder


def test_points_are_where_the_camera_sees_their_surfaces(drive: StreetDrive, scene: LidarScene, folder: Path) -> None:
    files = read_complex_urban(folder, "a", odometry="poses")
    recording = from_poses(files)
    assert [lidar.name for lidar in recording.lidars] == ["VLP_left"]
    for index in (2, 5):
        assert agrees(errors_of(drive, recording, "stereo_left", index, scene))
    assert read_complex_urban(folder, "a").poses is None


def test_images_are_demosaicked_and_undistorted(drive: StreetDrive, folder: Path) -> None:
    stream = read_complex_urban(folder, "a").cameras["stereo_left"]
    assert stream.camera == drive.layout.cameras["camera"].camera
    ours, true = (s.read(4)[20:-20, 20:-20].astype(float) for s in (stream, drive.source.cameras["camera"]))
    assert np.median(np.abs(ours - true)) < 4
    shifted = np.median(np.abs(ours[:, 3:] - true[:, :-3]))
    assert shifted > 2 * np.median(np.abs(ours - true))


def test_the_right_camera_is_a_baseline_to_the_right(folder: Path) -> None:
    cameras = read_complex_urban(folder, "a").cameras
    T_left_right = invert(cameras["stereo_left"].T_rig_cam) @ cameras["stereo_right"].T_rig_cam
    np.testing.assert_allclose(T_left_right[:3, :3], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(T_left_right[:3, 3], R_RECT_CAM.T @ [0.475, 0, 0], atol=1e-9)


def inverse_of(name: str) -> Callable[[Path], None]:
    def invert_file(folder: Path) -> None:
        path = folder / "calibration" / f"{name}.txt"
        T = invert(read_calibration(path))
        path.write_text(f"R: {numbers(T[:3, :3])}\nT: {numbers(T[:3, 3])}\n")

    return invert_file


def scans_named_by_their_start(folder: Path) -> None:
    for path in sorted((folder / "sensor_data" / "VLP_left").iterdir()):
        path.rename(path.with_name(f"{int(path.stem) - 100_000_000}.bin"))


@pytest.mark.parametrize(
    "spoil", [inverse_of("Vehicle2LeftVLP"), inverse_of("Vehicle2Stereo"), scans_named_by_their_start]
)
def test_a_wrong_convention_shows_in_the_depths(
    drive: StreetDrive, scene: LidarScene, folder: Path, tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    spoil(copy)
    recording = from_poses(read_complex_urban(copy, "a", odometry="poses"))
    assert not agrees(errors_of(drive, recording, "stereo_left", 5, scene))


def test_a_scan_of_the_sick_described_by_hand_is_decoded(folder: Path, tmp_path: Path) -> None:
    """286 beams from -5 degrees on, every 0.666 degrees; the beam at 90 degrees looks along y."""
    table = np.zeros((286, 2), dtype="<f4")
    table[0, 0], table[143, 0] = 2.0, 10.0
    found = decode_sick(table.tobytes(), Path("scan.bin"))
    np.testing.assert_allclose(found.points[0], 2 * np.array([np.cos(np.radians(-5)), np.sin(np.radians(-5)), 0]))
    np.testing.assert_allclose(found.points[143], [0, 10, 0], atol=0.05)
    assert found.offsets_ns is not None
    assert found.offsets_ns[0] < found.offsets_ns[143] < found.offsets_ns[285]
    assert abs(int(found.offsets_ns[143])) < 10_000
    copy = shutil.copytree(folder, tmp_path / "copy")
    name = next((copy / "sensor_data" / "VLP_left").iterdir()).name
    write(copy / "sensor_data" / "SICK_back" / name, table.tobytes())
    write(copy / "calibration" / "Vehicle2BackSick.txt", f"R: {numbers(np.eye(3))}\nT: 0 0 1\n")
    sick = read_complex_urban(copy, "a", ["SICK_back"]).lidars[0]
    assert (sick.pattern, len(sick.read(0).points)) == ("push-broom", 2)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d: shutil.rmtree(d / "sensor_data"), ("sensor_data", None, "VLP_left", "VLP_right")),
        (
            lambda d: (d / "calibration" / "Vehicle2LeftVLP.txt").write_text("R: 1 2\n"),
            ("Vehicle2LeftVLP.txt", 1, "9 numbers"),
        ),
        (
            lambda d: (d / "calibration" / "Vehicle2LeftVLP.txt").write_text("T: 1 2 3\n"),
            ("Vehicle2LeftVLP.txt", None, "R:"),
        ),
        (lambda d: (d / "calibration" / "left.yaml").write_text("a: 1\n"), ("left.yaml", None, "image_width")),
        (
            lambda d: (d / "calibration" / "left.yaml").write_text("distortion_model: equidistant\n"),
            ("left.yaml", None, "distortion_model", "plumb_bob"),
        ),
        (lambda d: (d / "calibration" / "Vehicle2Stereo.txt").unlink(), ("Vehicle2Stereo.txt",)),
        (lambda d: (d / "global_pose.csv").write_text("1,2\n"), ("global_pose.csv", 1, "13 columns", 2)),
    ],
)
def test_a_fault_is_told_with_its_file(
    folder: Path, tmp_path: Path, spoil: Callable[[Path], object], words: ErrorData
) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    spoil(copy)
    with refused(DatasetError, *words):
        read_complex_urban(copy, "a")
    with refused(ConfigError, "", None, "LMS"):
        read_complex_urban(folder, "a", ["LMS"])
