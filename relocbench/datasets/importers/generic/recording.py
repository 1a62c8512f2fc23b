"""A generic folder with lidar, read as a recording. Its files are described in ``docs/recording-formats.md``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.importers.generic.dataset import (
    CAMERA_FILE,
    POSE_FILE,
    CameraFolder,
    read_folder,
)
from relocbench.datasets.importers.generic.scans import LIDAR_FILE, T_NEW_RIG, read_lidar_file, read_lidars
from relocbench.datasets.sensors.image_files import ImageFiles
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, LidarStream, Trajectory
from relocbench.datasets.sensors.trajectories import read_trajectory, traversal_names
from relocbench.errors import DatasetError
from relocbench.geometry import invert
from relocbench.progress import Reporter, Silent

OdometrySource = Literal["auto", "poses", "lidar"]

PRIOR_FILE = "prior.txt"


def read_generic(
    folder: Path,
    *,
    name: str | None = None,
    odometry: OdometrySource = "auto",
    max_gap_s: float = 1.0,
    reporter: Reporter | None = None,
    from_lidar: FromLidar = lidar_odometry,
) -> FieldRecording:
    """Read a generic folder with ``lidar.yaml`` as a recording; scans and images are opened later, on demand.

    Args:
        name: name of the recording; default: that of the folder.
        odometry: ``poses`` reads ``poses.txt``, ``lidar`` registers the scans of the first spinning lidar, ``auto``
            uses ``poses.txt`` if it exists.
        max_gap_s: longest gap between two poses to interpolate over.
        from_lidar: computes odometry from scans.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged, or there is no spinning lidar to
            compute odometry from.
    """
    report = reporter or Silent()
    title = name or traversal_names([folder])[0]
    header = read_lidar_file(folder)
    T_new_rig = T_NEW_RIG[header.rig_axes]
    lidars = read_lidars(folder, T_new_rig, report)
    max_gap_ns = round(max_gap_s * 1e9)
    cameras: dict[str, CameraStream] = {}
    condition, location = Condition(), ""
    if (folder / CAMERA_FILE).exists():
        files = read_folder(folder, title, need_poses=False)
        condition, location = files.condition, files.location
        cameras = {camera: _camera(camera, entry, T_new_rig) for camera, entry in files.cameras.items()}
    if odometry == "poses" or (odometry == "auto" and (folder / POSE_FILE).exists()):
        motion = _trajectory(folder / POSE_FILE, T_new_rig, max_gap_ns)
        motion = Trajectory(motion.times_ns, invert(motion.T_odom_rig[0]) @ motion.T_odom_rig, max_gap_ns)
        source = ""
    else:
        spinning = _spinning(lidars, folder)
        motion, source = from_lidar(spinning, report, max_gap_ns=max_gap_ns), spinning.name
    prior = folder / PRIOR_FILE
    return FieldRecording(
        name=title,
        folder=folder,
        condition=condition,
        odometry=motion,
        lidars=lidars,
        cameras=cameras,
        prior=_trajectory(prior, T_new_rig, max_gap_ns) if prior.exists() else None,
        location=location,
        odometry_lidar=source,
    )


def _camera(name: str, entry: CameraFolder, T_new_rig: Array) -> ImageFiles:
    times = np.array(list(entry.images), dtype=np.int64)
    T_rig_cam = T_new_rig @ entry.camera.T_rig_cam.matrix
    return ImageFiles(name, entry.camera.camera, T_rig_cam, tuple(entry.images.values()), times, CAMERA_FILE)


def _trajectory(path: Path, T_new_rig: Array, max_gap_ns: int) -> Trajectory:
    poses = read_trajectory(path)
    if len(poses) < 2:
        raise DatasetError(f"holds {len(poses)} poses; a trajectory has at least 2", path)
    T_world_rig = np.array(list(poses.values())) @ invert(T_new_rig)
    return Trajectory(np.array(list(poses), dtype=np.int64), T_world_rig, max_gap_ns)


def _spinning(lidars: tuple[LidarStream, ...], folder: Path) -> LidarStream:
    for lidar in lidars:
        if lidar.pattern == "spinning":
            return lidar
    raise DatasetError(f"has neither {POSE_FILE} nor a spinning lidar in {LIDAR_FILE} to compute odometry from", folder)
