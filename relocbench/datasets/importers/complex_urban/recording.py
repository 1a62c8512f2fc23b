"""A drive of the Complex Urban dataset (KAIST), read as a recording.

Layout and conventions: Jeong et al., Complex Urban Dataset with Multi-level Sensors from Highly Diverse Urban
Environments, IJRR 2019, the dataset's page on its format, and its file player.

- ``sensor_data/VLP_{left,right}/TIME.bin``, TIME in nanoseconds at the *end* of a turn: float32 ``x y z R`` in the
  order of firing. Both VLP-16 turn ten times a second, clockwise around their z axes, and are tilted.
- ``sensor_data/SICK_{back,middle}/TIME.bin``: float32 ``r R``, beams from -5 to 185 degrees every 0.666 degrees.
- ``calibration/Vehicle2NAME.txt``: lines ``R:`` and ``T:``, which map from the sensor to the vehicle, contrary to the
  name; that of the stereo camera is the left one's, not rectified.
- ``image/stereo_{left,right}/TIME.png``: 8-bit Bayer mosaics (RGGB), not rectified; ``calibration/{left,right}.yaml``.
- ``global_pose.csv``: TIME and the upper three rows of ``T_utm_vehicle``; the vehicle has x forward, y left, z up.

The rig is the vehicle. Encoders, FOG, IMU, GPS and the omnidirectional camera are not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.complex_urban.images import T_left_right, read_intrinsics
from relocbench.datasets.importers.lidar_drives.conditions import dated
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles, chosen_of, rig_trajectory
from relocbench.datasets.importers.lidar_drives.files import files_by_time
from relocbench.datasets.sensors.image_files import BayerImages
from relocbench.datasets.sensors.matrices import as_transform
from relocbench.datasets.sensors.pose_tables import read_matrix_rows
from relocbench.datasets.sensors.recording import CameraStream
from relocbench.datasets.sensors.scan_files import Returns, ScanFiles, columns
from relocbench.errors import DatasetError
from relocbench.files import parse_floats, read_rows
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["lidar", "poses"]

LIDARS = {
    "VLP_left": "Vehicle2LeftVLP",
    "VLP_right": "Vehicle2RightVLP",
    "SICK_back": "Vehicle2BackSick",
    "SICK_middle": "Vehicle2MiddleSick",
}
"""lidar -> its calibration file"""
_DEFAULT = ("VLP_left", "VLP_right")
_TURN_NS = 100_000_000
_SICK_TURN_NS = 10_000_000
_SICK_FIRST_DEG, _SICK_STEP_DEG = -5.0, 0.666
_PRIOR_SIGMA_M = 5.0


def read_complex_urban(
    folder: Path,
    name: str,
    lidars: Sequence[str] = (),
    odometry: OdometrySource = "lidar",
    reporter: Reporter = SILENT,
) -> DriveFiles:
    """Read a drive; scans and images are opened later, on demand.

    Args:
        lidars: those to use; default: both VLP-16, or of them what there is.
        odometry: ``lidar`` registers the scans of the first VLP-16, ``poses`` is ``global_pose.csv``, the result of the
            dataset's own SLAM.
        reporter: is told which rows have no pose.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
        ConfigError: there is no such lidar.
    """
    streams = []
    for lidar in chosen_of(lidars or None, tuple(LIDARS), _DEFAULT, "Complex Urban has no lidar"):
        where = folder / "sensor_data" / lidar
        scans = files_by_time(where, (".bin",), reporter=reporter)
        if not scans[0]:
            if lidars:
                raise DatasetError("holds no lidar scan; expected TIME.bin in nanoseconds", where)
            continue
        pose = read_calibration(folder / "calibration" / f"{LIDARS[lidar]}.txt")
        if lidar.startswith("VLP"):
            streams.append(ScanFiles(lidar, *scans, pose, decode_vlp, 100.0, 0.03, min_range_m=1.0))
        else:
            streams.append(ScanFiles(lidar, *scans, pose, decode_sick, 80.0, 0.03, 0.5, "push-broom"))
    if not streams:
        raise DatasetError(f"holds no scan of {' or '.join(_DEFAULT)}; expected TIME.bin", folder / "sensor_data")
    path = folder / "global_pose.csv"
    needless = odometry == "lidar" and not path.exists()
    track = None if needless else rig_trajectory(read_matrix_rows(path, reporter), reporter)
    return DriveFiles(
        name=name,
        folder=folder,
        condition=dated(None, folder),
        lidars=tuple(streams),
        cameras=_cameras(folder),
        poses=track if odometry == "poses" else None,
        poses_from=path.name,
        prior=track,
        prior_sigma_m=_PRIOR_SIGMA_M,
    )


def decode_vlp(data: bytes, path: Path) -> Returns:
    """The points of a VLP-16; their times follow from azimuths and from their order, up to the end of the turn."""
    points = columns(data, "x y z R", path)[:, :3].astype(np.float64)
    azimuth = np.nan_to_num(np.arctan2(points[:, 1], points[:, 0]))
    turned = np.mod(azimuth[:1] - azimuth, 2 * np.pi) / (2 * np.pi)
    # Beams of one firing differ in azimuth: some of the first lie behind the first one, some of the last past it.
    order = np.arange(len(points)) / max(len(points), 1)
    turned = turned - ((turned > 0.75) & (order < 0.25)) + ((turned < 0.25) & (order > 0.75))
    return Returns(points, np.rint((turned - 1.0) * _TURN_NS).astype(np.int64))


def decode_sick(data: bytes, path: Path) -> Returns:
    """The points of an LMS-511, whose middle beam has the scan's time; a range of 0 is a beam without a return."""
    ranges = columns(data, "r R", path)[:, 0].astype(np.float64)
    angle = np.radians(_SICK_FIRST_DEG + _SICK_STEP_DEG * np.arange(len(ranges)))
    points = np.column_stack([ranges * np.cos(angle), ranges * np.sin(angle), np.zeros(len(ranges))])
    return Returns(points, np.rint((angle - np.pi / 2) / (2 * np.pi) * _SICK_TURN_NS).astype(np.int64))


def read_calibration(path: Path) -> Array:
    """``T_vehicle_sensor`` (4, 4) of the lines ``R: 9 numbers`` and ``T: 3 numbers``; other lines are skipped.

    Raises:
        DatasetError: with file and line: a line is missing or wrong.
    """
    found: dict[str, list[float]] = {}
    for line, (label, *fields) in read_rows(path, "the pose of a sensor (R: and T:)", DatasetError):
        if label in ("R:", "T:"):
            names = " ".join(f"{label[0].lower()}{k}" for k in range(9 if label == "R:" else 3))
            found[label] = parse_floats(fields, path, line, names, DatasetError)
    for label in ("R:", "T:"):
        if label not in found:
            raise DatasetError(f"line '{label}' is missing", path)
    return as_transform(np.column_stack([np.array(found["R:"]).reshape(3, 3), found["T:"]]), path)


def _cameras(folder: Path) -> dict[str, CameraStream]:
    """The stereo cameras that have images."""
    names = ("stereo_left", "stereo_right")
    found = {name: files_by_time(folder / "image" / name, (".png",)) for name in names}
    if not any(files for files, _ in found.values()):
        return {}
    calibration = folder / "calibration"
    T_rig_left = read_calibration(calibration / "Vehicle2Stereo.txt")
    left = read_intrinsics(calibration / "left.yaml")
    streams: dict[str, CameraStream] = {}
    if found["stereo_left"][0]:
        files = found["stereo_left"]
        streams["stereo_left"] = BayerImages("stereo_left", left.camera, T_rig_left, *files, "left.yaml")
    if found["stereo_right"][0]:
        right = read_intrinsics(calibration / "right.yaml")
        pose, files = T_rig_left @ T_left_right(left, right), found["stereo_right"]
        streams["stereo_right"] = BayerImages("stereo_right", right.camera, pose, *files, "right.yaml")
    return streams
