"""A generic folder with lidar, read as a recording. Its files are described in ``docs/recording-formats.md``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.importers.generic.dataset import CAMERA_FILE, POSE_FILE, read_folder
from relocbench.datasets.importers.generic.scans import LIDAR_FILE, T_NEW_RIG, read_lidar_file, read_lidars
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, rig_trajectory
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.recording import MAX_GAP_NS, FieldRecording, Trajectory
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import DatasetError
from relocbench.geometry import invert
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["auto", "poses", "lidar"]

PRIOR_FILE = "prior.txt"


def read_generic(
    folder: Path,
    *,
    name: str | None = None,
    odometry: OdometrySource = "auto",
    max_gap_s: float | None = None,
    reporter: Reporter = SILENT,
    from_lidar: FromLidar = lidar_odometry,
) -> FieldRecording:
    """Read a generic folder with ``lidar.yaml`` as a recording; scans and images are opened later, on demand.

    Args:
        name: name of the recording; default: that of the folder.
        odometry: ``poses`` reads ``poses.txt``, ``lidar`` registers the scans of the first spinning lidar, ``auto``
            uses ``poses.txt`` if it exists.
        max_gap_s: longest gap between two poses to interpolate over, hole or not; None: one second, and no hole.
        from_lidar: computes odometry from scans.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged, or there is no spinning lidar to
            compute odometry from.
    """
    title = name or traversal_names([folder])[0]
    header = read_lidar_file(folder)
    T_new_rig = T_NEW_RIG[header.rig_axes]
    described, max_gap_ns = (folder / CAMERA_FILE).exists(), round(max_gap_s * 1e9) if max_gap_s else None
    files = read_folder(folder, title, need_poses=False) if described else None
    by_poses = odometry == "poses" or (odometry == "auto" and (folder / POSE_FILE).exists())
    lidars = read_lidars(folder, T_new_rig, reporter)
    if not by_poses and all(lidar.pattern != "spinning" for lidar in lidars):
        raise DatasetError(
            f"has neither {POSE_FILE} nor a spinning lidar in {LIDAR_FILE} to compute odometry from", folder
        )
    prior = folder / PRIOR_FILE
    drive = DriveFiles(
        name=title,
        folder=folder,
        condition=files.condition if files else Condition(),
        lidars=lidars,
        poses=_trajectory(folder / POSE_FILE, T_new_rig, max_gap_ns, reporter) if by_poses else None,
        poses_from=POSE_FILE,
        cameras=files.streams(T_new_rig) if files else {},
        prior=_trajectory(prior, T_new_rig, max_gap_ns, reporter) if prior.exists() else None,
        location=files.location if files else "",
        max_gap_ns=max_gap_ns or MAX_GAP_NS,
    )
    return drive.recording(from_lidar, reporter)


def _trajectory(path: Path, T_new_rig: Array, max_gap_ns: int | None, reporter: Reporter) -> Trajectory:
    return rig_trajectory(read_trajectory(path, reporter=reporter), reporter, invert(T_new_rig), max_gap_ns)
