"""Drives in the layouts of MulRan and HeLiPR: records, calibration and times against the true depth of a street."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lidar_layouts import write_helipr, write_mulran
from projected_depth import agrees
from recorded_street import StreetDrive, errors_of, from_poses, record_street, with_camera
from refusals import refused

from relocbench.datasets.importers.helipr.recording import AEVA_WITHOUT_INTENSITY, RECORDS, T_INS_LIDAR, read_helipr
from relocbench.datasets.importers.lidar_drives.drives import on_one_map
from relocbench.datasets.importers.mulran.recording import T_BASE_OUSTER, ScanTime, read_mulran
from relocbench.datasets.sensors.scan_files import ScanFiles
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import invert
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> StreetDrive:
    return record_street(tmp_path_factory.mktemp("drives"), 0, frames=12)


@pytest.fixture(scope="module")
def mulran(drive: StreetDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mulran") / "DCC 01"
    write_mulran(drive, folder, T_BASE_OUSTER)
    return folder


@pytest.fixture(scope="module")
def helipr(drive: StreetDrive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("helipr") / "KAIST05"
    write_helipr(drive, folder, T_INS_LIDAR, aeva_intensity=True)
    return folder


def test_points_of_mulran_are_where_the_surfaces_are(drive: StreetDrive, scene: LidarScene, mulran: Path) -> None:
    files = read_mulran(mulran, "a", "poses")
    recording = with_camera(drive, from_poses(on_one_map([files], Silent())[0]))
    assert agrees(errors_of(drive, recording, "camera", 6, scene))
    assert recording.prior is not None
    assert np.abs(recording.prior.T_odom_rig[:, :3, 3]).max() < 1500


@pytest.mark.parametrize("scan_time", ["middle", "end"])
def test_another_moment_of_the_turn_shows_in_the_depths(
    drive: StreetDrive, scene: LidarScene, mulran: Path, scan_time: ScanTime
) -> None:
    recording = with_camera(drive, from_poses(read_mulran(mulran, "a", "poses", scan_time)))
    assert not agrees(errors_of(drive, recording, "camera", 6, scene))


def test_mulran_needs_no_poses_and_takes_the_flat_layout(mulran: Path, tmp_path: Path) -> None:
    assert read_mulran(mulran, "a").poses is None
    (tmp_path / "sample").mkdir()
    (tmp_path / "sample" / "Ouster").symlink_to(mulran / "sensor_data" / "Ouster")
    bare = read_mulran(tmp_path / "sample", "a")
    assert (bare.poses, bare.prior, len(bare.lidars[0].times_ns)) == (None, None, 12)
    with refused(DatasetError, "global_pose.csv"):
        read_mulran(tmp_path / "sample", "a", "poses")
    with refused(DatasetError, "sensor_data/Ouster", None, "TIME.bin"):
        read_mulran(tmp_path, "a")


def test_a_wrong_row_of_global_poses_is_told_with_its_line(mulran: Path, tmp_path: Path) -> None:
    (tmp_path / "Ouster").symlink_to(mulran / "sensor_data" / "Ouster")
    rows = (mulran / "global_pose.csv").read_text().splitlines()
    for spoilt, names in (
        (rows[3].rsplit(",", 1)[0], (12,)),
        (rows[3].replace(",", ",9.5,", 1).rsplit(",", 1)[0], ("3x3",)),
        (f"1.5e18,{rows[3].split(',', 1)[1]}", ("1.5e18",)),
    ):
        (tmp_path / "global_pose.csv").write_text("\n".join([*rows[:3], spoilt, *rows[4:]]) + "\n")
        with refused(DatasetError, "global_pose.csv", 4, *names):
            read_mulran(tmp_path, "a")


@pytest.mark.parametrize("lidar", list(RECORDS))
def test_points_of_each_lidar_of_helipr_are_where_the_surfaces_are(
    drive: StreetDrive, scene: LidarScene, helipr: Path, lidar: str
) -> None:
    recording = with_camera(drive, from_poses(read_helipr(helipr, "a", ["Ouster", lidar], "poses")))
    number = [stream.name for stream in recording.lidars].index(lidar)
    assert agrees(errors_of(drive, recording, "camera", 6, scene, lidar=number))
    wrong = recording.lidars[number]
    assert isinstance(wrong, ScanFiles)
    turned = replace(wrong, T_rig_lidar=invert(T_INS_LIDAR[lidar]))
    assert not agrees(errors_of(drive, replace(recording, lidars=(turned,)), "camera", 6, scene))


def test_odometry_of_each_lidar_is_that_of_the_rig(helipr: Path) -> None:
    found = [read_helipr(helipr, "a", [lidar], "poses").poses for lidar in RECORDS]
    assert found[0] is not None
    for track in found[1:]:
        assert track is not None
        np.testing.assert_allclose(track.T_odom_rig, found[0].T_odom_rig, atol=1e-6)


def test_early_scans_of_the_aeva_have_no_intensity(drive: StreetDrive, tmp_path: Path) -> None:
    write_helipr(drive, tmp_path / "a", T_INS_LIDAR, aeva_intensity=False)
    folder = tmp_path / "a" / "LiDAR" / "Aeva"
    for path in folder.iterdir():
        path.rename(folder / f"{int(path.stem) - 10**17}.bin")  # before the recorder kept the intensity
    stream = read_helipr(tmp_path / "a", "a", ["Aeva"]).lidars[0]
    assert len(stream.read(3).points) > 200
    late = folder / f"{1_709_287_200_000_000_000}.bin"
    late.write_bytes(b"\0" * AEVA_WITHOUT_INTENSITY.itemsize)
    stream = read_helipr(tmp_path / "a", "a", ["Aeva"]).lidars[0]
    with refused(DatasetError, late, None, "25 bytes", "29 bytes"):
        stream.read(len(stream.times_ns) - 1)


def test_lidars_of_helipr_are_chosen(helipr: Path, tmp_path: Path) -> None:
    assert [lidar.name for lidar in read_helipr(helipr, "a").lidars] == ["Ouster", "Velodyne"]
    with refused(ConfigError, "", None, "VLP"):
        read_helipr(helipr, "a", ["VLP"])
    with refused(DatasetError, "LiDAR", None, "Ouster", "Velodyne"):
        read_helipr(tmp_path, "a")
    with refused(DatasetError, "LiDAR/Avia", None, "TIME.bin"):
        read_helipr(tmp_path, "a", ["Avia"])
