"""Sequences in the layout of KITTI-360: calibration through the GNSS/IMU, rectification, times by azimuth."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from lidar_layouts import numbers, write_kitti360
from projected_depth import agrees
from recorded_street import (
    SMALL,
    StreetDrive,
    assert_pairs_are_right,
    errors_of,
    from_poses,
)
from refusals import ErrorData, assert_names, refused

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.kitti360.recording import read_kitti360, read_times
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform, so3_exp

T_CAR_IMU = make_transform(np.diag([1.0, -1.0, -1.0]) @ so3_exp(np.array([0.02, -0.01, 0.03])), [-0.4, 0.2, 0.5])
R_RECT_CAM = so3_exp(np.array([0.01, -0.02, 0.015]))


@pytest.fixture(scope="module")
def root(drives: list[StreetDrive], tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("KITTI 360")
    for number, drive in enumerate(drives):
        write_kitti360(drive, root, number, T_CAR_IMU, R_RECT_CAM)
    return root


def test_points_are_where_the_camera_sees_their_surfaces(
    drives: list[StreetDrive], scene: LidarScene, root: Path
) -> None:
    files = read_kitti360(root, "0000", "a", "poses")
    assert files.condition.season == "spring"
    recording = from_poses(files)
    for index in (5, 14, 21):
        assert agrees(errors_of(drives[0], recording, "image_00", index, scene))
    assert read_kitti360(root, "2013_05_28_drive_0000_sync", "a").poses is None


def rewritten(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """The numbers of a calibration's last line after its name, as a matrix of three rows, changed."""

    def rewrite(root: Path) -> None:
        path = root / "calibration" / name
        *others, last = path.read_text().splitlines()
        words = last.split()
        label = [words.pop(0)] if words[0].endswith(":") else []
        changed = change(np.array([*map(float, words)]).reshape(3, -1))
        path.write_text("\n".join([*others, " ".join([*label, numbers(changed)])]) + "\n")

    return rewrite


def inverse(rows: np.ndarray) -> np.ndarray:
    out: np.ndarray = invert(np.vstack([rows, [0, 0, 0, 1]]))[:3]
    return out


@pytest.mark.parametrize(
    "spoil",
    [
        rewritten("calib_cam_to_velo.txt", inverse),
        rewritten("calib_cam_to_pose.txt", inverse),
        rewritten("perspective.txt", lambda R: np.asarray(R.T)),
    ],
    ids=["camera to lidar", "camera to GNSS/IMU", "rectification"],
)
def test_a_wrong_convention_shows_in_the_depths(
    drives: list[StreetDrive], scene: LidarScene, root: Path, tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    copy = shutil.copytree(root, tmp_path / "copy")
    spoil(copy)
    assert not agrees(
        errors_of(drives[0], from_poses(read_kitti360(copy, "0000", "a", "poses")), "image_00", 14, scene)
    )


def test_times_keep_their_nine_decimals(tmp_path: Path) -> None:
    path = tmp_path / "timestamps.txt"
    path.write_text("2013-05-28 08:46:02.904094464\n2013-05-28 08:46:03.008\n")
    assert list(read_times(path).values()) == [1369730762904094464, 1369730763008000000]
    for text, line in (
        ("2013-05-28\n", 1),
        ("2013-05-28 08:46:02.9\n2013-13-28 08:46:02.9\n", 2),
        ("2013-05-28 08:46:02.9\n2013-05-28 08:46:02.9\n", 2),
    ):
        path.write_text(text)
        with refused(DatasetError, "timestamps.txt", line):
            read_times(path)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda r: (r / "calibration" / "perspective.txt").write_text("x: 1\n"),
            ("perspective.txt", None, "R_rect_00:"),
        ),
        (
            lambda r: (r / "calibration" / "calib_cam_to_velo.txt").write_text("1 2\n"),
            ("calib_cam_to_velo.txt", 1, "12 numbers"),
        ),
        (lambda r: (r / "calibration" / "calib_cam_to_pose.txt").unlink(), ("calib_cam_to_pose.txt",)),
        (
            lambda r: (r / "data_poses" / "2013_05_28_drive_0000_sync" / "poses.txt").write_text(f"99{' 1' * 12}\n"),
            ("poses.txt", 1, "99", "26"),
        ),
        (
            lambda r: shutil.rmtree(r / "data_3d_raw" / "2013_05_28_drive_0000_sync" / "velodyne_points" / "data"),
            ("velodyne_points/data", None, "FRAME.bin"),
        ),
    ],
)
def test_a_fault_is_told_with_its_file(
    root: Path, tmp_path: Path, spoil: Callable[[Path], object], words: ErrorData
) -> None:
    copy = shutil.copytree(root, tmp_path / "copy")
    spoil(copy)
    with refused(DatasetError, *words):
        read_kitti360(copy, "0000", "a")


@pytest.mark.thorough
def test_poses_of_sequences_are_paired_without_images_by_one_command(
    drives: list[StreetDrive], root: Path, tmp_path: Path
) -> None:
    """Where the camera is on the rig stands in the drives, not in the dataset."""
    out = tmp_path / "dataset"
    chosen = ("--sequence", "0000,0001", "--odometry", "poses", "--cameras", "none")
    outcome = relocbench("build-dataset", "kitti-360", root, *chosen, "--out", out, "-j", 1, *SMALL)
    assert outcome.status == 0, outcome.err
    T_rig_cam = read_kitti360(root, "0000", "a").cameras["image_00"].T_rig_cam
    assert_pairs_are_right(out, "kitti360_0000__kitti360_0001__rig", *drives, T_rig_cam=T_rig_cam)
    traversal = Dataset(out).traversal("kitti360_0000")
    assert (traversal.cameras, traversal.frames) == ([], ["rig"])
    assert {p.name for p in traversal.layout.root.iterdir()} == {"traversal.yaml", "poses.csv"}
    assert relocbench("validate", out).status == 0


@pytest.mark.thorough
def test_sequences_are_brought_together_by_one_command(drives: list[StreetDrive], root: Path, tmp_path: Path) -> None:
    """Motion is computed from scans that are distorted and hold no times."""
    out = tmp_path / "dataset"
    outcome = relocbench("build-dataset", "kitti-360", root, "--sequence", "0000,0001", "--out", out, "-j", 1, *SMALL)
    assert outcome.status == 0, outcome.err
    assert_pairs_are_right(out, "kitti360_0000__kitti360_0001__image_00", *drives)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ()),
        (["--sequence", "0000,0000"], ()),
        (["--sequence", "0000,0007"], ("", None, "2013_05_28_drive_0007_sync")),
        (["--sequence", "0000,../x"], ("", None, "sequence")),
    ],
)
def test_wrong_use_is_told_in_one_line(root: Path, tmp_path: Path, arguments: list[str], words: ErrorData) -> None:
    outcome = relocbench("build-dataset", "kitti-360", root, *arguments, "--out", tmp_path / "d")
    assert outcome.status == 2
    assert_names(outcome.err, *words)
