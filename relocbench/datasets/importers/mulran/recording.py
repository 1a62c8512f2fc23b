"""A drive of the MulRan dataset, read as a recording.

Layout and conventions: Kim et al., MulRan: Multimodal Range Dataset for Urban Place Recognition, ICRA 2020; its file
player (``file_player_mulran``) and ``calib_base2ouster.txt``, which is published with the dataset.

- ``Ouster/TIME.bin`` or ``sensor_data/Ouster/TIME.bin``, TIME in nanoseconds: float32 ``x y z intensity``, column by
  column of 64 beams as they were fired; (0, 0, 0) is a beam without a return. The lidar turns ten times a second.
- ``global_pose.csv``: ``TIME`` in nanoseconds and the upper three rows of ``T_utm_base``, the base with axes x forward,
  y left, z up. The Ouster faces backward on it.

The rig is the base. The dataset has no cameras; radar, IMU and GPS are not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import files_by_time
from relocbench.datasets.sensors.pose_tables import read_matrix_rows
from relocbench.datasets.sensors.scan_files import Returns, ScanFiles, columns
from relocbench.errors import DatasetError
from relocbench.geometry import make_transform
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["lidar", "poses"]
ScanTime = Literal["start", "middle", "end"]

T_BASE_OUSTER = make_transform(
    Rotation.from_euler("xyz", [0.0001, 0.0003, 179.6654], degrees=True).as_matrix(), [1.7042, -0.021, 1.8047]
)
"""``calib_base2ouster.txt``: metres, and roll, pitch, yaw in degrees about fixed axes"""
_BEAMS = 64
_TURN_NS = 100_000_000
_PRIOR_SIGMA_M = 5.0
"""the published poses are those of a pose graph with GNSS of a few metres"""


@dataclass(frozen=True)
class ColumnsInOrder:
    """Decodes scans whose points are in the order of firing, some beams at a time."""

    moment: ScanTime
    """the moment of the turn that a scan's name states"""

    def __call__(self, data: bytes, path: Path, /) -> Returns:
        table = columns(data, "x y z intensity", path)
        count = -(-len(table) // _BEAMS)
        share = (np.arange(len(table)) // _BEAMS + 0.5) / count - {"start": 0.0, "middle": 0.5, "end": 1.0}[self.moment]
        return Returns(table[:, :3].astype(np.float64), np.rint(share * _TURN_NS).astype(np.int64))


def read_mulran(
    folder: Path,
    name: str,
    odometry: OdometrySource = "lidar",
    scan_time: ScanTime = "start",
    reporter: Reporter = SILENT,
) -> DriveFiles:
    """Read a drive; scans are opened later, on demand.

    Args:
        odometry: ``lidar`` registers the scans, ``poses`` is ``global_pose.csv``.
        scan_time: the moment of a turn that a scan's name states.
        reporter: is told which rows have no pose.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
    """
    places = [folder / "sensor_data" / "Ouster", folder / "Ouster"]
    where = next((place for place in places if place.is_dir()), places[0])
    scans = files_by_time(where, (".bin",), reporter=reporter)
    if not scans[0]:
        raise DatasetError("holds no lidar scan; expected TIME.bin in nanoseconds", where)
    lidar = ScanFiles("Ouster", *scans, T_BASE_OUSTER, ColumnsInOrder(scan_time), 120.0, 0.03, min_range_m=0.8)
    path = folder / "global_pose.csv"
    needless = odometry == "lidar" and not path.exists()
    track = None if needless else rig_trajectory(read_matrix_rows(path, reporter), reporter)
    return DriveFiles(
        name=name,
        folder=folder,
        condition=dated(None, folder),
        lidars=(lidar,),
        poses=track if odometry == "poses" else None,
        poses_from=path.name,
        prior=track,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )
