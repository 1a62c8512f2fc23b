"""A drive of the HeLiPR dataset, read as a recording.

Layout and conventions: Jung et al., HeLiPR: Heterogeneous LiDAR Dataset for inter-LiDAR Place Recognition under
Spatiotemporal Variations, IJRR 2024; its file player and its point cloud toolbox, whose ``transformINStoLiDAR.py`` has
the poses of the lidars on the INS.

- ``LiDAR/{Ouster,Velodyne,Aeva,Avia}/TIME.bin``, TIME in nanoseconds. The records are packed, and each lidar has its
  own (:data:`RECORDS`); the time of a point is relative to the name, in nanoseconds, that of the Velodyne in seconds.
  Scans of the Aeva up to 1691936557946849179 have no intensity.
- ``LiDAR_GT/NAME_gt.txt``: ``TIME x y z qx qy qz qw``, poses of that lidar relative to the first of the drive;
  ``LiDAR_GT/global_NAME_gt.txt``: the same on the UTM grid, which drives share.

The rig is the INS with axes x forward, y left, z up. The dataset has no cameras; IMU and raw INS are not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, chosen_of, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import files_by_time
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.datasets.sensors.scan_files import Returns, ScanFiles, records, seconds_as_offsets, xyz
from relocbench.datasets.sensors.times import time_in_name
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform, project_to_rotation
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["lidar", "poses"]

_XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
_AEVA = [*_XYZ, ("reflectivity", "<f4"), ("velocity", "<f4"), ("t", "<i4"), ("line", "u1")]
RECORDS: dict[str, np.dtype[Any]] = {
    "Ouster": np.dtype(
        [*_XYZ, ("intensity", "<f4"), ("t", "<u4"), ("reflectivity", "<u2"), ("ring", "<u2"), ("ambient", "<u2")]
    ),
    "Velodyne": np.dtype([*_XYZ, ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]),
    "Aeva": np.dtype([*_AEVA, ("intensity", "<f4")]),
    "Avia": np.dtype([*_XYZ, ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1"), ("t", "<u4")]),
}
"""lidar -> the record of a point"""
AEVA_WITHOUT_INTENSITY = np.dtype(_AEVA)
LAST_WITHOUT_INTENSITY_NS = 1_691_936_557_946_849_179


def _pose(rotation: list[list[float]], translation: list[float]) -> Array:
    return make_transform(project_to_rotation(np.array(rotation)), np.array(translation))


T_INS_LIDAR: dict[str, Array] = {
    "Ouster": _pose(
        [
            [0.999715495593027, 0.0223448061210468, -0.00834490926264448],
            [-0.0224514077723064, 0.999664614804883, -0.0129070599303583],
            [0.00805370475188661, 0.0130907427756056, 0.999881878170293],
        ],
        [-0.417, -0.003, 0.2996],
    ),
    "Velodyne": _pose(
        [
            [0.999995760375673, 0.000773891425480788, -0.00280719125478291],
            [-0.000825966811080870, 0.999826715354752, -0.0185972320992637],
            [0.00279231257318289, 0.0185994719007949, 0.999823115673720],
        ],
        [-1.372, 0.0668, 0.0297],
    ),
    "Aeva": _pose(
        [
            [0.998593404866819, 0.0471428768856460, -0.0242643960451897],
            [-0.0476188752386917, 0.998676624578879, -0.0194278727795602],
            [0.0233163993252583, 0.0205559888762785, 0.999516781671935],
        ],
        [0.1337, 0.3557, 0.2219],
    ),
    "Avia": _pose(
        [
            [0.999260281307309, 0.0383884500761334, 0.00228409771914936],
            [-0.0383981303207532, 0.999253021123844, 0.00435699010113986],
            [-0.00211513344942227, -0.00444147223600340, 0.999987899694225],
        ],
        [0.2054, -0.3528, 0.0706],
    ),
}
"""as published with the toolbox"""
LIDARS = tuple(RECORDS)
_DEFAULT = ("Ouster", "Velodyne")
_MAX_RANGE_M = {"Ouster": 150.0, "Velodyne": 100.0, "Aeva": 150.0, "Avia": 150.0}
_SIGMA_M = 0.03
_PRIOR_SIGMA_M = 3.0


@dataclass(frozen=True)
class HeLiPRPoints:
    """Decodes the scans of one of the lidars."""

    lidar: str

    def __call__(self, data: bytes, path: Path, /) -> Returns:
        row = RECORDS[self.lidar]
        if self.lidar == "Aeva" and time_in_name(path) <= LAST_WITHOUT_INTENSITY_NS:
            row = AEVA_WITHOUT_INTENSITY
        table = records(data, row, path)
        times = table["t"].astype(np.int64) if "t" in (row.names or ()) else seconds_as_offsets(table["time"])
        return Returns(xyz(table), times)


def read_helipr(
    folder: Path,
    name: str,
    lidars: Sequence[str] = (),
    odometry: OdometrySource = "lidar",
    reporter: Reporter = SILENT,
) -> DriveFiles:
    """Read a drive; scans are opened later, on demand.

    Args:
        lidars: those to use; default: Ouster and Velodyne, or of them what there is.
        odometry: ``lidar`` registers the scans of the first lidar, ``poses`` is its file in ``LiDAR_GT``.
        reporter: is told which rows have no pose.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
        ConfigError: there is no such lidar.
    """
    streams = []
    for lidar in chosen_of(lidars or None, LIDARS, _DEFAULT, "HeLiPR has no lidar"):
        where = folder / "LiDAR" / lidar
        scans = files_by_time(where, (".bin",), reporter=reporter)
        if scans[0]:
            decode, pose = HeLiPRPoints(lidar), T_INS_LIDAR[lidar]
            streams.append(ScanFiles(lidar, *scans, pose, decode, _MAX_RANGE_M[lidar], _SIGMA_M, min_range_m=1.0))
        elif lidars:
            raise DatasetError("holds no lidar scan; expected TIME.bin in nanoseconds", where)
    if not streams:
        raise DatasetError(f"holds no scan of {' or '.join(_DEFAULT)}; expected TIME.bin", folder / "LiDAR")
    first = streams[0]
    files = folder / "LiDAR_GT" / f"{first.name}_gt.txt", folder / "LiDAR_GT" / f"global_{first.name}_gt.txt"
    return DriveFiles(
        name=name,
        folder=folder,
        condition=dated(None, folder),
        lidars=tuple(streams),
        poses=_poses(files[0], first, reporter) if odometry == "poses" else None,
        poses_from=str(files[0].relative_to(folder)),
        prior=_poses(files[1], first, reporter) if files[1].exists() else None,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )


def _poses(path: Path, lidar: ScanFiles, reporter: Reporter) -> Trajectory:
    return rig_trajectory(read_trajectory(path, reporter=reporter), reporter, invert(lidar.T_rig_lidar))
