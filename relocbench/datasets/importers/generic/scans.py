"""Lidar scans of a generic folder: ``lidar.yaml`` and ``lidar/NAME/TIMESTAMP.{ply,pcd,bin,npy}``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from relocbench.arrays import Array, Times
from relocbench.datasets.core.npy import parse_npy
from relocbench.datasets.core.schema import Strict, Transform
from relocbench.datasets.core.upright import R_VEHICLE_CAMERA
from relocbench.datasets.sensors import cloud_files
from relocbench.datasets.sensors.binary_layout import detect_layout
from relocbench.datasets.sensors.cloud_formats.point_clouds import with_axes
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.datasets.sensors.plausible_points import check_distances
from relocbench.datasets.sensors.point_times import PointTimes
from relocbench.datasets.sensors.recording import Scan
from relocbench.datasets.sensors.scan_files import columns, in_range
from relocbench.datasets.sensors.trajectories import timed_files
from relocbench.errors import DatasetError
from relocbench.files import check_distinct, check_name, load_yaml, read_bytes
from relocbench.geometry import make_transform
from relocbench.progress import SILENT, Reporter

LIDAR_FILE = "lidar.yaml"
SUFFIXES = tuple(suffix for suffix in cloud_files.SUFFIXES if suffix not in (".txt", ".csv"))
"""of scans; other text in their folder may as well be about them"""
USUAL_COLUMNS: dict[int, tuple[str, ...]] = {
    3: ("x", "y", "z"),
    4: ("x", "y", "z", "intensity"),
    5: ("x", "y", "z", "intensity", "ring"),
    6: ("x", "y", "z", "intensity", "ring", "time"),
}
"""columns of a point by their number, where they are not named"""
RigAxes = Literal["forward-left-up", "right-down-forward"]
T_NEW_RIG: dict[RigAxes, Array] = {
    "forward-left-up": np.eye(4),
    "right-down-forward": make_transform(R_VEHICLE_CAMERA, np.zeros(3)),
}
"""(4, 4) from rig axes of a file to x forward, y left, z up"""
_FAR_S = 1.0
"""seconds that a point is at most from its scan's time"""


class GenericLidar(Strict):
    """A lidar in ``lidar.yaml``."""

    pattern: Literal["spinning", "push-broom"]
    T_rig_lidar: Transform = Transform(translation_m=(0.0, 0.0, 0.0), quaternion_xyzw=(0.0, 0.0, 0.0, 1.0))
    max_range: float = Field(100.0, gt=0, allow_inf_nan=False)
    """metres; farther points are left out"""
    min_range: float = Field(0.1, ge=0, allow_inf_nan=False)
    """metres; nearer points, such as (0, 0, 0) for beams without a return, are left out"""
    sigma: float = Field(0.03, gt=0, allow_inf_nan=False)
    """metres, one standard deviation of a range"""
    columns: tuple[str, ...] = ()
    """columns of .bin files and of plain .npy arrays; empty: told from the values"""
    dtype: Literal["auto", "float32", "float64"] = "auto"
    """data type of .bin files; auto: told from the values"""
    time: str | None = None
    """column or property with the time of each point; None: all points have the scan's time, motion compensated"""
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    time_from: Literal["scan", "epoch"] = "scan"
    """whether times are relative to the scan's timestamp or absolute"""

    @model_validator(mode="after")
    def _has_columns(self) -> Self:
        missing = [name for name in ("x", "y", "z") if name not in self.columns]
        if self.columns and (missing or len(set(self.columns)) != len(self.columns)):
            raise ValueError("columns must contain x, y and z, and each once")
        if self.min_range >= self.max_range:
            raise ValueError("min_range must be below max_range")
        return self


class LidarFile(Strict):
    """The content of ``lidar.yaml``."""

    lidars: dict[str, GenericLidar] = Field(min_length=1)
    rig_axes: RigAxes = "forward-left-up"
    """rig axes of poses.txt and of all extrinsics in the folder; right-down-forward are those of a camera"""

    @model_validator(mode="after")
    def _plain_names(self) -> Self:
        for name in self.lidars:
            check_name(name, "lidar name")
        check_distinct(self.lidars, "lidar names")
        return self


@dataclass(frozen=True, eq=False)
class GenericLidarStream:
    """The scans of one lidar."""

    name: str
    settings: GenericLidar
    T_rig_lidar: Array
    files: tuple[Path, ...]
    times_ns: Times

    @property
    def pattern(self) -> Literal["spinning", "push-broom"]:
        return self.settings.pattern

    @property
    def max_range_m(self) -> float:
        return self.settings.max_range

    @property
    def sigma_m(self) -> float:
        return self.settings.sigma

    def read(self, index: int) -> Scan:
        """Read a scan without the points that are not finite or out of range. Raises DatasetError with the file."""
        path, settings = self.files[index], self.settings
        fields = _fields(path, settings)
        wanted = ("x", "y", "z") if settings.time is None else ("x", "y", "z", settings.time)
        missing = [name for name in wanted if name not in fields]
        if missing:
            raise DatasetError(f"has no {', '.join(missing)}; it holds {', '.join(fields) or 'nothing'}", path)
        points = np.column_stack([np.asarray(fields[axis], dtype=np.float64) for axis in "xyz"])
        kept = in_range(points, settings.min_range, settings.max_range)
        if not kept.any():
            check_distances(points, path)
        how = PointTimes(settings.time or "", settings.time_unit, settings.time_from)
        values = fields[settings.time][kept] if settings.time is not None else None
        try:
            return Scan(points[kept], how.at(values, points[kept], int(self.times_ns[index]), _FAR_S))
        except ValueError as bad:
            raise DatasetError(f"{bad}; check time_unit and time_from", path) from None


def read_lidars(root: Path, T_new_rig: Array, reporter: Reporter = SILENT) -> tuple[GenericLidarStream, ...]:
    """The lidars of a folder, in the order of ``lidar.yaml``.

    Args:
        T_new_rig: (4, 4) from the folder's rig axes (``rig_axes`` in ``lidar.yaml``) to those of recordings.
        reporter: is told what columns and data types were found.

    Raises:
        DatasetError: with file and line: ``lidar.yaml`` is wrong, a scan's name is not a time, there is no scan, or its
            columns or data type cannot be told.
    """
    streams = []
    for name, settings in read_lidar_file(root).lidars.items():
        files = timed_files(root / "lidar" / name, SUFFIXES)
        if not files:
            raise DatasetError(f"holds no scan; expected TIMESTAMP{', '.join(SUFFIXES)}", root / "lidar" / name)
        times = np.array(list(files), dtype=np.int64)
        T_rig_lidar = T_new_rig @ settings.T_rig_lidar.matrix
        known = _with_layout(settings, tuple(files.values()), name, root, reporter)
        streams.append(GenericLidarStream(name, known, T_rig_lidar, tuple(files.values()), times))
    return tuple(streams)


def _with_layout(
    settings: GenericLidar, files: tuple[Path, ...], name: str, root: Path, reporter: Reporter
) -> GenericLidar:
    """The settings with the columns and the data type of ``.bin`` files, told from a scan where they are not given."""
    scans = [path for path in files if path.suffix.lower() == ".bin"]
    if not scans or (settings.columns and settings.dtype != "auto"):
        return settings
    number = None if settings.dtype == "auto" else settings.dtype
    # The scan in the middle tells more than one at an end, where a car may stand in a garage.
    tried = dict.fromkeys(scans[k] for k in (len(scans) // 2, len(scans) // 4, 3 * len(scans) // 4, 0))
    faults: list[DatasetError] = []
    for path in tried:
        data = read_bytes(path, "a lidar scan", DatasetError, MOST_SCAN_BYTES)
        try:
            found = detect_layout(data, path, number, len(settings.columns) or None)
        except DatasetError as bad:
            faults.append(bad)
            continue
        columns = settings.columns or USUAL_COLUMNS[found.columns]
        reporter.note(
            f"{root.name}: scans of {name} are read as {found.number} {' '.join(columns)}, told from {path.name}"
        )
        return settings.model_copy(update={"columns": columns, "dtype": found.number})
    message = f"{faults[0].expected} (columns and dtype in {LIDAR_FILE})"
    raise DatasetError(message, faults[0].path)


def read_lidar_file(root: Path) -> LidarFile:
    """Read ``lidar.yaml``. Raises DatasetError with file and line."""
    return load_yaml(root / LIDAR_FILE, LidarFile, "the lidar or lidars of the folder", DatasetError)


def _fields(path: Path, settings: GenericLidar) -> dict[str, NDArray[Any]]:
    """Fields of a scan in any of the formats, name -> (N,)."""
    suffix = path.suffix.lower()
    if suffix == ".bin":
        return _columns(_binary(path, settings), settings.columns, path)
    if suffix == ".npy":
        return _numpy(path, settings)
    return cloud_files.read_fields(path, [])


def _binary(path: Path, settings: GenericLidar) -> NDArray[Any]:
    data = read_bytes(path, "a lidar scan", DatasetError, MOST_SCAN_BYTES)
    if settings.dtype == "auto":
        raise DatasetError(f"its data type is not known; name columns and dtype in {LIDAR_FILE}", path)
    kind = np.dtype(settings.dtype).newbyteorder("<").str
    return columns(data, " ".join(settings.columns), path, kind)


def _numpy(path: Path, settings: GenericLidar) -> dict[str, NDArray[Any]]:
    values = parse_npy(read_bytes(path, "a lidar scan", DatasetError, MOST_SCAN_BYTES), path)
    if values.dtype.names:
        fields = {name: np.ravel(values[name]) for name in values.dtype.names if values.dtype[name].shape == ()}
        return with_axes(fields, path)
    if values.ndim != 2:
        width = len(settings.columns) or "3 to 6"
        raise DatasetError(f"is an array of shape {values.shape}, expected (points, {width})", path)
    columns = settings.columns or USUAL_COLUMNS.get(values.shape[1])
    if columns is None:
        raise DatasetError(f"has {values.shape[1]} columns; name them by columns in {LIDAR_FILE}", path)
    return _columns(values, columns, path)


def _columns(values: NDArray[Any], names: tuple[str, ...], path: Path) -> dict[str, NDArray[Any]]:
    if values.shape[1] != len(names):
        columns = f"{len(names)} ({' '.join(names)})"
        raise DatasetError(f"has {values.shape[1]} columns, but {LIDAR_FILE} names {columns}", path)
    return {name: values[:, i] for i, name in enumerate(names)}
