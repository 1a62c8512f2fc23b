"""What the clouds of a folder hold, found by looking at one of them: columns and type of .bin, times of points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core.npy import parse_npy
from relocbench.datasets.importers.generic.scans import USUAL_COLUMNS, GenericLidar
from relocbench.datasets.sensors.binary_layout import Number, decode_points, detect_layout
from relocbench.datasets.sensors.cloud_files import read_fields
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "timestamps", "offset_time", "time_offset", "time_offset_ns")
_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_SHORTEST_S, _LONGEST_S = 0.004, 0.6
"""a scan takes so long"""


def with_layout(settings: GenericLidar, path: Path, time_ns: int) -> tuple[GenericLidar, str]:
    """The settings with the columns, the type and the times of points that a cloud has, and these in words.

    Args:
        settings: the columns of .bin and plain .npy files are found if they have none.
        time_ns: the cloud's time.

    Raises:
        DatasetError: the file is damaged, or its columns or the unit of its times cannot be told.
    """
    suffix, columns = path.suffix.lower(), settings.columns
    dtype: Number = "float32"
    if suffix == ".bin":
        data = read_bytes(path, "a point cloud", DatasetError, MOST_SCAN_BYTES)
        layout = detect_layout(data, path, columns=len(columns) or None)
        names, dtype = columns or _usual(layout.columns, path), layout.number
        fields = dict(zip(names, decode_points(data, layout, path).T, strict=True))
        words = f"{dtype} {' '.join(names)}"
    else:
        notes: list[str] = []
        fields, names = _array(path, columns) if suffix == ".npy" else (read_fields(path, notes), columns)
        words = "; ".join([f"{suffix[1:]} with {' '.join(fields)}", *notes])
    known = {"columns": names or ("x", "y", "z", "intensity"), "dtype": dtype}
    times, how = _times(fields, time_ns, path)
    return settings.model_copy(update={**known, **times}), f"{words}, {how}"


def _array(path: Path, columns: tuple[str, ...]) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """The fields of a NumPy file, and the names of its columns where it has none."""
    values = parse_npy(read_bytes(path, "a point cloud", DatasetError, MOST_SCAN_BYTES), path)
    if values.dtype.names:
        return {name: np.ravel(values[name]) for name in values.dtype.names}, columns
    names = columns or _usual(values.shape[-1] if values.ndim == 2 else 0, path)
    if values.ndim != 2 or values.shape[1] != len(names):
        raise DatasetError(f"is an array of shape {values.shape}, expected columns {' '.join(names)}", path)
    return dict(zip(names, values.T, strict=True)), names


def _usual(count: int, path: Path) -> tuple[str, ...]:
    names = USUAL_COLUMNS.get(count)
    if names is None:
        raise DatasetError(f"has {count} columns, whose meaning is not known; give them with --columns", path)
    return names


def _times(fields: Mapping[str, NDArray[Any]], time_ns: int, path: Path) -> tuple[dict[str, str], str]:
    """What ``lidar.yaml`` would say of the times of points, and the same in words."""
    name = next((known for known in TIME_FIELDS if known in fields), None)
    if name is None:
        return {}, "no times of points"
    values = np.asarray(fields[name], dtype=np.float64)
    values = values[np.isfinite(values)]
    span = float(np.ptp(values)) if len(values) else 0.0
    if span == 0.0:
        return {}, f"{name} is the same for all points"
    fitting = [u for u, seconds in _UNITS.items() if _SHORTEST_S <= span * seconds <= _LONGEST_S]
    if len(fitting) != 1:
        raise DatasetError(
            f"the times of points in {name} span {span:g}, which is not the length of a scan in s, ms, us or ns", path
        )
    unit = fitting[0]
    absolute = abs(float(np.median(values)) * _UNITS[unit] - time_ns / 1e9) < 1.0
    relative = float(np.abs(values).max()) * _UNITS[unit] < 1.0
    if not absolute and not relative:
        raise DatasetError(f"the times of points in {name} ({unit}) are not within a second of the cloud's time", path)
    kind, since = ("scan", "relative to the cloud's") if relative else ("epoch", "absolute")
    return {"time": name, "time_unit": unit, "time_from": kind}, f"times of points in {name}, {unit}, {since}"
