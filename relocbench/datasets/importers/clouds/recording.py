"""A folder of point clouds with times, read as a recording: one spinning lidar, which is the rig.

Clouds are files of any kind in :data:`SUFFIXES`, in the folder itself or in one folder within it. The formats are
described in ``docs/lidar-datasets.md``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.scan_motion import ScanMotion, detected_motion
from relocbench.datasets.importers.clouds.detection import with_layout
from relocbench.datasets.importers.clouds.times import TIME_FILES, Timed, clouds_with_times
from relocbench.datasets.importers.generic.dataset import CAMERA_FILE, read_folder
from relocbench.datasets.importers.generic.scans import GenericLidar, GenericLidarStream
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import check_file
from relocbench.datasets.sensors.cloud_files import SUFFIXES
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.numbered_rows import read_numbered_rows
from relocbench.datasets.sensors.pose_tables import MATRIX, pose_table, read_trajectory
from relocbench.datasets.sensors.recording import CameraStream, Scan, Trajectory
from relocbench.datasets.sensors.scan_files import swept
from relocbench.errors import DatasetError
from relocbench.progress import Reporter

OdometrySource = Literal["auto", "poses", "lidar"]

POSE_FILES = ("poses.txt", "poses.csv", "poses.tum")
_TEXTS = (".txt", ".csv")
_TURN_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class SweptClouds(DerivedLidar):
    """Clouds of a spinning lidar that have no times of points: these follow from the azimuths."""

    def read(self, index: int) -> Scan:
        """Read a cloud. The lidar turns clockwise seen from above and points along x at the cloud's time."""
        scan = self.stream.read(index)
        return Scan(scan.points, scan.times_ns + swept(scan.points, _TURN_NS, clockwise=True))


def read_clouds(
    folder: Path,
    name: str,
    reporter: Reporter,
    *,
    odometry: OdometrySource = "auto",
    motion: ScanMotion | Literal["auto"] = "compensated",
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    pattern: Literal["spinning", "push-broom"] = "spinning",
    max_range: float = 100.0,
) -> DriveFiles:
    """Read a folder; clouds are opened later, on demand, except for the one that is looked at.

    Args:
        reporter: is told what was found.
        odometry: ``poses`` is a file of poses, ``lidar`` registers the clouds, ``auto`` uses poses if there are some.
        motion: whether clouds without times of points are motion-compensated, or those of a lidar that turns; ``auto``
            tells it from a few of them.
        columns: columns of .bin and plain .npy files; default: found.
        rate_hz: clouds a second, if they have no times.

    Raises:
        DatasetError: with file and line: there are no clouds or no times, or something in them is damaged.
    """
    files = _cloud_files(folder)
    listed, times_from = clouds_with_times(files, folder, rate_hz)
    timed = [(time, path) for time, path in listed if time is not None]
    times = np.array([time for time, _ in timed], dtype=np.int64)
    scans = tuple(path for _, path in timed)
    if len(timed) < len(listed):
        reporter.note(f"{name}: {len(listed) - len(timed)} of {len(listed)} clouds have no time and are left out")
    if not timed:
        raise DatasetError("none of its clouds has a time", folder)
    least = min(0.5, max_range / 2)
    given = GenericLidar(pattern=pattern, max_range=max_range, min_range=least, columns=tuple(columns))
    settings, words = _look(scans, times, given)
    clouds = GenericLidarStream("lidar", settings, np.eye(4), scans, times)
    poses = next((folder / p for p in POSE_FILES if (folder / p).is_file()), None)
    if poses is None and odometry == "poses":
        raise DatasetError(f"holds no poses; expected {' or '.join(POSE_FILES)}", folder)
    reporter.note(f"{name}: {len(timed)} clouds, times from {times_from}")
    reporter.note(f"{name}: points are {words}{_assumed(settings.time, motion, pattern)}")
    turning = settings.time is None and motion != "compensated" and pattern == "spinning"
    if turning and motion == "auto":
        turning = detected_motion(name, clouds, SweptClouds(clouds), reporter) == "distorted"
    use = poses if odometry != "lidar" else None
    condition, cameras = _described(folder, name) if (folder / CAMERA_FILE).exists() else (dated(None, folder), {})
    return DriveFiles(
        name=name,
        folder=folder,
        condition=condition,
        lidars=(SweptClouds(clouds) if turning else clouds,),
        poses=None if use is None else _trajectory(use, listed, reporter),
        poses_from="" if use is None else use.name,
        cameras=cameras,
    )


def _look(files: Sequence[Path], times: Times, given: GenericLidar) -> tuple[GenericLidar, str]:
    """What the clouds hold, by the first of a few along the drive that has enough points."""
    *places, last = len(files) // 2, len(files) // 4, 3 * len(files) // 4, 0
    for place in places:
        try:
            return with_layout(given, files[place], int(times[place]))
        except DatasetError:
            continue  # such as a cloud taken beside a wall that returned nothing
    return with_layout(given, files[last], int(times[last]))


def _assumed(time: str | None, motion: str, pattern: str) -> str:
    if time is not None or (motion == "auto" and pattern == "spinning"):
        return ""
    if motion == "distorted" and pattern == "spinning":
        return "; taken from a lidar that turns ten times a second and points along x at a cloud's time (--motion)"
    return f"; taken to be motion-compensated, from a {pattern} lidar (--motion distorted if they are not)"


def _cloud_files(folder: Path) -> list[Path]:
    """The clouds of the folder, or of the one folder in it that has most of them; all of one kind.

    Files of text are clouds only where there are no others, since they may as well describe them.

    Raises:
        DatasetError: there are none, or several kinds.
    """
    places = [folder, *sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))]
    named = [[p for p in sorted(place.iterdir()) if _may_be_cloud(p)] for place in places]
    found = next(filter(None, ([p for p in files if p.suffix.lower() not in _TEXTS] for files in named)), None)
    files = found or max(named, key=len)
    if not files:
        raise DatasetError(
            f"holds no point clouds; expected files {', '.join(SUFFIXES)} in it or in a folder in it", folder
        )
    kinds = Counter(p.suffix.lower() for p in files)
    if len(kinds) > 1:
        counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        raise DatasetError(f"holds clouds of several kinds ({counts}); expected one", files[0].parent)
    for path in files:
        check_file(path)
    return files


def _may_be_cloud(path: Path) -> bool:
    other = path.name in (*TIME_FILES, *POSE_FILES) or path.name.startswith(".")
    return path.suffix.lower() in SUFFIXES and not other


def _trajectory(path: Path, clouds: Timed, reporter: Reporter) -> Trajectory:
    """Poses of the lidar: ``t x y z qx qy qz qw`` a line, or twelve numbers for each cloud."""
    rows = read_numbered_rows(path, "poses (t x y z qx qy qz qw, or 12 numbers for each cloud)")
    if not rows.filled:
        raise DatasetError("holds no pose", path)
    if any(len(row.fields) != 12 for row in rows.filled.values()):
        return rig_trajectory(read_trajectory(path, reporter=reporter), reporter)
    filled = rows.filled
    numbers = rows.of_files([cloud for _, cloud in clouds])
    both = [
        (time, filled[number])
        for number, (time, _) in zip(numbers, clouds, strict=True)
        if time is not None and number in filled
    ]
    posed, times = [row for _, row in both], [time for time, _ in both]
    return rig_trajectory(pose_table(posed, MATRIX, path, reporter, times=times), reporter)


def _described(folder: Path, name: str) -> tuple[Condition, dict[str, CameraStream]]:
    """Condition and cameras by ``camera.yaml`` of the generic folder, whose rig is the lidar."""
    files = read_folder(folder, name, need_poses=False)
    return files.condition, files.streams(np.eye(4))
