"""A folder of clouds as one cloud: its scans are put together by given poses, or by odometry from the scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.groundtruth.clouds.cloud import Cloud, SensorChoice, cloud_of_file
from relocbench.datasets.groundtruth.odometry.lidar_odometry import lidar_odometry
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale, scale_of, scene_size
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.datasets.sensors.cloud_files import SUFFIXES, CloudFile, CloudFormat, read_cloud
from relocbench.datasets.sensors.cloud_poses import read_cloud_poses
from relocbench.datasets.sensors.recording import Scan
from relocbench.errors import DatasetError, quoted
from relocbench.files import natural
from relocbench.geometry import apply
from relocbench.progress import Reporter

_PERIOD_NS = 100_000_000
_SAME_GRID_M = 10_000.0
"""two clouds with large coordinates no further apart than this are given relative to one origin"""
_MOST_SCANS = 2000
_KEPT_M = 0.05
"""voxels, enlarged, in which one point of each scan is kept"""


@dataclass(frozen=True)
class Reading:
    """How clouds are read."""

    form: CloudFormat = field(default_factory=CloudFormat)
    sensor: SensorChoice = "auto"
    files: str = ""
    """pattern of the names of a folder's clouds; empty: all of known formats"""


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a registration, as it was read."""

    cloud: Cloud
    notes: tuple[str, ...]


def read_side(path: Path, poses: Path | None, reading: Reading, reporter: Reporter) -> Side:
    """The cloud of a file, or of all files of a folder.

    Args:
        poses: of the folder's clouds; None: by odometry, in the frame of the first one.

    Raises:
        DatasetError: with the file: something is missing, damaged, or there are too few points or clouds.
        ConfigError: a format needs a package that is not installed.
    """
    if not path.exists():
        raise DatasetError("missing; expected a point cloud or a folder of them", path)
    if not path.is_dir():
        if poses is not None:
            raise DatasetError("is one cloud; poses are for a folder of clouds", path)
        with reporter.stage(f"reading {path.name}", 1) as advance:
            file = read_cloud(path, reading.form)
            advance(1)
        return Side(cloud_of_file(file, reading.sensor), (f"{len(file.points)} points", *file.notes))
    files = cloud_files(path, reading.files)
    if len(files) == 1 and poses is None:
        return read_side(files[0], None, reading, reporter)
    lost = ""
    if poses is not None:
        listed = read_cloud_poses(poses, len(files))
        if without := sum(pose is None for pose in listed):
            lost = f"; {without} of {len(files)} clouds have no pose and are left out"
        files = [file for file, pose in zip(files, listed, strict=True) if pose is not None]
        T = np.array([pose for pose in listed if pose is not None])
        if not files:
            raise DatasetError("holds no pose of a cloud", poses)
    clouds = read_clouds(files, reading, reporter)
    if poses is not None:
        origin = f"{len(files)} clouds, put together by {poses.name}{lost}"
    else:
        scale = scale_of([scene_size(clouds[0].cloud.points)])
        T = _odometry(path.name, [side.cloud.points for side in clouds], scale, reporter)
        origin = f"{len(files)} clouds, put together by odometry in the frame of {files[0].name}"
    notes = list(dict.fromkeys(note for side in clouds for note in side.notes[1:]))
    return Side(replace(merged([s.cloud for s in clouds], T, path.name), drifts=poses is None), (origin, *notes))


def cloud_files(folder: Path, pattern: str = "") -> list[Path]:
    """The clouds of a folder, or else of its folders, in the natural order of their names.

    Raises:
        DatasetError: there is none.
    """

    def matching(glob: str) -> list[Path]:
        return [p for p in folder.glob(glob) if p.is_file() and not p.name.startswith(".")]

    if pattern:
        try:
            files = matching(pattern)
        except (ValueError, NotImplementedError) as bad:
            raise DatasetError(f"{quoted(pattern)} is not a pattern of file names ({bad})", folder) from None
    else:
        files = [p for p in matching("*") if p.suffix.lower() in SUFFIXES and not _is_text(p)]
        files = files or [p for p in matching("*/*") if p.suffix.lower() in SUFFIXES and not _is_text(p)]
        files = files or [p for p in matching("*") if p.suffix.lower() in SUFFIXES]
    if not files:
        what = f"matches {quoted(pattern)}" if pattern else f"is a point cloud ({' '.join(SUFFIXES)})"
        raise DatasetError(f"no file {what}", folder)
    if len(files) > _MOST_SCANS:
        raise DatasetError(
            f"holds {len(files)} clouds, more than {_MOST_SCANS}; give a short stretch, or --files", folder
        )
    return sorted(files, key=lambda p: natural(str(p.relative_to(folder))))


def _is_text(path: Path) -> bool:
    """Whether a file may as well be a list of poses or times as a cloud."""
    return path.suffix.lower() in (".txt", ".csv")


def read_clouds(files: Sequence[Path], reading: Reading, reporter: Reporter) -> list[Side]:
    """Read the clouds of a folder; those with large coordinates are relative to the origin of the first."""
    out: list[Side] = []
    origin = None
    with reporter.stage("reading clouds", len(files)) as advance:
        for path in files:
            file: CloudFile = read_cloud(path, reading.form, origin)
            if out == [] and file.origin.any():
                origin = file.origin
            out.append(Side(cloud_of_file(file, reading.sensor), (f"{len(file.points)} points", *file.notes)))
            advance(1)
    return out


def with_one_origin(a: Cloud, b: Cloud) -> Cloud:
    """B relative to the origin of A, if both have large coordinates and lie in one region."""
    if a.origin is None or b.origin is None or float(np.linalg.norm(a.origin - b.origin)) > _SAME_GRID_M:
        return b
    moved = b.origin - a.origin
    sensors = None if b.sensors is None else b.sensors + moved
    return replace(b, points=b.points + moved, sensors=sensors, origin=a.origin)


def merged(clouds: Sequence[Cloud], T_world_cloud: Array, name: str) -> Cloud:
    """Clouds put together by their poses (K, 4, 4), in the frame of these."""
    points, sensors, normals = [], [], []
    factor = scale_of([scene_size(clouds[0].points)]).factor
    for cloud, T in zip(clouds, T_world_cloud, strict=True):
        keep = first_in_voxels(cloud.points, _KEPT_M / factor)
        points.append(apply(T, cloud.points[keep]))
        if cloud.sensors is not None:
            sensors.append(apply(T, cloud.sensors[keep]))
        if cloud.normals is not None:
            normals.append(cloud.normals[keep] @ T[:3, :3].T)
    return Cloud(
        name,
        np.concatenate(points),
        np.concatenate(sensors) if len(sensors) == len(clouds) else None,
        any(cloud.supposed for cloud in clouds),
        np.concatenate(normals) if len(normals) == len(clouds) else None,
    )


@dataclass(frozen=True, eq=False)
class _Scans:
    """The enlarged clouds of a folder as the scans of a lidar, which are a tenth of a second apart."""

    name: str
    clouds: Sequence[Array]
    factor: float
    pattern: Literal["push-broom", "spinning"] = "spinning"
    max_range_m: float = 100.0
    sigma_m: float = 0.03

    @property
    def T_rig_lidar(self) -> Array:
        return np.eye(4)

    @property
    def times_ns(self) -> Times:
        return np.arange(len(self.clouds), dtype=np.int64) * _PERIOD_NS

    def read(self, index: int) -> Scan:
        points = self.clouds[index] * self.factor
        points = points[np.linalg.norm(points, axis=1) <= self.max_range_m]
        return Scan(points, np.full(len(points), self.times_ns[index], dtype=np.int64))


def _odometry(name: str, clouds: Sequence[Array], scale: SceneScale, reporter: Reporter) -> Array:
    """Poses (K, 4, 4) of the clouds in the frame of the first."""
    odometry = lidar_odometry(_Scans(name, clouds, scale.factor), reporter)
    if len(odometry.times_ns) != len(clouds):
        raise DatasetError(f"{name}: {len(clouds) - len(odometry.times_ns)} clouds have too few points for odometry")
    return scale.reduced(odometry.T_odom_rig)
