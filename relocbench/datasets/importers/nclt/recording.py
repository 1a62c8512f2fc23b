"""A drive of the NCLT dataset, read as a recording.

Layout and conventions: Carlevaris-Bianco et al., University of Michigan North Campus Long-Term Vision and Lidar
Dataset, IJRR 2016, and its example scripts (``read_vel_sync.py``, ``project_vel_to_cam.py``, ``undistort.py``).

- ``velodyne_sync/TIME.bin``, TIME in microseconds: packed little-endian records of unsigned 16-bit x, y, z, which are
  ``0.005 n - 100`` metres, and 8-bit intensity and laser. Points are in the body frame (x forward, y right, z down) and
  motion-compensated.
- ``groundtruth_DATE.csv`` and ``odometry_mu_100hz.csv``: ``TIME, x, y, z, roll, pitch, yaw`` of the body, in metres and
  radians, ``R = Rz(yaw) Ry(pitch) Rx(roll)``, z down. The first rows of the ground truth may be NaN. All drives share
  the frame of the ground truth.
- ``lb3/CamN/TIME.tiff`` with ``U2D_CamN_*.txt``, ``K_camN.csv`` (for undistorted images) and ``x_lb3_cN.csv``, the
  camera's pose on the Ladybug: x, y, z in metres, roll, pitch, yaw in degrees.

The rig is the body with axes x forward, y left, z up. Hokuyo, IMU and GPS are not read, nor ``velodyne_hits.bin``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from relocbench.datasets.core.image_header import MOST_FILE_BYTES
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import camera_of, files_by_time
from relocbench.datasets.importers.lidar_drives.texts import read_matrix, transform_from_xyzrpy
from relocbench.datasets.importers.nclt.images import LadybugImages, tiff_size
from relocbench.datasets.sensors.pose_tables import PoseNumbers, Row, pose_table
from relocbench.datasets.sensors.recording import CameraStream, Trajectory
from relocbench.datasets.sensors.scan_files import Returns, ScanFiles, records
from relocbench.errors import DatasetError
from relocbench.files import parse_floats, read_bytes, read_rows
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["lidar", "wheels", "poses"]

RECORD: np.dtype[Any] = np.dtype([("x", "<u2"), ("y", "<u2"), ("z", "<u2"), ("intensity", "u1"), ("laser", "u1")])
T_RIG_BODY = np.diag([1.0, -1.0, -1.0, 1.0])
CAMERAS = ("Cam5", "Cam1", "Cam2", "Cam3", "Cam4", "Cam0")
"""the one that looks ahead first; Cam0 looks up"""
_STEP_M, _OFFSET_M = 0.005, -100.0
_US = 10**3
"""nanoseconds"""
_SIX = "x y z roll pitch yaw"
_NAME = re.compile(r"[0-9]{4}-([0-9]{2})-[0-9]{2}")
_PRIOR_SIGMA_M = 3.0


T_BODY_LB3 = transform_from_xyzrpy([0.035, 0.002, -1.23, *np.radians([-179.93, -0.23, 0.50])])
"""the Ladybug on the body, by ``project_vel_to_cam.py``"""


def read_nclt(
    folder: Path,
    name: str,
    odometry: OdometrySource = "lidar",
    calibration: Path | None = None,
    reporter: Reporter = SILENT,
) -> DriveFiles:
    """Read a drive; scans and images are opened later, on demand.

    Args:
        folder: ``DATE`` with ``velodyne_sync``, ``lb3``, ``groundtruth_DATE.csv`` and ``odometry_mu_100hz.csv``.
        odometry: ``lidar`` registers the scans, ``wheels`` is ``odometry_mu_100hz.csv``, ``poses`` the ground truth.
        calibration: folder of ``K_camN.csv``, ``x_lb3_cN.csv`` and ``U2D_CamN_*.txt``; default: ``cam_params`` in the
            drive's folder or the one above it.
        reporter: is told which rows have no pose.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
    """
    scans = files_by_time(folder / "velodyne_sync", (".bin",), _US, reporter)
    if not scans[0]:
        raise DatasetError("holds no lidar scan; expected TIME.bin in microseconds", folder / "velodyne_sync")
    lidar = ScanFiles("velodyne_sync", *scans, T_RIG_BODY, decode, 80.0, 0.03, min_range_m=1.0)
    truth = next(iter([*sorted(folder.glob("groundtruth_*.csv")), *_beside(folder)]), None)
    prior = None if truth is None else read_poses(truth, reporter)
    wheels = folder / "odometry_mu_100hz.csv"
    if odometry == "poses" and truth is None:
        raise DatasetError("holds no ground truth; expected groundtruth_DATE.csv", folder)
    source = {"lidar": None, "wheels": wheels, "poses": truth}[odometry]
    poses = read_poses(wheels, reporter) if odometry == "wheels" else prior if odometry == "poses" else None
    found = _NAME.fullmatch(folder.resolve().name)
    return DriveFiles(
        name=name,
        folder=folder,
        condition=dated(int(found[1]) if found else None, folder),
        lidars=(lidar,),
        cameras=_cameras(folder, calibration),
        poses=poses,
        poses_from="" if source is None else source.name,
        prior=prior,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )


def _beside(folder: Path) -> list[Path]:
    return sorted(folder.resolve().parent.glob(f"groundtruth_{folder.resolve().name}.csv"))


def decode(data: bytes, path: Path) -> Returns:
    """The points of a scan."""
    table = records(data, RECORD, path)
    return Returns(np.column_stack([table[axis] * _STEP_M + _OFFSET_M for axis in "xyz"]))


def read_poses(path: Path, reporter: Reporter = SILENT) -> Trajectory:
    """Poses of the rig in a map with z up, without the rows that are NaN.

    Raises:
        DatasetError: with file and line: a field is no number, times go back, or there are fewer than two poses.
    """
    rows = [Row(line, fields, time) for line, (time, *fields) in read_rows(path, f"poses (time {_SIX})", DatasetError)]
    kind = PoseNumbers(_SIX, lambda values: T_RIG_BODY @ transform_from_xyzrpy(values) @ T_RIG_BODY)
    return rig_trajectory(pose_table(rows, kind, path, reporter, own_ns=_US), reporter)


def _cameras(folder: Path, calibration: Path | None) -> dict[str, CameraStream]:
    """The cameras that have images."""
    streams: dict[str, CameraStream] = {}
    for name in CAMERAS:
        found = files_by_time(folder / "lb3" / name, (".tiff", ".tif"), _US)
        if not found[0]:
            continue
        where = _calibration(folder, calibration)
        number = name[-1]
        path = where / f"K_cam{number}.csv"
        K = read_matrix(path, "the camera's matrix", columns=3)
        mount = where / f"x_lb3_c{number}.csv"
        rows = list(read_rows(mount, f"the camera's pose ({_SIX})", DatasetError))
        six = np.array(parse_floats([f for _, fields in rows for f in fields], mount, 1, _SIX, DatasetError))
        pose = T_RIG_BODY @ T_BODY_LB3 @ transform_from_xyzrpy([*six[:3], *np.radians(six[3:])])
        size = tiff_size(read_bytes(found[0][0], "a TIFF image", DatasetError, MOST_FILE_BYTES), found[0][0])
        intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
        camera = camera_of("pinhole", size, intrinsics, (), path)
        table = next(iter(_tables(where, name)), None)
        if table is None:
            raise DatasetError(f"holds no U2D_{name}_*.txt, by which images are undistorted", where)
        streams[name] = LadybugImages(name, camera, pose, *found, "the camera's first image", table)
    return streams


def _tables(where: Path, name: str) -> Sequence[Path]:
    return sorted([*where.glob(f"U2D_{name}_*.txt"), *where.glob(f"*/U2D_{name}_*.txt")])


def _calibration(folder: Path, given: Path | None) -> Path:
    if given is not None:
        if not given.is_dir():
            raise DatasetError("no such folder; expected K_camN.csv, x_lb3_cN.csv and U2D_CamN_*.txt", given)
        return given
    drive = folder.resolve()
    found = next((p / "cam_params" for p in (drive, drive.parent) if (p / "cam_params").is_dir()), None)
    if found is None:
        raise DatasetError("has images, but there is no folder cam_params in it or above it", folder)
    return found
