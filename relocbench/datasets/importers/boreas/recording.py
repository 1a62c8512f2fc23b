"""A drive of the Boreas dataset, read as a recording.

Layout, units and conventions: Burnett et al., Boreas: A Multi-Season Autonomous Driving Dataset, IJRR 2023, and the
data reference of its development kit (pyboreas, ``DATA_REFERENCE.md``).

- Files are named by whole microseconds since 1970; a scan's name is the temporal middle of its turn. Points are
  float32 ``x y z intensity laser time``, each as its beam measured it, its time in seconds relative to the name.
- ``applanix/gps_post_process.csv`` is the motion of the Applanix frame (x right, y forward, z up) at 200 Hz, times in
  seconds; ``applanix/lidar_poses.csv`` is that of the lidar at its scans, times in microseconds. Positions are east,
  north, up. Roll, pitch and heading are those of Barfoot, State Estimation for Robotics, 2017: the rotation *from the
  sensor to ENU* is the inverse of ``Rz(heading) Ry(pitch) Rx(roll)``.
- ``T_camera_lidar`` and ``T_applanix_lidar`` map points of the lidar. ``P_camera`` is that of the rectified images.

The rig is the Applanix frame with axes x forward, y left, z up. Radar and ``imu.csv`` are not read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from relocbench.arrays import Array
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import files_by_time, pinhole_files
from relocbench.datasets.importers.lidar_drives.texts import read_matrix, read_named_columns, read_transform
from relocbench.datasets.sensors.pose_tables import PoseNumbers, Row, pose_table
from relocbench.datasets.sensors.recording import CameraStream, Trajectory
from relocbench.datasets.sensors.scan_files import Returns, ScanFiles, columns, seconds_as_offsets
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["auto", "applanix", "lidar-poses", "lidar"]

APPLANIX_FILE = Path("applanix") / "gps_post_process.csv"
LIDAR_POSES_FILE = Path("applanix") / "lidar_poses.csv"
POSE_COLUMNS = ("easting", "northing", "altitude", "roll", "pitch", "heading")
_SCAN_COLUMNS = "x y z intensity laser time"
_NAME = re.compile(r"boreas-[0-9]{4}-([0-9]{2})-[0-9]{2}-[0-9]{2}-[0-9]{2}.*")
T_RIG_APPLANIX = make_transform(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [0.0, 0.0, 0.0])
_US, _S = 10**3, 10**9
"""nanoseconds"""
_MAX_RANGE_M = 200.0
_SIGMA_M = 0.03
"""typical accuracy of the range by the data sheet of the Velodyne Alpha Prime"""
_PRIOR_SIGMA_M = 3.0
"""post-processed positions are good to centimetres, with errors of metres where satellites are hidden"""


@dataclass(frozen=True)
class Calibration:
    """``calib``: the lidar and the camera on the rig."""

    T_rig_lidar: Array
    T_rig_cam: Array
    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy"""
    path: Path
    """the file of the intrinsics"""


def read_boreas(folder: Path, name: str, odometry: OdometrySource = "auto", reporter: Reporter = SILENT) -> DriveFiles:
    """Read a drive; scans and images are opened later, on demand.

    Args:
        odometry: ``applanix`` is ``gps_post_process.csv``, ``lidar-poses`` is ``lidar_poses.csv``, ``lidar`` is
            computed from the scans; ``auto`` is the first of these that there is.
        reporter: is told which rows have no pose.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
    """
    scans = files_by_time(folder / "lidar", (".bin",), _US, reporter)
    if not scans[0]:
        raise DatasetError("holds no lidar scan; expected TIME.bin in microseconds", folder / "lidar")
    T_rig_lidar = T_RIG_APPLANIX @ read_transform(folder / "calib" / "T_applanix_lidar.txt", "the lidar's pose")
    lidar = ScanFiles("lidar", *scans, T_rig_lidar, decode, _MAX_RANGE_M, _SIGMA_M, min_range_m=1.0)
    track, origin = _track(folder, T_rig_lidar, odometry, reporter)
    found = _NAME.fullmatch(folder.resolve().name)
    return DriveFiles(
        name=name,
        folder=folder,
        condition=dated(int(found[1]) if found else None, folder),
        lidars=(lidar,),
        cameras=_cameras(folder, T_rig_lidar),
        poses=None if odometry == "lidar" else track,
        poses_from=origin,
        prior=track,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )


def decode(data: bytes, path: Path) -> Returns:
    """The points of a scan."""
    table = columns(data, _SCAN_COLUMNS, path)
    return Returns(table[:, :3].astype(np.float64), seconds_as_offsets(table[:, 5]))


def T_enu_sensor(values: Array) -> Array:
    """Poses (N, 4, 4) of rows ``easting northing altitude roll pitch heading`` (N, 6), metres and radians."""
    rotation = Rotation.from_euler("xyz", values[:, 3:]).as_matrix()
    return make_transform(np.swapaxes(rotation, -1, -2), values[:, :3])


def _track(
    folder: Path, T_rig_lidar: Array, odometry: OdometrySource, reporter: Reporter
) -> tuple[Trajectory | None, str]:
    """The poses of the rig, and where they are from; None if there are none and none were asked for."""
    wanted = {"applanix": (APPLANIX_FILE,), "lidar-poses": (LIDAR_POSES_FILE,)}.get(
        odometry, (APPLANIX_FILE, LIDAR_POSES_FILE)
    )
    found = next((file for file in wanted if (folder / file).exists()), None)
    if found is None and odometry in ("auto", "lidar"):
        return None, ""
    path = folder / (found or wanted[0])
    applanix = path.name == APPLANIX_FILE.name
    found_rows = read_named_columns(path, ("GPSTime", *POSE_COLUMNS), "poses")
    rows = [Row(line, numbers, time) for line, (time, *numbers) in found_rows]
    kind = PoseNumbers(" ".join(POSE_COLUMNS), T_enu_sensor)
    table = pose_table(rows, kind, path, reporter, own_ns=_S if applanix else _US)
    T_body_rig = invert(T_RIG_APPLANIX if applanix else T_rig_lidar)
    return rig_trajectory(table, reporter, T_body_rig), str(path.relative_to(folder))


def _cameras(folder: Path, T_rig_lidar: Array) -> dict[str, CameraStream]:
    """The camera, if there are images of it."""
    found = files_by_time(folder / "camera", (".png", ".jpg"), _US)
    if not found[0]:
        return {}
    path = folder / "calib" / "P_camera.txt"
    projection = read_matrix(path, "the projection of the rectified camera")
    if np.any(projection[:3, 3] != 0) or projection[0, 1] != 0:
        raise DatasetError("expected a projection K [I | 0] without skew", path)
    K = projection[:3, :3]
    T_camera_lidar = read_transform(folder / "calib" / "T_camera_lidar.txt", "the pose of the lidar in the camera")
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return {"camera": pinhole_files("camera", found, intrinsics, T_rig_lidar @ invert(T_camera_lidar), path)}
