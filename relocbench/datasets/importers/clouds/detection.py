"""What the clouds of a folder hold, found by looking at one of them: columns and type of .bin, times of points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core.npy import parse_npy
from relocbench.datasets.sensors.point_clouds import read_point_cloud
from relocbench.datasets.sensors.point_table import MOST_SCAN_BYTES
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

TimeUnit = Literal["s", "ms", "us", "ns"]
TimeFrom = Literal["scan", "epoch"]

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "timestamps", "offset_time", "time_offset", "time_offset_ns")
_USUAL: dict[int, tuple[str, ...]] = {
    4: ("x", "y", "z", "intensity"),
    3: ("x", "y", "z"),
    5: ("x", "y", "z", "intensity", "ring"),
    6: ("x", "y", "z", "intensity", "ring", "time"),
}
"""columns of .bin files that are tried, the usual ones first"""
_CLEARLY = 0.8
"""a less usual reading is believed if its points are so much nearer to each other"""
_UNITS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_SHORTEST_S, _LONGEST_S = 0.004, 0.6
"""a scan takes so long"""
_FARTHEST_M = 500.0
_FEWEST = 20


@dataclass(frozen=True)
class Found:
    """What was found, in the terms of ``lidar.yaml``."""

    columns: tuple[str, ...]
    dtype: Literal["float32", "float64"]
    time: str | None
    time_unit: TimeUnit
    time_from: TimeFrom
    words: str
    """what was found, for people"""


def look_at(path: Path, time_ns: int, columns: tuple[str, ...] = ()) -> Found:
    """What a cloud holds.

    Args:
        time_ns: its time.
        columns: the columns of .bin and plain .npy files, if they are known.

    Raises:
        DatasetError: the file is damaged, or its columns or the unit of its times cannot be told.
    """
    suffix = path.suffix.lower()
    dtype: Literal["float32", "float64"] = "float32"
    if suffix == ".bin":
        data = read_bytes(path, "a point cloud", DatasetError, MOST_SCAN_BYTES)
        names, dtype = _binary(data, path, columns)
        fields = dict(zip(names, _table(data, dtype, len(names)).T, strict=True))
        words = f"{dtype} {' '.join(names)}"
    elif suffix == ".npy":
        values = parse_npy(read_bytes(path, "a point cloud", DatasetError, MOST_SCAN_BYTES), path)
        if values.dtype.names:
            fields = {name: np.ravel(values[name]) for name in values.dtype.names}
            names = columns or ("x", "y", "z", "intensity")
        else:
            names = columns or _usual(values.shape[-1] if values.ndim == 2 else 0, path)
            if values.ndim != 2 or values.shape[1] != len(names):
                raise DatasetError(f"is an array of shape {values.shape}, expected columns {' '.join(names)}", path)
            fields = dict(zip(names, values.T, strict=True))
        words = f"{suffix[1:]} with {' '.join(fields)}"
    else:
        fields, names = read_point_cloud(path), columns or ("x", "y", "z", "intensity")
        words = f"{suffix[1:]} with {' '.join(fields)}"
    return _with_times(fields, names, dtype, words, time_ns, path)


def _usual(count: int, path: Path) -> tuple[str, ...]:
    names = _USUAL.get(count)
    if names is None:
        raise DatasetError(f"has {count} columns, whose meaning is not known; give them with --columns", path)
    return names


def _table(data: bytes, dtype: str, count: int) -> NDArray[Any]:
    return np.frombuffer(data, dtype=np.dtype(dtype).newbyteorder("<")).reshape(-1, count)


def _binary(data: bytes, path: Path, columns: tuple[str, ...]) -> tuple[tuple[str, ...], Literal["float32", "float64"]]:
    """Columns and type of a .bin file: those under which successive points are nearest to each other.

    A lidar writes points in the order of its beams, whose neighbours mostly meet the same surface; read with a wrong
    number of columns or a wrong type, coordinates change places from point to point.
    """
    kinds: tuple[Literal["float32", "float64"], ...] = ("float32", "float64")
    candidates = [(kind, columns) for kind in kinds] if columns else [(k, n) for k in kinds for n in _USUAL.values()]
    best: tuple[float, tuple[str, ...], Literal["float32", "float64"]] | None = None
    for kind, names in candidates:
        size = np.dtype(kind).itemsize * len(names)
        if len(data) % size or len(data) < _FEWEST * size:
            continue
        jump = _roughness(_table(data, kind, len(names))[:, [names.index(axis) for axis in "xyz"]])
        if jump is not None and (best is None or jump < _CLEARLY * best[0]):
            best = jump, names, kind
    if best is None:
        what = " ".join(columns) or "x y z and up to three more columns"
        raise DatasetError(f"{len(data)} bytes are no points of float32 or float64 ({what}); see --columns", path)
    return best[1], best[2]


def _roughness(points: NDArray[Any]) -> float | None:
    """Median distance of successive points relative to their range; None if these cannot be points of a lidar."""
    with np.errstate(all="ignore"):
        p = points.astype(np.float64)
        known = np.isfinite(p).all(axis=1)
        reach = np.sqrt(np.sum(p**2, axis=1))
        if known.mean() < 0.2 or np.mean(reach[known] > _FARTHEST_M) > 0.02:
            return None
        returned = p[known & (reach > 0.1)]
        if len(returned) < _FEWEST or np.ptp(returned, axis=0).min() < 1e-3:
            return None
        apart = np.linalg.norm(np.diff(returned, axis=0), axis=1)
        return float(np.median(apart / np.linalg.norm(returned[1:], axis=1)))


def _with_times(
    fields: Mapping[str, NDArray[Any]], names: tuple[str, ...], dtype: Any, words: str, time_ns: int, path: Path
) -> Found:
    name = next((known for known in TIME_FIELDS if known in fields), None)
    if name is None:
        return Found(names, dtype, None, "s", "scan", f"{words}, no times of points")
    values = np.asarray(fields[name], dtype=np.float64)
    values = values[np.isfinite(values)]
    span = float(np.ptp(values)) if len(values) else 0.0
    if span == 0.0:
        return Found(names, dtype, None, "s", "scan", f"{words}, {name} is the same for all points")
    fitting: list[TimeUnit] = [u for u, seconds in _UNITS.items() if _SHORTEST_S <= span * seconds <= _LONGEST_S]
    if len(fitting) != 1:
        raise DatasetError(f"the times of points in {name} span {span:g}, which is no scan in s, ms, us or ns", path)
    unit = fitting[0]
    absolute = abs(float(np.median(values)) * _UNITS[unit] - time_ns / 1e9) < 1.0
    relative = float(np.abs(values).max()) * _UNITS[unit] < 1.0
    if not absolute and not relative:
        raise DatasetError(f"the times of points in {name} ({unit}) are not within a second of the cloud's time", path)
    since = "absolute" if absolute and not relative else "relative to the cloud's"
    kind: TimeFrom = "epoch" if absolute and not relative else "scan"
    return Found(names, dtype, name, unit, kind, f"{words}, times of points in {name}, {unit}, {since}")
