"""Doors that read tables of poses, each with a layout of a few frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fuzz.lidar_drives import SEEDS as DRIVES
from fuzz.recordings import SEEDS as RECORDINGS
from refusals import Notes

from relocbench.datasets.importers.boreas.recording import read_boreas
from relocbench.datasets.importers.clouds.recording import read_clouds
from relocbench.datasets.importers.complex_urban.recording import read_complex_urban
from relocbench.datasets.importers.four_seasons.recording import read_recording
from relocbench.datasets.importers.generic.dataset import read_folder
from relocbench.datasets.importers.helipr.recording import read_helipr
from relocbench.datasets.importers.kitti360.recording import read_kitti360
from relocbench.datasets.importers.mulran.recording import read_mulran
from relocbench.datasets.importers.nclt.recording import read_nclt
from relocbench.datasets.importers.robotcar.recording import read_robotcar
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.recording import Trajectory


def times_of(trajectory: Trajectory | PoseTable | None) -> list[int]:
    assert trajectory is not None
    return [int(time) for time in trajectory.times_ns]


@dataclass(frozen=True)
class Door:
    """A door with a layout of a few frames, and its table of poses."""

    write: Callable[[Path], object]
    table: str
    first: int
    """lines before the first pose"""
    times: Callable[[Path, Notes], list[int]]
    """the times of the poses that it reads"""


DOORS = {
    "boreas": Door(
        DRIVES["boreas"],
        "boreas-2021-01-26-11-22/applanix/gps_post_process.csv",
        1,
        lambda root, notes: times_of(read_boreas(root / "boreas-2021-01-26-11-22", "a", reporter=notes).poses),
    ),
    "mulran": Door(
        DRIVES["mulran"],
        "DCC01/global_pose.csv",
        0,
        lambda root, notes: times_of(read_mulran(root / "DCC01", "a", "poses", reporter=notes).poses),
    ),
    "helipr": Door(
        DRIVES["helipr"],
        "KAIST05/LiDAR_GT/Ouster_gt.txt",
        0,
        lambda root, notes: times_of(read_helipr(root / "KAIST05", "a", ("Ouster",), "poses", notes).poses),
    ),
    "nclt": Door(
        DRIVES["nclt"],
        "2012-01-08/groundtruth_2012-01-08.csv",
        1,
        lambda root, notes: times_of(read_nclt(root / "2012-01-08", "a", "poses", reporter=notes).poses),
    ),
    "kitti-360": Door(
        DRIVES["kitti-360"],
        "data_poses/2013_05_28_drive_0000_sync/poses.txt",
        0,
        lambda root, notes: times_of(read_kitti360(root, "0000", "a", "poses", notes).poses),
    ),
    "complex-urban": Door(
        DRIVES["complex-urban"],
        "urban28/global_pose.csv",
        0,
        lambda root, notes: times_of(read_complex_urban(root / "urban28", "a", (), "poses", notes).poses),
    ),
    "clouds": Door(
        DRIVES["folder-of-clouds"],
        "summer/poses.txt",
        0,
        lambda root, notes: times_of(read_clouds(root / "summer", "a", notes).poses),
    ),
    "robotcar": Door(
        RECORDINGS["robotcar"],
        "2014-11-18-13-20-12/gps/ins.csv",
        1,
        lambda root, notes: times_of(read_robotcar(root / "2014-11-18-13-20-12", reporter=notes).prior),
    ),
    "four-seasons": Door(
        RECORDINGS["four-seasons"],
        "recording_2020-10-07_14-47-51/GNSSPoses.txt",
        1,
        lambda root, notes: list(read_recording(root / "recording_2020-10-07_14-47-51", "a", notes).T_w_cam),
    ),
    "generic": Door(
        RECORDINGS["generic"],
        "one/poses.txt",
        1,
        lambda root, notes: times_of(read_folder(root / "one", "a", reporter=notes).poses),
    ),
}
