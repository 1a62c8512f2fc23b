"""What the clouds of a folder hold, found by looking at one of them: columns and type of .bin, times of points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core.npy import parse_npy
from relocbench.datasets.importers.generic.scans import USUAL_COLUMNS
from relocbench.datasets.sensors.binary_layout import Number, decode_points, detect_layout
from relocbench.datasets.sensors.point_clouds import read_point_cloud
from relocbench.datasets.sensors.point_table import MOST_SCAN_BYTES
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

TimeUnit = Literal["s", "ms", "us", "ns"]
TimeFrom = Literal["scan", "epoch"]

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "timestamps", "offset_time", "time_offset", "time_offset_ns")
_UNITS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_SHORTEST_S, _LONGEST_S = 0.004, 0.6
"""a scan takes so long"""


@dataclass(frozen=True)
class ScanLayout:
    """What was found, in the terms of ``lidar.yaml``."""

    columns: tuple[str, ...]
    dtype: Number
    time: str | None
    time_unit: TimeUnit
    time_from: TimeFrom
    words: str
    """what was found, for people"""


def layout_of_scan(path: Path, time_ns: int, columns: tuple[str, ...] = ()) -> ScanLayout:
    """What a cloud holds.

    Args:
        time_ns: its time.
        columns: the columns of .bin and plain .npy files, if they are known.

    Raises:
        DatasetError: the file is damaged, or its columns or the unit of its times cannot be told.
    """
    suffix = path.suffix.lower()
    dtype: Number = "float32"
    if suffix == ".bin":
        data = read_bytes(path, "a point cloud", DatasetError, MOST_SCAN_BYTES)
        layout = detect_layout(data, path, columns=len(columns) or None)
        names, dtype = columns or _usual(layout.columns, path), layout.number
        fields = dict(zip(names, decode_points(data, layout, path).T, strict=True))
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
    names = USUAL_COLUMNS.get(count)
    if names is None:
        raise DatasetError(f"has {count} columns, whose meaning is not known; give them with --columns", path)
    return names


def _with_times(
    fields: Mapping[str, NDArray[Any]], names: tuple[str, ...], dtype: Any, words: str, time_ns: int, path: Path
) -> ScanLayout:
    name = next((known for known in TIME_FIELDS if known in fields), None)
    if name is None:
        return ScanLayout(names, dtype, None, "s", "scan", f"{words}, no times of points")
    values = np.asarray(fields[name], dtype=np.float64)
    values = values[np.isfinite(values)]
    span = float(np.ptp(values)) if len(values) else 0.0
    if span == 0.0:
        return ScanLayout(names, dtype, None, "s", "scan", f"{words}, {name} is the same for all points")
    fitting: list[TimeUnit] = [u for u, seconds in _UNITS.items() if _SHORTEST_S <= span * seconds <= _LONGEST_S]
    if len(fitting) != 1:
        raise DatasetError(
            f"the times of points in {name} span {span:g}, which is not the length of a scan in s, ms, us or ns", path
        )
    unit = fitting[0]
    absolute = abs(float(np.median(values)) * _UNITS[unit] - time_ns / 1e9) < 1.0
    relative = float(np.abs(values).max()) * _UNITS[unit] < 1.0
    if not absolute and not relative:
        raise DatasetError(f"the times of points in {name} ({unit}) are not within a second of the cloud's time", path)
    since = "absolute" if absolute and not relative else "relative to the cloud's"
    kind: TimeFrom = "epoch" if absolute and not relative else "scan"
    return ScanLayout(names, dtype, name, unit, kind, f"{words}, times of points in {name}, {unit}, {since}")
