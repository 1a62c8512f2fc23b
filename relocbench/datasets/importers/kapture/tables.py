"""Read the tables of a kapture folder: comma-separated values, fields trimmed, lines that begin with ``#`` left out.

Format and conventions: "kapture: data format v1.1", Naver Labs Europe. A pose is a quaternion with ``qw`` first and a
translation, and maps world to device; one of a rig's table maps rig to sensor. Camera models are COLMAP's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.core.named_poses import POSE_NUMBERS, pose_of_numbers
from relocbench.datasets.core.pairfile import missing
from relocbench.datasets.importers.photos.cameras import camera_of
from relocbench.errors import DatasetError, quoted
from relocbench.files import lines_of, parse_count, parse_floats, read_text
from relocbench.geometry import Camera

VERSIONS = ("1.0", "1.1")
MOST_BYTES = 8 << 30
"""of a table; the observations of a city have about one gigabyte"""
CAMERAS, DEPTHS = ("camera",), ("camera", "depth")
"""types of the sensors that records of images and of depth maps may have"""
_LONGEST_PATH, _LONGEST_NAME = 1000, 255
"""bytes of the path of a record and of its parts; file systems allow little more"""
_VERSION = re.compile(r"#\s*kapture format\s*:\s*(\S+)\s*")

Moment = tuple[int, str]
"""timestamp and device"""


@dataclass(frozen=True, eq=False)
class Sensor:
    """A line of ``sensors.txt``."""

    kind: str
    line: int
    camera: Camera | None = None
    """of cameras and depth sensors with known intrinsics"""
    fault: str = ""
    """why there is no camera"""


@dataclass(frozen=True, eq=False)
class Mount:
    """A line of ``rigs.txt``: where a device is in a rig."""

    rig: str
    T_device_rig: Array | None
    """(4, 4); None where the line leaves it blank"""
    line: int


@dataclass(frozen=True)
class Record:
    """A line of ``records_camera.txt`` or ``records_depth.txt``."""

    timestamp: int
    device: str
    name: str
    """path of the file below ``sensors/records_data``"""
    line: int


def read_fields(path: Path, form: str, least: int, most: int | None) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each line that is neither blank nor a comment.

    Args:
        form: what a line holds, for messages.
        least: fields that a line has at least.
        most: fields that it has at most; None for any number.

    Raises:
        DatasetError: with file and line: another number of fields.
    """
    for number, line in enumerate(lines_of(read_text(path, f"lines {form}", DatasetError, MOST_BYTES)), start=1):
        content = line.strip()
        if content and not content.startswith("#"):
            fields = [field.strip() for field in content.split(",")]
            if len(fields) < least or (most is not None and len(fields) > most):
                raise DatasetError(f"expected {form}, found {len(fields)} fields", path, number)
            yield number, fields


def read_version(path: Path) -> str:
    """The version on the first line of ``sensors.txt``, which is that of the whole folder.

    Raises:
        DatasetError: there is no such line, or the version is none of :data:`VERSIONS`.
    """
    lines = lines_of(read_text(path, "kapture's sensors", DatasetError, MOST_BYTES))
    found = _VERSION.fullmatch(lines[0]) if lines else None
    if found is None:
        raise DatasetError(f"expected '# kapture format: {VERSIONS[-1]}' on the first line", path, 1)
    if found[1] not in VERSIONS:
        raise DatasetError(f"kapture format {quoted(found[1])} is unknown; expected {' or '.join(VERSIONS)}", path, 1)
    return found[1]


def read_sensors(path: Path) -> dict[str, Sensor]:
    """Sensors by identifier, from lines ``sensor_id, name, sensor_type, [sensor_params]+``.

    A camera whose model cannot be read is an error only once an image of it is asked for.

    Raises:
        DatasetError: with file and line.
    """
    found: dict[str, Sensor] = {}
    form = "sensor_id, name, sensor_type, [sensor_params]+"
    for line, (sensor, _, kind, *parameters) in read_fields(path, form, 3, None):
        if sensor in found:
            raise DatasetError(f"sensor {quoted(sensor)} occurs again", path, line)
        found[sensor] = Sensor(kind, line) if kind not in DEPTHS else _camera_sensor(kind, parameters, path, line)
    if not found:
        raise DatasetError(f"holds no sensor; expected lines {form}", path)
    return found


def read_rigs(path: Path, sensors: dict[str, Sensor]) -> dict[str, list[Mount]]:
    """Device -> the rigs it is mounted on, from lines ``rig_id, sensor_id, qw, qx, qy, qz, tx, ty, tz``.

    A rig may be mounted on another one. Empty if there is no such file.

    Raises:
        DatasetError: with file and line: a bad pose, a rig that is called like a sensor, what is mounted is neither a
            sensor nor a rig, or a rig is mounted on itself.
    """
    found: dict[str, list[Mount]] = {}
    if not path.exists():
        return found
    for line, (rig, device, *numbers) in read_fields(path, "rig_id, sensor_id, qw, qx, qy, qz, tx, ty, tz", 9, 9):
        if rig in sensors:
            raise DatasetError(f"rig {quoted(rig)} is called like a sensor; expected another identifier", path, line)
        mounts = found.setdefault(device, [])
        if any(mount.rig == rig for mount in mounts):
            raise DatasetError(f"{quoted(device)} is mounted on rig {quoted(rig)} for the second time", path, line)
        mounts.append(Mount(rig, _pose(numbers, path, line), line))
    rigs = {mount.rig for mounts in found.values() for mount in mounts}
    for device, mounts in found.items():
        if device not in sensors and device not in rigs:
            raise DatasetError(f"{quoted(device)} is neither in sensors.txt nor a rig", path, mounts[0].line)
        above, names = list(mounts), {mount.rig for mount in mounts}
        while above:
            mount = above.pop()
            if mount.rig == device:
                raise DatasetError(f"rig {quoted(device)} is mounted on itself", path, mounts[0].line)
            higher = [m for m in found.get(mount.rig, []) if m.rig not in names]
            names.update(m.rig for m in higher)
            above.extend(higher)
    return found


def read_trajectories(path: Path, devices: set[str]) -> dict[Moment, Array | None]:
    """``T_device_world`` (4, 4) by timestamp and device; None where rotation or translation are left blank.

    From lines ``timestamp, device_id, qw, qx, qy, qz, tx, ty, tz``.

    Raises:
        DatasetError: with file and line: a bad pose, a second one of a device at a time, or an unknown device.
    """
    found: dict[Moment, Array | None] = {}
    for line, (time, device, *numbers) in read_fields(path, "timestamp, device_id, qw, qx, qy, qz, tx, ty, tz", 9, 9):
        moment = parse_count(time, "timestamp", path, line, DatasetError), device
        if device not in devices:
            raise DatasetError(f"{quoted(device)} is neither in sensors.txt nor a rig", path, line)
        if moment in found:
            raise DatasetError(f"a second pose of {quoted(device)} at {moment[0]}", path, line)
        found[moment] = _pose(numbers, path, line)
    return found


def read_records(path: Path, sensors: dict[str, Sensor], kinds: tuple[str, ...]) -> list[Record]:
    """Records by timestamp and sensor, from lines ``timestamp, device_id, path``.

    Args:
        kinds: types that the sensors may have.

    Raises:
        DatasetError: with file and line: a sensor that is unknown or of another type, a second record of it at a
            time, or a path that occurs again.
    """
    found: dict[Moment, Record] = {}
    names: set[str] = set()
    for line, (time, device, name) in read_fields(path, "timestamp, device_id, path", 3, 3):
        moment = parse_count(time, "timestamp", path, line, DatasetError), device
        if device not in sensors:
            raise DatasetError(f"sensor {quoted(device)} is not in sensors.txt", path, line)
        if sensors[device].kind not in kinds:
            kind = quoted(sensors[device].kind)
            raise DatasetError(f"sensor {quoted(device)} is of type {kind}, expected {' or '.join(kinds)}", path, line)
        if moment in found:
            raise DatasetError(f"a second record of {quoted(device)} at {moment[0]}", path, line)
        if not name or name in names:
            raise DatasetError(f"{quoted(name)} occurs again" if name else "expected a path, found none", path, line)
        if len(name.encode()) > _LONGEST_PATH or any(len(part.encode()) > _LONGEST_NAME for part in name.split("/")):
            message = f"{quoted(name)} is longer than a path; expected at most {_LONGEST_PATH} bytes"
            raise DatasetError(f"{message}, {_LONGEST_NAME} between slashes", path, line)
        names.add(name)
        found[moment] = Record(*moment, name, line)
    return [found[moment] for moment in sorted(found)]


def read_points(path: Path) -> Array:
    """Points (P, 3) from lines ``X, Y, Z, [R, G, B]``. Raises DatasetError with file and line."""
    points = []
    for line, fields in read_fields(path, "X, Y, Z, [R, G, B]", 3, 6):
        points.append(parse_floats(fields[:3], path, line, "X Y Z", DatasetError))
    return np.array(points, dtype=np.float64).reshape(-1, 3)


def read_observations(path: Path, version: str, points: int) -> dict[str, Indices]:
    """The points (K,), increasing, that each image observes, by the image's name.

    Lines are ``point3d_id, keypoints_type, [image_path, feature_id]*``, without the type in version 1.0. Observations
    of the same point by keypoints of several types count once.

    Raises:
        DatasetError: with file and line: a line of another form, or a point that is not there.
    """
    before = 1 if version == "1.0" else 2
    form = f"point3d_id, {'' if before == 1 else 'keypoints_type, '}[image_path, feature_id]*"
    found: dict[str, list[int]] = {}
    for line, fields in read_fields(path, form, before, None):
        point = parse_count(fields[0], "point3d_id", path, line, DatasetError)
        if (len(fields) - before) % 2:
            raise DatasetError(f"expected {form}, found {len(fields)} fields", path, line)
        if point >= points:
            raise DatasetError(f"point {point} is not there; points3d.txt has {points}", path, line)
        for name in fields[before::2]:
            found.setdefault(name, []).append(point)
    return {name: np.unique(np.array(seen, dtype=np.int64)) for name, seen in found.items()}


def _camera_sensor(kind: str, parameters: list[str], path: Path, line: int) -> Sensor:
    model, *texts = parameters or [""]
    if len(texts) < 2:
        raise DatasetError(f"expected the {kind}'s model, width, height and parameters", path, line)
    numbers = parse_floats(texts, path, line, " ".join(["parameter"] * len(texts)), DatasetError)
    if model == "UNKNOWN_CAMERA":
        return Sensor(
            kind, line, fault="the camera is an UNKNOWN_CAMERA, without intrinsics; expected a calibrated one"
        )
    width, height = numbers[:2]
    if not width.is_integer() or not height.is_integer():
        raise DatasetError(f"the size is {texts[0]} x {texts[1]}, expected whole numbers of pixels", path, line)
    try:
        return Sensor(kind, line, camera_of(model, int(width), int(height), numbers[2:]))
    except ValueError as bad:
        return Sensor(kind, line, fault=str(bad))


def _pose(texts: list[str], path: Path, line: int) -> Array | None:
    """The pose (4, 4) of seven fields; None if one is blank or not finite."""
    if missing(texts):
        return None
    try:
        return pose_of_numbers(parse_floats(texts, path, line, POSE_NUMBERS, DatasetError))
    except ValueError as bad:
        raise DatasetError(str(bad), path, line) from None
