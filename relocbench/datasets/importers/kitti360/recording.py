"""A sequence of KITTI-360, read as a recording.

Layout and conventions: Liao et al., KITTI-360: A Novel Dataset and Benchmarks for Urban Scene Understanding in 2D and
3D, PAMI 2022, and its development kit (``kitti360scripts``).

- ``data_3d_raw/DRIVE/velodyne_points/data/FRAME.bin``: float32 ``x y z reflectance``, not motion-compensated. The lidar
  turns ten times a second, clockwise seen from above, and faces forward at the scan's time, as in KITTI.
- ``timestamps.txt`` beside each folder of data: a date and a time of day, with nine decimals, for each frame.
- ``data_2d_raw/DRIVE/image_0{0,1}/data_rect/FRAME.png``: rectified images, with ``P_rect_0N`` and ``R_rect_0N`` of
  ``calibration/perspective.txt``. The fisheye images are not read.
- ``calib_cam_to_velo.txt`` maps from camera 0, unrectified, to the lidar; ``calib_cam_to_pose.txt`` from each camera,
  unrectified, to the GNSS/IMU.
- ``data_poses/DRIVE/poses.txt``: frame and ``T_world_imu``, in a world that all sequences share; not for all frames.

The rig is the lidar: x forward, y left, z up. The SICK and ``cam0_to_world.txt`` are not read.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import check_file, pinhole_files
from relocbench.datasets.importers.lidar_drives.texts import read_transform
from relocbench.datasets.sensors.matrices import as_transform, parse_matrix
from relocbench.datasets.sensors.numbered_rows import read_numbered_rows
from relocbench.datasets.sensors.pose_tables import read_matrix_rows, short_name
from relocbench.datasets.sensors.recording import CameraStream, Trajectory
from relocbench.datasets.sensors.scan_files import Returns, ScanFiles, columns, swept
from relocbench.datasets.sensors.times import check_increasing
from relocbench.datasets.sensors.trajectories import numbered_files, with_times
from relocbench.errors import DatasetError, quoted
from relocbench.files import parse_count, parse_floats, read_rows
from relocbench.geometry import invert, is_rotation, make_transform, project_to_rotation
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["lidar", "poses"]

CAMERAS = ("image_00", "image_01")
_TURN_NS = 100_000_000
_TIME = re.compile(r"([0-9]{4}-[0-9]{2}-[0-9]{2})[ T]([0-9]{2}:[0-9]{2}:[0-9]{2})(?:\.([0-9]{1,9}))?")
_PRIOR_SIGMA_M = 5.0
_NAMED = re.compile(r"[0-9]{4}_([0-9]{2})_[0-9]{2}_drive_.*")


def drive_name(sequence: str) -> str:
    """The name of a sequence's folders; its number alone is enough."""
    return f"2013_05_28_drive_{sequence}_sync" if re.fullmatch(r"[0-9]{4}", sequence) else sequence


def read_kitti360(
    root: Path, sequence: str, name: str, odometry: OdometrySource = "lidar", reporter: Reporter = SILENT
) -> DriveFiles:
    """Read a sequence; scans and images are opened later, on demand.

    Args:
        root: folder that holds ``calibration``, ``data_3d_raw`` and the others.
        sequence: its number with four digits, or the name of its folders.
        odometry: ``lidar`` registers the scans, ``poses`` is ``poses.txt``, by GNSS/INS and fitted to images and scans.
        reporter: is told which rows have no time or pose.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
    """
    drive = drive_name(sequence)
    folder = root / "data_3d_raw" / drive / "velodyne_points"
    files = frames(folder / "data", ".bin")
    if not files:
        raise DatasetError("holds no lidar scan; expected FRAME.bin", folder / "data")
    times = read_times(folder / "timestamps.txt")
    scans = _timed(files, times, folder / "timestamps.txt", reporter)
    scan_times = np.array([times[frame] for frame in scans], dtype=np.int64)
    lidar = ScanFiles("velodyne", tuple(scans.values()), scan_times, np.eye(4), decode, 120.0, 0.02, min_range_m=1.5)
    calibration = Calibration(root / "calibration")
    path = root / "data_poses" / drive / "poses.txt"
    track = None if odometry == "lidar" and not path.exists() else read_poses(path, times, calibration, reporter)
    month = _NAMED.fullmatch(drive)
    return DriveFiles(
        name=name,
        folder=root / "data_3d_raw" / drive,
        condition=dated(int(month[1]) if month else None, root),
        lidars=(lidar,),
        cameras=_cameras(root / "data_2d_raw" / drive, calibration, times, reporter),
        poses=track if odometry == "poses" else None,
        poses_from=f"data_poses/{drive}/poses.txt",
        prior=track,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )


def decode(data: bytes, path: Path) -> Returns:
    """The points of a scan, with times by their azimuths."""
    points = columns(data, "x y z reflectance", path)[:, :3].astype(np.float64)
    return Returns(points, swept(points, _TURN_NS, clockwise=True))


def frames(folder: Path, suffix: str) -> dict[int, Path]:
    """Files by frame number; a missing folder has none. Raises DatasetError if a file is empty or a dangling link."""
    found = numbered_files(folder, suffix)
    for path in found.values():
        check_file(path)
    return found


def read_times(path: Path) -> dict[int, int]:
    """Nanoseconds by frame from dates and times of day, one a line, taken for UTC; empty lines are lost frames.

    Raises:
        DatasetError: with file and line: a line is no date and time, or times do not increase.
    """
    rows = read_numbered_rows(path, "times of frames").filled
    times: dict[int, int] = {}
    for frame, row in rows.items():
        text = " ".join(row.fields)
        found = _TIME.fullmatch(text)
        try:
            if found is None:
                raise ValueError
            second = datetime.fromisoformat(f"{found[1]}T{found[2]}").replace(tzinfo=UTC).timestamp()
        except ValueError:
            raise DatasetError(f"{quoted(text)} is not a date and time of day", path, row.line) from None
        times[frame] = int(second) * 10**9 + int((found[3] or "0").ljust(9, "0"))
    texts, lines = [" ".join(row.fields) for row in rows.values()], [row.line for row in rows.values()]
    check_increasing(list(times.values()), texts, path, lines)
    return times


def _timed(files: dict[int, Path], times: dict[int, int], table: Path, reporter: Reporter) -> dict[int, Path]:
    """The files of the frames that have a time.

    Raises:
        DatasetError: there are frames beyond the last time, or none has one.
    """
    last = max(times, default=-1)
    if max(files) > last:
        raise DatasetError(f"holds {last + 1} times, but there is a frame {max(files)}", table)
    kept = with_times(files, times, short_name(table), reporter)
    if not kept:
        raise DatasetError("has no time of a frame", table)
    return kept


def _check_together(times: dict[int, int], scans: dict[int, int], table: Path) -> None:
    """Check that cameras and lidar have the same time at the same frame, which a row too few or too many shifts.

    Raises:
        DatasetError: they do not.
    """
    frames = np.array(sorted(times.keys() & scans.keys()))
    if len(frames) < 2:
        return
    apart = np.array([times[frame] - scans[frame] for frame in frames.tolist()])
    step = np.median(np.diff([scans[frame] for frame in frames.tolist()]) / np.diff(frames))
    off = np.flatnonzero(np.abs(apart) > step / 2)
    if off.size:
        frame, seconds = int(frames[off[0]]), float(apart[off[0]]) / 1e9
        message = f"the time of frame {frame} is {seconds:+.3f} s from that of its scan, as if rows were missing"
        raise DatasetError(f"{message}; expected one clock, and a row for each frame", table)


class Calibration:
    """``calibration``: the cameras and the GNSS/IMU relative to the lidar. Each file is read when it is needed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def T_velo_imu(self) -> Array:
        """(4, 4)"""
        return np.asarray(self._T_velo_cam0() @ invert(self._T_imu_cam("image_00")))

    def T_velo_rect(self, camera: str) -> Array:
        """(4, 4) of the rectified camera."""
        numbers = self._named(self.folder / "perspective.txt", f"R_rect_{camera[-2:]}", 9)
        R_rect_cam = np.array(numbers).reshape(3, 3)
        if not is_rotation(R_rect_cam, 1e-3):
            raise DatasetError(f"R_rect_{camera[-2:]} is not a rotation", self.folder / "perspective.txt")
        T_rect_cam = make_transform(project_to_rotation(R_rect_cam), np.zeros(3))
        return np.asarray(self.T_velo_imu() @ self._T_imu_cam(camera) @ invert(T_rect_cam))

    def intrinsics(self, camera: str) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy of the rectified camera."""
        P = self._named(self.folder / "perspective.txt", f"P_rect_{camera[-2:]}", 12)
        return P[0], P[5], P[2], P[6]

    def _T_velo_cam0(self) -> Array:
        path = self.folder / "calib_cam_to_velo.txt"
        rows = list(read_rows(path, "12 numbers, from camera 0 to the lidar", DatasetError))
        if len(rows) != 1:
            return read_transform(path, "the transform from camera 0 to the lidar")
        line, fields = rows[0]
        return parse_matrix(fields, path, line)

    def _T_imu_cam(self, camera: str) -> Array:
        path = self.folder / "calib_cam_to_pose.txt"
        return as_transform(np.array(self._named(path, camera, 12)).reshape(3, 4), path)

    def _named(self, path: Path, name: str, count: int) -> list[float]:
        """The numbers of the line ``NAME: numbers``."""
        for line, fields in read_rows(path, "a calibration", DatasetError):
            if fields[0] == f"{name}:":
                names = " ".join(f"m{k}" for k in range(count))
                return parse_floats(fields[1:], path, line, names, DatasetError)
        raise DatasetError(f"line '{name}:' is missing", path)


def read_poses(path: Path, times: dict[int, int], calibration: Calibration, reporter: Reporter = SILENT) -> Trajectory:
    """Poses of the lidar at frames.

    Raises:
        DatasetError: with file and line: a row is no frame and pose, or frames do not increase or have no times.
    """
    last = max(times, default=-1)

    def time_of(text: str, path: Path, line: int) -> int | None:
        frame = parse_count(text, "frame", path, line, DatasetError)
        if frame > last:
            raise DatasetError(f"frame {frame} has no time; there are {last + 1}", path, line)
        return times.get(frame)

    return rig_trajectory(read_matrix_rows(path, reporter, time_of), reporter, invert(calibration.T_velo_imu()))


def _cameras(
    folder: Path, calibration: Calibration, scans: dict[int, int], reporter: Reporter
) -> dict[str, CameraStream]:
    streams: dict[str, CameraStream] = {}
    for camera in CAMERAS:
        files = frames(folder / camera / "data_rect", ".png")
        if not files:
            continue
        table = folder / camera / "timestamps.txt"
        times = read_times(table)
        _check_together(times, scans, table)
        timed = _timed(files, times, table, reporter)
        found = tuple(timed.values()), np.array([times[frame] for frame in timed], dtype=np.int64)
        path = calibration.folder / "perspective.txt"
        pose = calibration.T_velo_rect(camera)
        streams[camera] = pinhole_files(camera, found, calibration.intrinsics(camera), pose, path)
    return streams
