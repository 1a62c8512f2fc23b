"""Drives in the Boreas layout: conventions against the true depth, sources of odometry, faults, and a whole build."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from projected_depth import agrees
from recorded_street import (
    SMALL,
    StreetDrive,
    assert_pairs_are_right,
    errors_of,
    from_poses,
)
from refusals import ErrorData, assert_names, refused

from relocbench.datasets.importers.boreas.recording import T_enu_sensor, read_boreas
from relocbench.datasets.importers.lidar_drives.drives import on_one_map
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import DatasetError
from relocbench.geometry import invert


@pytest.mark.thorough
def test_lidar_points_are_where_the_camera_sees_their_surfaces(drives: list[StreetDrive], scene: LidarScene) -> None:
    for index in (4, 13, 22):
        assert agrees(errors_of(drives[0], drives[0].source, "camera", index, scene))


def rewritten_matrix(change: Callable[[np.ndarray], np.ndarray], name: str) -> Callable[[Path], None]:
    def change_file(folder: Path) -> None:
        path = folder / "calib" / f"{name}.txt"
        np.savetxt(path, change(np.loadtxt(path)))

    return change_file


def attitude_of_the_other_convention(folder: Path) -> None:
    """Roll, pitch and heading as if they were the rotation from the sensor to ENU."""
    path = folder / "applanix" / "gps_post_process.csv"
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        row[7:10] = [repr(-float(v)) for v in row[7:10]]
    path.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")


def times_of_points_reversed(folder: Path) -> None:
    for path in (folder / "lidar").iterdir():
        table = np.fromfile(path, "<f4").reshape(-1, 6)
        table[:, 5] *= -1
        table.tofile(path)


def scans_named_by_their_start(folder: Path) -> None:
    for path in sorted((folder / "lidar").iterdir()):
        path.rename(path.with_name(f"{int(path.stem) - 50_000}.bin"))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "spoil",
    [
        rewritten_matrix(invert, "T_camera_lidar"),
        rewritten_matrix(invert, "T_applanix_lidar"),
        rewritten_matrix(lambda T: T[[1, 0, 2, 3]] * np.array([[1], [-1], [1], [1]]), "T_camera_lidar"),
        attitude_of_the_other_convention,
        times_of_points_reversed,
        scans_named_by_their_start,
    ],
    ids=["inverse camera", "inverse applanix", "swapped axes", "attitude", "times of points", "scan's time"],
)
def test_a_wrong_convention_shows_in_the_depths(
    drives: list[StreetDrive], scene: LidarScene, tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    folder = tmp_path / drives[0].folder.name
    shutil.copytree(drives[0].folder, folder)
    recording = from_poses(read_boreas(folder, "spoilt"))
    assert agrees(errors_of(drives[0], recording, "camera", 13, scene))
    spoil(folder)
    recording = from_poses(read_boreas(folder, "spoilt"))
    assert not agrees(errors_of(drives[0], recording, "camera", 13, scene))


def test_published_poses_of_a_standing_car_give_a_camera_that_looks_along_the_road() -> None:
    """The first rows of lidar_poses.csv and camera_poses.csv of boreas-2021-08-05-13-34 in the development kit, when
    the car stood; its calibration has the lidar turned by 43 degrees and the camera below and in front of it."""
    values = [
        [623425.5423358922, 4848821.001065103, 153.8522774607978, -0.010260319255, -0.019729407017, 0.577788982074],
        [623426.1559558613, 4848821.130993794, 153.6005251570965, 1.71685297456, -1.328294350493, -0.157015115732],
    ]
    T_enu_lidar, T_enu_camera = T_enu_sensor(np.array(values))
    T_camera_lidar = invert(T_enu_camera) @ T_enu_lidar
    assert T_camera_lidar[1, 2] < -0.999  # the lidar's z is up, the camera's y down
    np.testing.assert_allclose(np.degrees(np.arctan2(-T_camera_lidar[0, 1], T_camera_lidar[0, 0])), 43.3, atol=0.3)
    assert -0.3 < T_camera_lidar[1, 3] < -0.2
    assert -0.7 < T_camera_lidar[2, 3] < -0.6
    assert T_enu_lidar[2, 2] > 0.999


@pytest.mark.thorough
def test_odometry_is_the_best_there_is_and_lidar_without_poses(drives: list[StreetDrive], tmp_path: Path) -> None:
    folder = shutil.copytree(drives[0].folder, tmp_path / "boreas-2021-01-26-11-22")
    whole = read_boreas(folder, "a")
    assert whole.poses is not None
    assert whole.poses_from == "applanix/gps_post_process.csv"
    assert whole.condition.season == "winter"
    (folder / "applanix" / "gps_post_process.csv").unlink()
    coarse = read_boreas(folder, "a")
    assert coarse.poses is not None
    assert coarse.poses_from == "applanix/lidar_poses.csv"
    times = coarse.poses.times_ns
    np.testing.assert_array_equal(times, whole.lidars[0].times_ns)
    apart = np.linalg.norm(whole.poses.at(times)[:, :3, 3] - coarse.poses.T_odom_rig[:, :3, 3], axis=1)
    assert apart.max() < 1e-3  # poses are interpolated
    shutil.rmtree(folder / "applanix")
    bare = read_boreas(folder, "a")
    assert bare.poses is None
    assert bare.prior is None
    with refused(DatasetError, "gps_post_process.csv"):
        read_boreas(folder, "a", "applanix")


@pytest.mark.thorough
def test_positions_in_another_map_are_no_prior(drives: list[StreetDrive], tmp_path: Path) -> None:
    """Earlier releases state positions on the UTM grid, later ones relative to the first drive."""
    folder = tmp_path / drives[1].folder.name
    shutil.copytree(drives[1].folder, folder)
    path = folder / "applanix" / "gps_post_process.csv"
    lines = path.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        row[1], row[2] = repr(float(row[1]) + 623425.0), repr(float(row[2]) + 4848821.0)
    path.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
    here, there = (read_boreas(f, n) for f, n in ((drives[0].folder, "a"), (folder, "b")))
    from relocbench.progress import Silent

    assert [d.prior is None for d in on_one_map([here, there], Silent())] == [False, True]
    near = on_one_map([there], Silent())[0].prior
    assert near is not None
    assert np.abs(near.T_odom_rig[:, :3, 3]).max() < 1500


def cut_scan(folder: Path) -> None:
    path = sorted((folder / "lidar").iterdir())[3]
    path.write_bytes(path.read_bytes()[:-5])


def absurd_times(folder: Path) -> None:
    path = sorted((folder / "lidar").iterdir())[3]
    table = np.fromfile(path, "<f4").reshape(-1, 6)
    table[:, 5] = np.nan
    table.tofile(path)


def emptied(name: str) -> Callable[[Path], None]:
    def empty(folder: Path) -> None:
        path = sorted((folder / name).iterdir())[2] if (folder / name).is_dir() else folder / name
        path.write_bytes(b"")

    return empty


def without(name: str) -> Callable[[Path], None]:
    def remove(folder: Path) -> None:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return remove


def rewritten(name: str, old: str, new: str) -> Callable[[Path], None]:
    def rewrite(folder: Path) -> None:
        path = folder / name
        path.write_text(path.read_text().replace(old, new))

    return rewrite


def renamed_scan(folder: Path) -> None:
    path = sorted((folder / "lidar").iterdir())[3]
    path.rename(path.with_name("scan_3.bin"))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (without("lidar"), ("lidar", None, "TIME.bin")),
        (renamed_scan, ("scan_3.bin", None, "scan_3")),
        (cut_scan, ("lidar/1709287200340000.bin", None, "24 bytes")),
        (absurd_times, ("lidar/1709287200340000.bin", None, "second")),
        (emptied("lidar"), ("lidar/1709287200240000.bin", None, "empty")),
        (without("calib/T_applanix_lidar.txt"), ("T_applanix_lidar.txt", None, "missing")),
        (rewritten("calib/T_applanix_lidar.txt", "6.86", "9.86"), ("T_applanix_lidar.txt", None, "rotation")),
        (emptied("calib/T_camera_lidar.txt"), ("T_camera_lidar.txt", None, "found 0")),
        (rewritten("calib/P_camera.txt", "e+02", "x"), ("P_camera.txt", 1, "m0")),
        (rewritten("applanix/gps_post_process.csv", "heading", "yaw"), ("gps_post_process.csv", 1, "heading")),
        (emptied("applanix/gps_post_process.csv"), ("gps_post_process.csv", 1)),
        (emptied("camera"), ("camera/1709287200200000.png", None, "empty")),
    ],
)
def test_a_fault_is_told_with_its_file(
    drives: list[StreetDrive], tmp_path: Path, spoil: Callable[[Path], None], words: ErrorData
) -> None:
    folder = shutil.copytree(drives[0].folder, tmp_path / "spoilt")
    spoil(folder)
    with refused(DatasetError, *words):
        read_all_scans(folder)


def read_all_scans(folder: Path) -> None:
    lidar = read_boreas(folder, "spoilt").lidars[0]
    for index in range(len(lidar.times_ns)):
        lidar.read(index)


@pytest.mark.thorough
def test_drives_are_brought_together_by_one_command(drives: list[StreetDrive], tmp_path: Path) -> None:
    out = tmp_path / "data set"
    outcome = relocbench("build-dataset", "boreas", *(d.folder for d in drives), "--out", out, "-j", 1, *SMALL)
    assert outcome.status == 0, outcome.err
    assert "applanix/gps_post_process.csv" in outcome.err
    names = [drive.folder.name for drive in drives]
    assert_pairs_are_right(out, f"{names[0]}__{names[1]}__camera", *drives)
    assert relocbench("validate", out).status == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{0}"], ("", None, 1)),
        (["{0}", "{0}"], ("boreas-2024-03-01-10-00",)),
        (["{0}", "{1}", "--cameras", "radar"], ("", None, "radar")),
        (["{0}/..", "{1}"], ("", None, "applanix", "lidar")),
        (["{0}", "{1}", "--odometry", "imu"], ("", None, "odometry")),
    ],
)
def test_wrong_use_is_told_in_one_line(
    drives: list[StreetDrive], tmp_path: Path, arguments: list[str], words: ErrorData
) -> None:
    places = [drive.folder for drive in drives]
    outcome = relocbench("build-dataset", "boreas", *(a.format(*places) for a in arguments), "--out", tmp_path / "d")
    assert outcome.status == 2
    assert_names(outcome.err, *words)
