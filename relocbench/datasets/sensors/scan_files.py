"""The scans of a lidar as binary files, one a scan, whose records each format decodes in its own way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Mask, Times
from relocbench.datasets.sensors.cloud_formats.point_table import MOST_SCAN_BYTES
from relocbench.datasets.sensors.plausible_points import check_distances
from relocbench.datasets.sensors.record_layout import check_records
from relocbench.datasets.sensors.recording import Scan
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

_FAR_NS = 1_000_000_000
_ABSURD_NS = 1e18


@dataclass(frozen=True, eq=False)
class Returns:
    """What a scan's file holds."""

    points: Array
    """(N, 3) metres, in the lidar's frame; rows that are not finite are beams without a return"""
    offsets_ns: Times | None = None
    """(N,) times relative to the scan's own; None if all points have the scan's time"""


class Decoder(Protocol):
    """Turns the bytes of a scan's file into points; a function of a module or another picklable thing."""

    def __call__(self, data: bytes, path: Path, /) -> Returns:
        """Decode a file. Raises DatasetError with the file."""
        ...


@dataclass(frozen=True, eq=False)
class ScanFiles:
    """The scans of one lidar."""

    name: str
    files: tuple[Path, ...]
    times_ns: Times
    T_rig_lidar: Array
    decode: Decoder
    max_range_m: float
    sigma_m: float
    min_range_m: float = 0.5
    """nearer points, such as (0, 0, 0) for beams without a return, are left out"""
    pattern: Literal["push-broom", "spinning"] = "spinning"

    def read(self, index: int) -> Scan:
        """Read a scan without the points that are not finite or out of range.

        Raises:
            DatasetError: the file is missing, empty or damaged, or a point is more than a second off the scan's time.
        """
        path = self.files[index]
        data = read_bytes(path, f"a scan of {self.name}", DatasetError, MOST_SCAN_BYTES)
        if not data:
            raise DatasetError(f"is empty; expected a scan of {self.name}", path)
        found = self.decode(data, path)
        kept = in_range(found.points, self.min_range_m, self.max_range_m)
        if not kept.any():
            check_distances(found.points, path)
        times = np.full(int(kept.sum()), self.times_ns[index], dtype=np.int64)
        if found.offsets_ns is not None:
            offsets = found.offsets_ns[kept]
            if len(offsets) and (int(offsets.min()) < -_FAR_NS or int(offsets.max()) > _FAR_NS):
                raise DatasetError("has points more than a second away from the scan's time", path)
            times += offsets
        return Scan(found.points[kept], times)


def in_range(points: Array, least_m: float, most_m: float) -> Mask:
    """Which points (N, 3) are finite, and neither too near nor too far."""
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.sqrt(np.sum(points**2, axis=1))
    kept: Mask = np.isfinite(distance) & (distance >= least_m) & (distance <= most_m)
    return kept


def records(data: bytes, row: np.dtype[Any], path: Path) -> NDArray[Any]:
    """The records (N,) of a file. Raises DatasetError if by size or values it does not hold a whole number of them."""
    check_records(data, row, path)
    return np.frombuffer(data, dtype=row)


def columns(data: bytes, names: str, path: Path, kind: str = "<f4") -> NDArray[Any]:
    """The points (N, columns) of a file whose columns all have one type, with the columns in the order of ``names``.

    Raises:
        DatasetError: the file does not hold a whole number of points, or of other columns by its values.
    """
    row = np.dtype([(name, kind) for name in names.split()])
    return records(data, row, path).view(kind).reshape(-1, len(names.split()))


def xyz(table: NDArray[Any]) -> Array:
    """(N, 3) points of records with the fields ``x``, ``y`` and ``z``."""
    return np.column_stack([table[axis].astype(np.float64) for axis in "xyz"])


def seconds_as_offsets(seconds: NDArray[Any]) -> Times:
    """(N,) offsets in nanoseconds; times that are not finite or absurd become ones that :class:`ScanFiles` refuses."""
    with np.errstate(invalid="ignore", over="ignore"):
        ns = np.rint(seconds.astype(np.float64) * 1e9)
    known = np.nan_to_num(ns, nan=_ABSURD_NS, posinf=_ABSURD_NS, neginf=-_ABSURD_NS)
    out: Times = np.clip(known, -_ABSURD_NS, _ABSURD_NS).astype(np.int64)
    return out


def swept(points: Array, period_ns: int, *, clockwise: bool, zero_at: float = 0.0) -> Times:
    """Offsets (N,) of the points of a lidar that spins around its z axis, by their azimuths.

    Args:
        period_ns: time of a turn.
        clockwise: the sense of rotation seen from +z.
        zero_at: azimuth in radians, from x to y, that has the scan's time; offsets are within half a turn of it.
    """
    with np.errstate(invalid="ignore"):
        azimuth = np.arctan2(points[:, 1], points[:, 0]) - zero_at
    azimuth = np.nan_to_num(np.mod(azimuth + np.pi, 2 * np.pi) - np.pi)
    return np.rint((-1 if clockwise else 1) * azimuth / (2 * np.pi) * period_ns).astype(np.int64)
