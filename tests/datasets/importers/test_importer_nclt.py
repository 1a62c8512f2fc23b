"""Drives in the layout of NCLT: packed points, the frame with z down, and the Ladybug's images."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from lidar_layouts import write, write_nclt
from projected_depth import agrees
from recorded_street import StreetDrive, errors_of, from_poses, record_street
from refusals import ErrorData, refused

from relocbench.datasets.core import images
from relocbench.datasets.importers.nclt.recording import T_BODY_LB3, decode, read_nclt
from relocbench.datasets.synthetic.drives.odometry import xyzrpy_from_transform
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform

T_CAR_BODY = make_transform(np.diag([1.0, -1.0, -1.0]), [0.2, -0.1, 0.6])
DATE = "2012-08-20"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> StreetDrive:
    return record_street(tmp_path_factory.mktemp("drives"), 0, frames=8)


@pytest.fixture(scope="module")
def folder(drive: StreetDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive, its camera as Cam5; the recorded images are shifted by three columns and two rows."""
    root = tmp_path_factory.mktemp("nclt data")
    folder = root / DATE
    write_nclt(drive, folder, T_CAR_BODY, xyzrpy_from_transform)
    camera = drive.layout.cameras["camera"].camera
    for path in sorted((drive.folder / "camera").iterdir()):
        target = folder / "lb3" / "Cam5" / f"{path.stem}.tiff"
        target.parent.mkdir(parents=True, exist_ok=True)
        rgb = np.roll(images.read_image(path), (2, 3), axis=(0, 1))
        assert cv2.imwrite(str(target), rgb[..., ::-1])
    T_lb3_cam = invert(T_BODY_LB3) @ invert(T_CAR_BODY) @ drive.T_car_cam
    six = xyzrpy_from_transform(T_lb3_cam)
    six[3:] = np.degrees(six[3:])
    parameters = root / "cam_params"
    write(parameters / "x_lb3_c5.csv", ",".join(map(repr, six.tolist())) + "\n")
    write(parameters / "K_cam5.csv", "\n".join(",".join(map(repr, row)) for row in camera.matrix.tolist()) + "\n")
    v, u = np.mgrid[: camera.height, : camera.width]
    rows = np.stack([v, u, v + 2, u + 3], axis=-1).reshape(-1, 4).tolist()
    head = f"width/cols = {camera.width} , height/rows = {camera.height}\n"
    write(parameters / "U2D_Cam5_1616X1232.txt", head + "".join(f"{a} {b} {c} {d}\n" for a, b, c, d in rows))
    return folder


def test_a_scan_described_by_hand_is_decoded() -> None:
    """By ``read_vel_sync.py``: two bytes each for x, y and z, one for intensity and one for the laser."""
    data = struct.pack("<HHHBB", 20_000, 20_200, 19_800, 17, 31) + struct.pack("<HHHBB", 0, 65_535, 20_001, 0, 0)
    np.testing.assert_allclose(decode(data, Path()).points, [[0.0, 1.0, -1.0], [-100.0, 227.675, 0.005]], atol=1e-9)
    with refused(DatasetError, "", None, "17", "8"):
        decode(data + b"\0", Path("scan.bin"))


@pytest.mark.parametrize("odometry", ["wheels", "poses"])
def test_points_are_where_the_camera_sees_their_surfaces(
    drive: StreetDrive, scene: LidarScene, folder: Path, odometry: str
) -> None:
    files = read_nclt(folder, "a", odometry)  # type: ignore[arg-type]
    assert files.condition.season == "summer"
    recording = from_poses(files)
    assert list(recording.cameras) == ["Cam5"]
    for index in (2, 5):
        assert agrees(errors_of(drive, recording, "Cam5", index, scene))
    np.testing.assert_allclose(recording.odometry.T_odom_rig[:, 2, 2], 1.0, atol=0.02)  # z is up
    inside = recording.cameras["Cam5"].read(3)[:-4, :-4]
    np.testing.assert_array_equal(inside, drive.source.cameras["camera"].read(3)[:-4, :-4])


def inverse_camera(folder: Path, parameters: Path) -> None:
    path = parameters / "x_lb3_c5.csv"
    six = np.array([float(v) for v in path.read_text().split(",")])
    pose = make_transform(np.eye(3), np.zeros(3))
    from relocbench.datasets.synthetic.drives.odometry import transform_from_xyzrpy

    pose = invert(transform_from_xyzrpy([*six[:3], *np.radians(six[3:])]))
    turned = xyzrpy_from_transform(pose)
    turned[3:] = np.degrees(turned[3:])
    write(path, ",".join(map(repr, turned.tolist())))


def sides_swapped(folder: Path, parameters: Path) -> None:
    for path in (folder / "velodyne_sync").iterdir():
        table = np.fromfile(path, "<u2").reshape(-1, 4)
        table[:, 1] = 40_000 - table[:, 1]
        path.unlink()
        table.tofile(path)


@pytest.mark.parametrize("spoil", [inverse_camera, sides_swapped])
def test_a_wrong_convention_shows_in_the_depths(
    drive: StreetDrive, scene: LidarScene, folder: Path, tmp_path: Path, spoil: Callable[[Path, Path], None]
) -> None:
    shutil.copytree(folder.parent, tmp_path / "copy")
    spoil(tmp_path / "copy" / DATE, tmp_path / "copy" / "cam_params")
    recording = from_poses(read_nclt(tmp_path / "copy" / DATE, "a", "poses"))
    assert not agrees(errors_of(drive, recording, "Cam5", 5, scene))


def test_scans_give_the_motion_by_default_and_the_truth_is_a_prior(folder: Path) -> None:
    files = read_nclt(folder, "a")
    assert files.poses is None
    assert files.prior is not None
    assert np.ptp(files.lidars[0].read(0).times_ns) == 0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d, p: shutil.rmtree(d / "velodyne_sync"), ("velodyne_sync", None, "TIME.bin")),
        (lambda d, p: shutil.rmtree(p), (DATE, None, "cam_params")),
        (lambda d, p: (p / "U2D_Cam5_1616X1232.txt").unlink(), ("cam_params", None, "U2D_Cam5_*.txt")),
        (lambda d, p: (p / "K_cam5.csv").write_text("1,2\n"), ("K_cam5.csv", 1, "3 numbers")),
        (lambda d, p: (p / "x_lb3_c5.csv").write_text("1,2,3\n"), ("x_lb3_c5.csv", 1, "6 numbers")),
        (
            lambda d, p: sorted((d / "lb3" / "Cam5").iterdir())[0].write_bytes(b"II*\0junk"),
            ("lb3/Cam5/1709287200000000.tiff", None, "TIFF"),
        ),
        (
            lambda d, p: (d / f"groundtruth_{DATE}.csv").write_text("1,2,3,x,0,0,0\n"),
            (f"groundtruth_{DATE}.csv", 1, "z", "x"),
        ),
        (
            lambda d, p: (d / f"groundtruth_{DATE}.csv").write_text("1,nan,nan,nan,0,0,0\n"),
            (f"groundtruth_{DATE}.csv", None, "0 poses"),
        ),
    ],
)
def test_a_fault_is_told_with_its_file(
    folder: Path, tmp_path: Path, spoil: Callable[[Path, Path], object], words: ErrorData
) -> None:
    shutil.copytree(folder.parent, tmp_path / "copy")
    spoil(tmp_path / "copy" / DATE, tmp_path / "copy" / "cam_params")
    with refused(DatasetError, *words):
        read_nclt(tmp_path / "copy" / DATE, "a")
