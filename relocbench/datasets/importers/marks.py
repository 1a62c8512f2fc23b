"""What is at the top of a recording of each kind, by which a folder above or below it is recognised."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from relocbench.errors import DatasetError
from relocbench.files import did_you_mean

MARKS: dict[str, tuple[str, ...]] = {
    "kitti": ("sequences",),
    "kitti-lidar": ("sequences",),
    "tum-rgbd": ("rgb.txt",),
    "robotcar": ("vo", "gps", "lms_front", "lms_rear", "velodyne_left", "velodyne_right", "stereo"),
    "boreas": ("applanix", "lidar", "calib"),
    "mulran": ("Ouster", "sensor_data", "global_pose.csv"),
    "helipr": ("LiDAR", "LiDAR_GT"),
    "nclt": ("velodyne_sync", "lb3"),
    "kitti-360": ("data_3d_raw", "calibration"),
    "complex-urban": ("sensor_data", "global_pose.csv"),
    "generic": ("camera.yaml",),
    "colmap": (
        *("cameras.bin", "cameras.txt"),
        *("sparse", "dense/sparse", "dense/0/sparse", "0/cameras.bin", "0/cameras.txt", "reconstruction/cameras.txt"),
    ),
    "kapture": ("sensors/sensors.txt", "mapping/sensors/sensors.txt"),
}
"""kind -> files and folders of which a recording has at least one"""


def check_recordings(kind: str, sources: Sequence[Path]) -> None:
    """Say that a source is missing, or what it looks like if it is no recording of the kind.

    This is told before an importer, and what it computes with, is loaded. What else is wrong with a source, its
    importer tells.

    Raises:
        DatasetError: there is no such source; or with the folder within it that is a recording, or the kind that it is
            one of.
    """
    for source in sources:
        if not source.exists():
            raise DatasetError(f"no such file or folder; expected a recording for build-dataset {kind}", source)
        if not source.is_dir() or _has_one(kind, source):
            continue
        suggestion = did_you_mean(source, lambda folder: _has_one(kind, folder))
        like = " or ".join(other for other in MARKS if _has_one(other, source))
        if not suggestion and like:
            suggestion = f"; it looks like one of build-dataset {like}"
        if suggestion:
            raise DatasetError(f"holds no {' or '.join(MARKS[kind][:2])} of a {kind} recording{suggestion}", source)


def _has_one(kind: str, folder: Path) -> bool:
    """Whether a folder may be a recording of the kind."""
    marks = MARKS.get(kind)
    return marks is None or any((folder / mark).exists() for mark in marks)
