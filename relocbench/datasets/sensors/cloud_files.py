"""Point clouds of any format as points in metres, with an origin near them.

Coordinates of a map's grid are in the millions. Single precision holds those to decimetres only, and a rotation by a
thousandth of a degree about an origin that far away moves them by metres. Such clouds are therefore given relative to
an origin near them, which is stated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.core.npy import parse_npy
from relocbench.datasets.sensors.binary_layout import Number, decode_points, detect_layout
from relocbench.datasets.sensors.cloud_formats.e57 import read_e57
from relocbench.datasets.sensors.cloud_formats.las import read_las
from relocbench.datasets.sensors.cloud_formats.point_clouds import read_point_cloud, with_axes
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.datasets.sensors.cloud_formats.text_points import read_text_points
from relocbench.datasets.sensors.plausible_points import check_degrees, note_of_steps
from relocbench.errors import DatasetError
from relocbench.files import plain_file, read_bytes
from relocbench.geometry import apply

SUFFIXES = (".pcd", ".ply", ".las", ".laz", ".e57", ".bin", ".npy", ".xyz", ".txt", ".asc", ".pts", ".csv")
MOST_BYTES = 2**31
MOST_POINTS = 100_000_000
_FAR_M = 2000.0
"""coordinates further away from 0 are given relative to an origin near them"""
_WHOLE_M = 100.0
"""such an origin is a multiple of this"""


@dataclass(frozen=True)
class CloudFormat:
    """What is known of files that do not describe themselves; None is detected."""

    number: Number | None = None
    """type of the numbers of ``.bin`` files"""
    columns: int | None = None
    """number of columns of ``.bin`` files"""
    setups: tuple[int, ...] = ()
    """numbers of the setups of an E57 file; none: all"""


@dataclass(frozen=True, eq=False)
class CloudFile:
    """The finite points of a file."""

    path: Path
    points: Array
    """(N, 3) metres, relative to ``origin``"""
    origin: Array
    """(3,) metres in the file's coordinates; 0 unless they are large"""
    sensors: Array | None
    """(N, 3) position of the sensor that measured each point, if the file states it"""
    normals: Array | None
    """(N, 3) normals of the file, if it has any"""
    notes: tuple[str, ...]
    """what was detected or assumed"""


def read_cloud(path: Path, form: CloudFormat | None = None, origin: Array | None = None) -> CloudFile:
    """Read a point cloud.

    Args:
        origin: the origin to use; None: chosen by the coordinates.

    Raises:
        DatasetError: the file is missing, damaged, of an unknown format, or holds no finite point.
        ConfigError: the format needs a package that is not installed.
    """
    form = form or CloudFormat()
    notes: list[str] = []
    points, normals, T_parts = _read(path, form, notes)
    finite = np.isfinite(points).all(axis=1)
    # Beams without a return are zeros in many formats; a measured point is never exactly at the sensor.
    finite &= points.any(axis=1)
    if not finite.any():
        many = f"all of its {len(points)} points are zero or not finite" if len(points) else "holds 0 points"
        raise DatasetError(many, path)
    left_out = len(points) - int(np.count_nonzero(finite))
    if left_out:
        notes.append(f"{left_out} of {len(points)} points are zero or not finite and left out")
    points = points[finite]
    sensors = None
    if T_parts is not None:
        placed, sensors = np.empty_like(points), np.empty_like(points)
        part = np.concatenate([np.full(count, k) for k, (_, count) in enumerate(T_parts)])[finite]
        for k, (T, _) in enumerate(T_parts):
            rows = part == k
            placed[rows], sensors[rows] = apply(T, points[rows]), T[:3, 3]
        points = placed
    if path.suffix.lower() not in (".las", ".laz"):  # which may state their unit, and have no floats
        check_degrees(points, path)
        notes += filter(None, [note_of_steps(points)])
    if origin is None:
        middle = np.median(points, axis=0)
        far = float(np.abs(middle).max()) > _FAR_M
        origin = np.round(middle / _WHOLE_M) * _WHOLE_M if far else np.zeros(3)
    if origin.any():
        at = ", ".join(f"{value:.0f}" for value in origin)
        notes.append(f"coordinates are large: ({at}) m is subtracted, and poses are relative to it")
        points = points - origin
        sensors = None if sensors is None else sensors - origin
    return CloudFile(path, points, origin, sensors, None if normals is None else normals[finite], tuple(notes))


def read_fields(path: Path, notes: list[str]) -> dict[str, NDArray[Any]]:
    """The fields of a scan in a format that describes itself, among them ``x``, ``y`` and ``z``: name -> (N,).

    Points of an E57 file are those of its only setup, in the scanner's frame.

    Args:
        notes: what was assumed or converted is added.

    Raises:
        DatasetError: as :func:`read_cloud`, or an E57 file holds several setups.
        ConfigError: the format needs a package that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix in (".ply", ".pcd"):
        return read_point_cloud(path)
    if suffix not in (".las", ".laz", ".e57"):
        return dict(read_text_points(path, MOST_SCAN_BYTES))
    points, _, parts = _read(path, CloudFormat(), notes)
    if parts is not None and len(parts) != 1:
        raise DatasetError(f"holds {len(parts)} setups; expected one scan", path)
    return {axis: points[:, k] for k, axis in enumerate("xyz")}


Parts = list[tuple[Array, int]]
"""(``T_file_part``, number of points) of each setup"""


def _read(path: Path, form: CloudFormat, notes: list[str]) -> tuple[Array, Array | None, Parts | None]:
    """Points (N, 3), their normals if the file has any, and the setups' poses if it has any."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise DatasetError(f"is not a point cloud by its name; expected one of {' '.join(SUFFIXES)}", path)
    if suffix in (".las", ".laz"):
        _check_readable(path)
        return read_las(path, MOST_POINTS, notes), None, None
    if suffix == ".e57":
        return _setups(path, form, notes)
    if suffix == ".bin":
        data = read_bytes(path, "a point cloud", DatasetError, MOST_BYTES)
        layout = detect_layout(data, path, form.number, form.columns)
        if form.number is None or form.columns is None:
            notes.append(f"{layout} by their values")
        return decode_points(data, layout, path)[:, :3].astype(np.float64), None, None
    if suffix == ".npy":
        return _array(path), None, None
    if suffix in (".ply", ".pcd"):
        fields = read_point_cloud(path, MOST_BYTES)
        names = next((n for n in (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")) if fields.keys() >= set(n)),
                     None)  # fmt: skip
        return _stacked(fields, "xyz"), None if names is None else _stacked(fields, names), None
    return _stacked(read_text_points(path, MOST_BYTES), "xyz"), None, None


def _check_readable(path: Path) -> None:
    """Raise DatasetError, in the words of other formats, if a file that a library will open cannot be read."""
    plain_file(path, "a point cloud", DatasetError)
    if path.is_dir():
        raise DatasetError("is a folder; expected a point cloud", path)
    try:
        with path.open("rb") as stream:
            stream.read(1)
    except FileNotFoundError:
        raise DatasetError("missing; expected a point cloud", path) from None
    except OSError as bad:
        raise DatasetError(f"cannot be read ({bad.strerror}); expected a point cloud", path) from None


def _setups(path: Path, form: CloudFormat, notes: list[str]) -> tuple[Array, None, Parts]:
    _check_readable(path)
    setups, count = read_e57(path, form.setups, MOST_POINTS)
    if not setups:
        raise DatasetError("holds no setup of a scanner", path)
    if len(setups) > 1 and not all(setup.posed for setup in setups):
        raise DatasetError(f"holds {count} setups, not all of which have a pose; select one of them", path)
    notes.append(f"{len(setups)} of {count} setups" + (", merged by their poses" if len(setups) > 1 else ""))
    return np.concatenate([s.points for s in setups]), None, [(s.T_file_setup, len(s.points)) for s in setups]


def _array(path: Path) -> Array:
    values = parse_npy(read_bytes(path, "a point cloud", DatasetError, MOST_BYTES), path)
    if values.dtype.names:
        return _stacked(with_axes({name: np.ravel(values[name]) for name in values.dtype.names}, path), "xyz")
    if values.ndim != 2 or not 3 <= values.shape[1] <= 64:
        raise DatasetError(f"is an array of shape {values.shape}, expected (points, 3 or more columns)", path)
    return values[:, :3].astype(np.float64)


def _stacked(fields: Mapping[str, NDArray[Any]], names: Sequence[str]) -> Array:
    return np.column_stack([np.asarray(fields[name], dtype=np.float64) for name in names])
