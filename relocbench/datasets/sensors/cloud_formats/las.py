"""LAS and LAZ files, by laspy (LAZ with lazrs).

Format: ASPRS, "LAS Specification", version 1.4. Coordinates are integers with a scale and an offset, often of a map's
grid with values in the millions; they are read as float64, which holds them to a nanometre.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.sensors.cloud_formats.coordinate_system import convertible, coordinate_system
from relocbench.datasets.sensors.cloud_formats.las_header import LasHeader, read_header
from relocbench.datasets.sensors.plausible_points import check_degrees, without_saturated
from relocbench.errors import ConfigError, DatasetError

EXTRA = "pip install 'relocbench[clouds]'"
_CHUNK_BYTES = 2**25
"""of records that are read at a time"""
_FINE = 2e-6
"""a scale below this is one of degrees: of metres it would be micrometres"""


def read_las(path: Path, most_points: int, notes: list[str]) -> Array:
    """Coordinates (N, 3) of the points in metres, in the file's own coordinate system; feet are converted.

    Args:
        notes: what was assumed, converted or left out is added.

    Raises:
        ConfigError: laspy, lazrs or pyproj is not installed.
        DatasetError: the file is damaged, does not hold what its header promises, has more than
            ``most_points``, coordinates in degrees, or many that their integers cannot hold.
    """
    try:
        import laspy
        import pyproj  # noqa: F401  looks up coordinate systems
    except ImportError:
        raise ConfigError(f"{path.suffix} files need the packages laspy and pyproj: {EXTRA}") from None
    with path.open("rb") as stream:
        header = read_header(stream, path.stat().st_size, path)
    if header.points > most_points:
        raise DatasetError(f"holds {header.points} points, more than {most_points}; thin it first", path)
    if header.compressed and not laspy.LazBackend.Lazrs.is_available():
        raise ConfigError(f"compressed LAS files need the package lazrs: {EXTRA}")
    system = coordinate_system(header.projection, header.prefers_wkt, path, notes)
    factors = _factors(system, path, notes)
    integers = without_saturated(_integers(laspy, path, header), path, notes)
    points = integers * header.scales + header.offsets
    if system is None:
        check_degrees(points, path, fine=bool((np.abs(header.scales[:2]) < _FINE).all()))
    return points if factors is None else points * factors


def _factors(system: Any, path: Path, notes: list[str]) -> Array | None:
    if system is None:
        notes.append("the file states no coordinate system; coordinates are taken as metres")
        return None
    level, vertical, note = convertible(system, path)
    if note:
        notes.append(note)
    return None if level == vertical == 1.0 else np.array([level, level, vertical])


def _integers(laspy: Any, path: Path, header: LasHeader) -> NDArray[np.int32]:
    """(N, 3) x, y and z as they are stored."""
    parts: list[NDArray[np.int32]] = []
    if not header.points:
        return np.empty((0, 3), np.int32)
    try:
        # The parallel decompressor ends the process if points are damaged.
        one = laspy.LazBackend.Lazrs if header.compressed else None
        with laspy.open(path, read_evlrs=False, laz_backend=one) as stream:
            for points in stream.chunk_iterator(max(_CHUNK_BYTES // header.record_bytes, 1)):
                parts.append(np.column_stack([points.X, points.Y, points.Z]))
    # laspy and lazrs raise errors of many kinds for damaged files; panics of Rust are no Exception.
    except BaseException as bad:
        if not isinstance(bad, Exception) and type(bad).__name__ != "PanicException":
            raise
        raise DatasetError(f"cannot be read as LAS or LAZ ({type(bad).__name__})", path) from bad
    found = np.concatenate(parts) if parts else np.empty((0, 3), np.int32)
    if len(found) != header.points:
        raise DatasetError(f"its header promises {header.points} points, but {len(found)} can be read", path)
    return found
