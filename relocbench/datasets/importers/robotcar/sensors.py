"""Scans and images of an Oxford RobotCar traversal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Floats, Image, Times
from relocbench.datasets.core.image_header import MOST_PIXELS
from relocbench.datasets.importers.robotcar.files import US, read_timestamps
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.datasets.sensors.image_files import BayerImages, remapped
from relocbench.datasets.sensors.recording import Scan
from relocbench.datasets.sensors.trajectories import timed_files
from relocbench.errors import DatasetError
from relocbench.files import read_bytes
from relocbench.progress import Reporter

_POINT_BYTES = 24
_BEAMS = 541
_BEAM_STEP = np.radians(0.5)
_TURN_NS = 20_000_000
"""the mirror of an LMS-151 turns 50 times a second; the 541 beams over 270 degrees take 15 ms of a turn"""
_NEAREST_M = 0.1
"""nearer points are beams without a return, (0, 0, 0); the scanner measures from 0.5 m on"""


@dataclass(frozen=True, eq=False)
class LmsStream:
    """A SICK LMS-151: one file a scan, float64 x, y, reflectance; 541 beams over 270 degrees at 50 Hz."""

    name: str
    files: tuple[Path, ...]
    T_rig_lidar: Array
    times_ns: Times
    pattern: Literal["push-broom"] = "push-broom"
    max_range_m: float = 50.0
    sigma_m: float = 0.012
    """data sheet"""

    def read(self, index: int) -> Scan:
        """Read a scan. Each point has the time of its own beam; the middle beam has the scan's time.

        The mirror turns counter-clockwise seen from the scanner's +z. In a complete scan a point's index gives the time
        of its beam; if beams are missing in the file, its azimuth does, the middle beam pointing along x.

        Raises:
            DatasetError: the file is missing, is not a whole number of points, or holds a value that is not finite.
        """
        path = self.files[index]
        data = read_bytes(path, "a lidar scan", DatasetError, MOST_SCAN_BYTES)
        check_scan_size(path, len(data))
        values = np.frombuffer(data, dtype="<f8").reshape(-1, 3)
        if not np.isfinite(values).all():
            raise DatasetError("holds a value that is not finite; expected x, y, reflectance", path)
        if len(values) == _BEAMS:
            angle = (np.arange(_BEAMS) - _BEAMS // 2) * _BEAM_STEP
        else:
            angle = np.arctan2(values[:, 1], values[:, 0])
        times = self.times_ns[index] + np.rint(angle / (2 * np.pi) * _TURN_NS).astype(np.int64)
        returned = np.hypot(values[:, 0], values[:, 1]) >= _NEAREST_M
        points = np.column_stack([values[:, :2], np.zeros(len(values))])
        return Scan(points[returned], times[returned])


def check_scan_size(path: Path, size: int) -> None:
    """Raise DatasetError if a scan's file cannot have this size."""
    if size == 0:
        raise DatasetError("is empty; expected a lidar scan (float64 x, y, reflectance)", path)
    if size % _POINT_BYTES:
        raise DatasetError(f"{size} bytes are not a whole number of points (float64 x, y, reflectance)", path)


@dataclass(frozen=True, eq=False)
class RobotCarCamera(BayerImages):
    """The images of one lens, demosaicked and undistorted when read."""

    look_up_table: Path | None = None
    """table of the undistortion; None if images are not undistorted"""

    def read(self, index: int) -> Image:
        """Read an image, (H, W, 3) RGB, black outside the lens's view. Raises DatasetError with the file."""
        image = super().read(index)
        return image if self.look_up_table is None else remapped(image, self.look_up_table, read_look_up_table)


@lru_cache(maxsize=8)
def read_look_up_table(path: Path, width: int, height: int) -> tuple[Floats, Floats]:
    """u and v (H, W) in the recorded image of each pixel of the undistorted one.

    The file holds all u, then all v, float64, row by row.

    Raises:
        DatasetError: the file is missing, belongs to another image size, or holds a value that is not finite.
    """
    data = read_bytes(path, "a look-up table", DatasetError, 16 * MOST_PIXELS)
    if len(data) != 16 * width * height:
        raise DatasetError(f"{len(data)} bytes are not a look-up table for images of {width}x{height}", path)
    table = np.frombuffer(data, dtype="<f8").astype(np.float32)
    if not np.isfinite(table).all():
        raise DatasetError("the look-up table holds a value that is not finite", path)
    u, v = table.reshape(2, height, width)
    return u, v


def present_files(
    folder: Path,
    timestamps: Path,
    suffix: str,
    what: str,
    reporter: Reporter,
    check: Callable[[Path, int], None] | None = None,
) -> dict[int, Path]:
    """Files by time, in time order, that ``timestamps`` lists and that exist; the others are counted in a note.

    A few files are missing in the data set itself, many if only some of its chunks were downloaded. Files that are not
    listed are left out. Without the list, times are taken from the files' names.

    Args:
        check: if given, raises DatasetError if a file cannot have its size; called with the file and the size in bytes.

    Raises:
        DatasetError: the list is out of order, a file's name is not a time, or a scan is truncated.
    """
    found = timed_files(folder, (suffix,), US, reporter=reporter)
    for path in found.values():
        if suffix == ".bin" and not path.exists():
            raise DatasetError("is a link to a file that does not exist; expected a scan", path)
        if check is not None:
            check(path, path.stat().st_size)
    if not timestamps.exists():
        if found:
            reporter.note(f"{timestamps} is missing; the times of {what} are taken from the file names")
        return found
    listed = read_timestamps(timestamps).tolist()
    present = {time: found[time] for time in listed if time in found}
    if len(present) < len(listed):
        reporter.note(f"{len(listed) - len(present)} of {len(listed)} {what} that {timestamps.name} lists are missing")
    if len(present) < len(found):
        reporter.note(f"{len(found) - len(present)} {what} that {timestamps.name} does not list are left out")
    return present
