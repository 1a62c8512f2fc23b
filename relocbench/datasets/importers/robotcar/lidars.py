"""The lidars of an Oxford RobotCar traversal: two push-broom scanners, and two Velodynes on the radar dataset's car."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.lidar_drives.drives import chosen_of
from relocbench.datasets.importers.robotcar.sensors import LmsStream, check_scan_size, present_files
from relocbench.datasets.importers.robotcar.track import T_RIG_VEHICLE
from relocbench.datasets.importers.robotcar.velodyne import (
    MAX_RANGE_M,
    NEAREST_M,
    SIGMA_M,
    VELODYNES,
    decode_binary,
    decode_raw,
)
from relocbench.datasets.sensors.recording import LidarStream
from relocbench.datasets.sensors.scan_files import ScanFiles
from relocbench.errors import DatasetError
from relocbench.progress import Reporter

__all__ = ["LIDARS", "VELODYNES", "read_lidars"]

LIDARS = ("lms_front", "lms_rear", *VELODYNES)


def read_lidars(
    folder: Path, extrinsics_of: Callable[[str], Array], asked: Sequence[str] | None, title: str, reporter: Reporter
) -> tuple[LidarStream, ...]:
    """The lidars of a traversal.

    Args:
        extrinsics_of: (4, 4) from a sensor to the vehicle.
        asked: lidars to read; default: those whose folders exist.

    Raises:
        DatasetError: there are no scans, or their times or sizes are wrong.
        ConfigError: RobotCar has no such lidar.
    """
    streams: list[LidarStream] = []
    for name in chosen_of(asked, LIDARS, LIDARS, "RobotCar has no lidar"):
        if not (folder / name).is_dir():
            if asked is not None:
                raise DatasetError("no such folder; expected lidar scans", folder / name)
            continue
        what = f"scans of {title}/{name}"
        table, T_rig_lidar = folder / f"{name}.timestamps", T_RIG_VEHICLE @ extrinsics_of(name)
        if name in VELODYNES:
            streams.extend(_velodyne(name, folder / name, table, T_rig_lidar, reporter))
            continue
        scans = present_files(folder / name, table, ".bin", what, reporter, check_scan_size)
        if scans:
            times = np.array(list(scans), dtype=np.int64)
            streams.append(LmsStream(name, tuple(scans.values()), T_rig_lidar, times))
    if not streams:
        raise DatasetError(f"holds no lidar scan; expected {' or '.join(f'{n}/TIME.bin' for n in LIDARS)}", folder)
    return tuple(streams)


def _velodyne(name: str, folder: Path, timestamps: Path, T_rig_lidar: Array, reporter: Reporter) -> list[LidarStream]:
    """The scans of a Velodyne, raw ones if there are some, since these have the times of firings."""
    raw = any(folder.glob("*.png"))
    suffix, decode = (".png", decode_raw) if raw else (".bin", decode_binary)
    scans = present_files(folder, timestamps, suffix, f"scans of {folder.parent.name}/{name}", reporter)
    if not scans:
        return []
    times = np.array(list(scans), dtype=np.int64)
    return [
        ScanFiles(name, tuple(scans.values()), times, T_rig_lidar, decode, MAX_RANGE_M, SIGMA_M, min_range_m=NEAREST_M)
    ]
