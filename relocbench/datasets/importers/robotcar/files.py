"""Parsers for the text files of an Oxford RobotCar traversal and its calibration.

Times are microseconds in the files and nanoseconds here. Six numbers ``x y z roll pitch yaw`` are a transform with
``R = Rz(yaw) Ry(pitch) Rx(roll)``. The vehicle's axes are x forward, y right, z down.
Maddern et al., 1 Year, 1000 km: The Oxford RobotCar Dataset, IJRR 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.pairfile import missing
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.importers.lidar_drives.conditions import season_of
from relocbench.datasets.importers.lidar_drives.texts import read_named_columns, transform_from_xyzrpy
from relocbench.datasets.sensors.matrices import as_transform
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import PoseNumbers, Row, pose_table, short_name
from relocbench.datasets.sensors.times import check_increasing, times_in_ns
from relocbench.errors import DatasetError
from relocbench.files import load_yaml_value, parse_floats, read_rows
from relocbench.progress import SILENT, Reporter

US = 10**3
"""nanoseconds of the unit of times"""
POSE_COLUMNS = "x y z roll pitch yaw"
VO_COLUMNS = ("source_timestamp", "destination_timestamp", *POSE_COLUMNS.split())
INS_COLUMNS = ("timestamp", "ins_status", "northing", "easting", "down", "utm_zone", "roll", "pitch", "yaw")
_INS_NUMBERS = "northing easting down roll pitch yaw"
_GOOD_STATUS = ("INS_SOLUTION_GOOD", "INS_ALIGNMENT_COMPLETE")
_WEATHER = {"snow": "snow", "rain": "rain", "overcast": "overcast", "clouds": "cloudy", "sun": "sunny"}
"""tag -> weather; the first of these that is among a traversal's tags determines its weather"""
_TIMES_OF_DAY = ("night", "dusk")


def read_timestamps(path: Path) -> Times:
    """Times (N,) of a ``*.timestamps`` file, whose lines hold a time and a chunk number.

    Raises:
        DatasetError: with file and line: a field is not a time, or the times do not increase.
    """
    rows = list(read_rows(path, "timestamps (microseconds, chunk)", DatasetError))
    for line, fields in rows:
        if len(fields) > 2:
            raise DatasetError(f"expected a time in microseconds and a chunk, found {len(fields)} columns", path, line)
    texts, lines = [fields[0] for _, fields in rows], [line for line, _ in rows]
    ns = times_in_ns(texts, lambda i: (path, lines[i]), US).ns
    check_increasing(ns, texts, path, lines)
    return np.array(ns, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class OdometrySteps:
    """Visual odometry as in the file, in the vehicle's axes."""

    earlier_ns: Times
    """(N,) destination time of each row"""
    later_ns: Times
    """(N,) source time of each row, increasing; rows do not overlap"""
    T_earlier_later: Array
    """(N, 4, 4)"""


def read_visual_odometry(path: Path, reporter: Reporter = SILENT) -> OdometrySteps:
    """Read ``vo.csv``: each row is the vehicle's pose at the source time, in its frame at the destination time.

    The source is the *later* image; multiplying the rows from left to right gives the trajectory. A row that is not
    finite is no step: it is left out, and counted in a note.

    Raises:
        DatasetError: with file and line: a column is missing, a field is not a number, or rows are out of order.
    """
    found = list(read_named_columns(path, VO_COLUMNS, "visual odometry"))
    rows = [(line, row) for line, row in found if not missing(row)]
    if len(rows) < len(found):
        reporter.note(f"{short_name(path)}: {len(found) - len(rows)} of {len(found)} rows have no step (NaN)")
    both = [text for _, row in rows for text in row[:2]]
    ns = times_in_ns(both, lambda i: (path, rows[i // 2][0]), US).ns
    later, earlier = ns[::2], ns[1::2]
    values: list[list[float]] = []
    for index, (line, row) in enumerate(rows):
        if later[index] <= earlier[index]:
            raise DatasetError("source_timestamp is not later than destination_timestamp", path, line)
        if index and earlier[index] < later[index - 1]:
            raise DatasetError(f"the step from {row[1]} begins before the previous one ends", path, line)
        values.append(parse_floats(row[2:], path, line, POSE_COLUMNS, DatasetError))
    if not later:
        raise DatasetError("holds no step of visual odometry", path)
    return OdometrySteps(np.array(earlier, np.int64), np.array(later, np.int64), transform_from_xyzrpy(values))


@dataclass(frozen=True, eq=False)
class InertialTrack:
    """GNSS/INS as in the file: positions on the UTM grid, attitudes in north, east, down."""

    times_ns: Times
    """(N,) strictly increasing"""
    T_ned_ins: Array
    """(N, 4, 4) poses of the instrument (axes forward, right, down) in northing, easting and down"""
    zone: str
    """UTM zone"""
    left_out: int
    """number of solutions that the receiver itself did not mark as good"""
    breaks: tuple[int, ...] = ()
    """solutions before which nobody knows the way"""


def read_inertial(path: Path, reporter: Reporter = SILENT) -> InertialTrack:
    """Read the good solutions of ``ins.csv``.

    Raises:
        DatasetError: with file and line: a column is missing, a field is not a number, times go back, the UTM zone
            changes, or no solution is good.
    """
    rows: list[Row] = []
    zone = ""
    left_out = 0
    for line, row in read_named_columns(path, INS_COLUMNS, "GNSS/INS solutions"):
        if row[1] not in _GOOD_STATUS:
            left_out += 1
            continue
        if zone and row[5] != zone:
            raise DatasetError(f"utm_zone changes from {zone} to {row[5]}; expected a single zone", path, line)
        zone = row[5]
        rows.append(Row(line, [*row[2:5], *row[6:]], row[0]))
    numbers = PoseNumbers(_INS_NUMBERS, transform_from_xyzrpy)
    table = plausible(pose_table(rows, numbers, path, reporter, own_ns=US), reporter, jumps=False)
    if not len(table.times_ns):
        raise DatasetError(f"holds no good solution (ins_status {' or '.join(_GOOD_STATUS)})", path)
    return InertialTrack(table.times_ns, table.transforms, zone, left_out, table.breaks)


def read_extrinsics(path: Path) -> Array:
    """Read ``extrinsics/SENSOR.txt``, one line of six numbers, as a (4, 4) transform.

    A camera's extrinsics map from the vehicle to the camera, those of all other sensors from the sensor to the vehicle.
    """
    rows = list(read_rows(path, f"extrinsics ({POSE_COLUMNS})", DatasetError))
    if len(rows) != 1:
        raise DatasetError(f"expected one line ({POSE_COLUMNS}), found {len(rows)}", path)
    line, fields = rows[0]
    return transform_from_xyzrpy(parse_floats(fields, path, line, POSE_COLUMNS, DatasetError))


@dataclass(frozen=True, eq=False)
class LensModel:
    """``models/NAME.txt``: the pinhole camera to which the look-up table undistorts images."""

    path: Path
    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy"""
    T_camera_image: Array
    """(4, 4) from image axes (x right, y down, z forward) to camera axes (x forward, y right, z down)"""


def read_lens_model(path: Path) -> LensModel:
    """Read a camera model: ``fx fy cx cy``, then the 4x4 ``G_camera_image``. Raises DatasetError with file and line."""
    rows = list(read_rows(path, "a camera model (fx fy cx cy, then a 4x4 matrix)", DatasetError))
    if len(rows) != 5:
        raise DatasetError(f"expected 5 lines (fx fy cx cy, then a 4x4 matrix), found {len(rows)}", path)
    line, fields = rows[0]
    fx, fy, cx, cy = parse_floats(fields, path, line, "fx fy cx cy", DatasetError)
    matrix = np.array([parse_floats(f, path, n, "m0 m1 m2 m3", DatasetError) for n, f in rows[1:]])
    return LensModel(path, (fx, fy, cx, cy), as_transform(matrix, path))


def read_tags(path: Path) -> tuple[str, ...]:
    """Read ``tags/TRAVERSAL.yaml``, a list of words. Raises DatasetError naming the file."""
    found = load_yaml_value(path, "a list of tags", DatasetError)
    if found is None:
        return ()
    if not isinstance(found, list) or not all(isinstance(tag, str) for tag in found):
        raise DatasetError("expected a list of tags", path)
    return tuple(dict.fromkeys(found))


def condition_of(tags: Sequence[str], month: int | None = None) -> Condition:
    """Weather, time of day and season of a traversal from its tags; all other tags are kept as tags.

    Args:
        month: month of the drive, 1 to 12, for the season on the northern hemisphere; None if unknown.
    """
    weather = next((tag for tag in _WEATHER if tag in tags), None)
    time_of_day = next((tag for tag in _TIMES_OF_DAY if tag in tags), None)
    # There is no tag for daylight, but a drive with a weather tag and neither night nor dusk was by day.
    by_default = "day" if weather is not None else "unknown"
    return Condition(
        weather="unknown" if weather is None else _WEATHER[weather],
        season="unknown" if month is None else season_of(month),
        time_of_day=time_of_day or by_default,
        tags=tuple(tag for tag in tags if tag not in (weather, time_of_day)),
    )
