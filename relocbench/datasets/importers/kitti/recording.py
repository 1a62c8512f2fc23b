"""A sequence in the layout of KITTI odometry, read as a recording: velodyne, rectified cameras, odometry.

The rig is the lidar: x forward, y left, z up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.groundtruth.odometry.scan_motion import ScanMotion, detected_motion
from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, chosen_of
from relocbench.datasets.sensors.image_files import ImageFiles
from relocbench.datasets.sensors.point_times import PointTimes
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, Scan, Trajectory
from relocbench.datasets.sensors.trajectories import with_times
from relocbench.datasets.sensors.velodyne import LIDAR_SIGMA, read_scan
from relocbench.errors import DatasetError
from relocbench.geometry import invert
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["lidar", "poses"]

CAMERAS = ("image_0", "image_1", "image_2", "image_3")
REAL_ELEVATION_DEG = 0.205
"""by how much the beams of the real KITTI lidar point too low (Deschaud, IMLS-SLAM, ICRA 2018; as in KISS-ICP)"""
_TURN_NS = 100_000_000
_MAX_RANGE_M = 120.0


@dataclass(frozen=True, eq=False)
class VelodyneStream:
    """The scans of the velodyne, whose frame is the rig's."""

    files: tuple[Path, ...]
    times_ns: Times
    motion: ScanMotion
    elevation_deg: float
    name: str = "velodyne"
    pattern: Literal["spinning"] = "spinning"
    max_range_m: float = _MAX_RANGE_M
    sigma_m: float = LIDAR_SIGMA

    @property
    def T_rig_lidar(self) -> Array:
        return np.eye(4)

    def read(self, index: int) -> Scan:
        """Read a scan.

        If scans are not motion-compensated, a point's time follows from its azimuth: seen from above the lidar turns
        clockwise, ten times a second, and faces forward at the scan's time.

        Raises:
            DatasetError: the file is missing or truncated.
        """
        points = read_scan(self.files[index])
        times_of = PointTimes(turn_ns=_TURN_NS if self.motion == "distorted" else 0)
        times = times_of.at(None, points, int(self.times_ns[index]))
        return Scan(raised(points, self.elevation_deg) if self.elevation_deg else points, times)


def raised(points: Array, elevation_deg: float) -> Array:
    """Points (N, 3) turned up by an angle, each within the vertical plane of its beam."""
    level = np.hypot(points[:, 0], points[:, 1])
    c, s = np.cos(np.radians(elevation_deg)), np.sin(np.radians(elevation_deg))
    scale = c - s * points[:, 2] / np.maximum(level, 1e-9)
    return np.column_stack([points[:, 0] * scale, points[:, 1] * scale, c * points[:, 2] + s * level])


def read_kitti(
    root: Path,
    sequence: str,
    *,
    name: str | None = None,
    odometry: OdometrySource = "lidar",
    cameras: Sequence[str] | None = None,
    motion: ScanMotion | Literal["auto"] = "compensated",
    elevation_deg: float = 0.0,
    rate_hz: float = 10.0,
    reporter: Reporter = SILENT,
    from_lidar: FromLidar = lidar_odometry,
) -> FieldRecording:
    """Read a sequence as a recording; scans and images are opened later, on demand.

    Args:
        root: folder that holds ``sequences`` and ``poses``.
        odometry: ``lidar`` registers successive scans; ``poses`` reads ``poses/NN.txt``, which for the real data is
            smoothed GNSS/INS and locally wrong by up to a quarter of a step.
        cameras: cameras to read; default: those whose folders hold images.
        motion: ``compensated`` if the scans are motion-compensated, as KITTI's own are, or ``distorted``; ``auto``
            tells it from the scans.
        elevation_deg: angle by which to turn the beams up; the real lidar needs :data:`REAL_ELEVATION_DEG`.
        rate_hz: frames per second if ``times.txt`` is missing.
        from_lidar: computes odometry from scans; called after everything else has been checked.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
        ConfigError: KITTI has no such camera.
    """
    files = KittiSequence(root, sequence)
    scans = files.frames("velodyne", ".bin")
    if not scans:
        raise DatasetError("holds no lidar scan; expected velodyne/NNNNNN.bin", files.folder)
    found = _image_files(files, cameras)
    frames = 1 + max(max(numbers) for numbers in (scans, *found.values()))
    track: Trajectory | None = None
    if odometry == "poses":
        times, poses, breaks = files.times_and_poses(rate_hz, frames, reporter)
        track = _motion(files, poses, breaks, times)
    else:
        _, times = files.times(rate_hz, frames, reporter)
    missing = 1 + max(scans) - min(scans) - len(scans)
    if missing:
        reporter.note(f"{files.traversal}: {missing} scans between the first and the last are missing")
    scans = with_times(scans, times, files.traversal, reporter)
    found = {name: with_times(numbers, times, f"{files.traversal}/{name}", reporter) for name, numbers in found.items()}
    if not scans:
        raise DatasetError("has no time of a scan", files.folder / "times.txt")
    streams = {camera: _camera(files, camera, numbers, times) for camera, numbers in found.items() if numbers}
    lidar = VelodyneStream(tuple(scans.values()), _at(scans, times), "compensated", elevation_deg)
    if motion == "auto":
        motion = detected_motion(files.traversal, lidar, replace(lidar, motion="distorted"), reporter)
    lidar = replace(lidar, motion=motion)
    drive = DriveFiles(
        name=name or files.traversal,
        folder=files.folder,
        condition=Condition(),
        lidars=(lidar,),
        poses=track,
        poses_from=f"poses/{sequence}.txt",
        cameras=streams,
    )
    return drive.recording(from_lidar, reporter)


def _image_files(files: KittiSequence, cameras: Sequence[str] | None) -> dict[str, dict[int, Path]]:
    """Image files by camera and frame number."""
    found: dict[str, dict[int, Path]] = {}
    for name in chosen_of(cameras, CAMERAS, CAMERAS, "KITTI has no camera"):
        numbers = files.image_frames(name)
        if numbers:
            found[name] = numbers
        elif cameras is not None:
            raise DatasetError("holds no image; expected NNNNNN.png", files.folder / name)
    return found


def _at(frames: Iterable[int], times: dict[int, int]) -> Times:
    return np.array([times[frame] for frame in frames], dtype=np.int64)


def _motion(
    files: KittiSequence, poses: dict[int, Array], breaks: tuple[int, ...], times: dict[int, int]
) -> Trajectory:
    """The motion of the lidar by ``poses/NN.txt``, whose poses are those of camera 0."""
    if len(poses) < 2:
        raise DatasetError(f"holds {len(poses)} poses; odometry needs at least 2", files.poses_file)
    T_world_cam0 = np.array(list(poses.values()))
    return Trajectory(_at(poses, times), T_world_cam0 @ files.calibration.T_cam0_lidar(), breaks=breaks)


def _camera(files: KittiSequence, name: str, numbers: dict[int, Path], times: dict[int, int]) -> CameraStream:
    camera = files.camera(name, next(iter(numbers.values())))
    T_rig_cam = invert(files.calibration.T_cam0_lidar()) @ files.calibration.T_cam0_cam(name)
    size_from = f"the first image of {name}"
    return ImageFiles(name, camera, T_rig_cam, tuple(numbers.values()), _at(numbers, times), size_from)
