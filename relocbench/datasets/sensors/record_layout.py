"""Whether the records of a scan's file have the length that the reader expects.

A sensor's software changes what it writes with a point from one version to the next. A file of records of another
length often has a size that fits, and its numbers are then those of other columns. In records of the right length, one
point is near the next.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Bytes
from relocbench.errors import DatasetError

_LENGTHS = range(12, 65)
"""bytes that records may have"""
_LOOKED_AT, _FEWEST = 2000, 50
"""records that are looked at, and so many at least"""
_NEAR, _NEARER = 0.5, 0.9
"""neighbours in records of another length are this much nearer to each other; the second, if it divides the expected"""
_SENSIBLE, _LEAST_SHARE = 0.98, 0.3
"""share of the values that must be of a sensible size, and of the records that must be points"""
_LARGEST_M, _SMALLEST_M = 1e4, 1e-6


def check_records(data: bytes, row: np.dtype[Any], path: Path) -> None:
    """Check the length of records that hold ``x``, ``y`` and ``z`` as floats; others must only be whole.

    Raises:
        DatasetError: the file is not a whole number of records, or its values are those of records of another length,
            which is named.
    """
    whole = len(data) % row.itemsize == 0
    expected, share = _distance(data, row, row.itemsize) if whole else (np.inf, _LEAST_SHARE)
    if whole and not share:
        return  # nothing to compare with, such as a scan without returns
    # Columns that are not numbers, or 0, make no points of every second record of half the length.
    best, nearest = _likely(data, row, max(_LEAST_SHARE, 0.95 * share))
    names = " ".join(row.names or ())
    if not whole:
        message = f"{len(data)} bytes are not a whole number of points of {row.itemsize} bytes ({names})"
        raise DatasetError(message + said_of(data, best), path)
    if best and nearest < (_NEARER if row.itemsize % best == 0 else _NEAR) * expected:
        message = f"its points do not have the expected {row.itemsize} bytes ({names})"
        raise DatasetError(message + said_of(data, best), path)


def likely_length(data: bytes) -> int:
    """Bytes of a record that begins with x, y and z as float32, by the values; 0 if there seem to be none."""
    return _likely(data, np.dtype([(axis, "<f4") for axis in "xyz"] + [("other", "u1")]))[0]


def said_of(data: bytes, length: int) -> str:
    """What is said of records of another length; empty if the length is 0."""
    if not length:
        return ""
    return f"; by its values the file holds {len(data) // length} points of {length} bytes, as of another firmware"


def _likely(data: bytes, row: np.dtype[Any], least: float = _LEAST_SHARE) -> tuple[int, float]:
    """The length of records in which points are near their neighbours, and how near; 0 if there is none.

    Args:
        least: share of the records that must be points.
    """
    found = {size: _distance(data, row, size) for size in _others(data, row)}
    others = {size: distance for size, (distance, share) in found.items() if share >= least}
    nearest = min(others.values(), default=np.inf)
    # Twice the right length takes every second point, which is little farther from the next.
    return min((size for size, distance in others.items() if distance <= nearest / _NEARER), default=0), nearest


def _others(data: bytes, row: np.dtype[Any]) -> list[int]:
    if not set("xyz") <= set(row.names or ()) or any(row[axis].kind != "f" for axis in "xyz"):
        return []
    least = max(row.fields[axis][1] + row[axis].itemsize for axis in "xyz")  # type: ignore[index]
    step = row["x"].itemsize if all(row[name] == row["x"] for name in row.names or ()) else 1
    sizes = range(least, max(_LENGTHS.stop, row.itemsize + 1), step)
    return [size for size in sizes if len(data) % size == 0 and size != row.itemsize]


def _distance(data: bytes, row: np.dtype[Any], size: int) -> tuple[float, float]:
    """How far points are from the next in records of ``size`` bytes, and which share of the records are points.

    Distances are means on a logarithmic scale; inf and 0 if there are no points.
    """
    nothing = np.inf, 0.0
    if not set("xyz") <= set(row.names or ()) or any(row[axis].kind != "f" for axis in "xyz"):
        return nothing
    points = _points(data, row, size)
    finite = points[np.isfinite(points).all(axis=1)]
    length = np.abs(finite)
    sensible = (length == 0) | ((length >= _SMALLEST_M) & (length <= _LARGEST_M))
    returned = finite[finite.any(axis=1)]
    if len(returned) < _FEWEST or np.mean(sensible) < _SENSIBLE:
        return nothing
    return float(np.mean(np.abs(np.diff(np.arcsinh(returned), axis=0)))), len(returned) / len(points)


def _points(data: bytes, row: np.dtype[Any], size: int) -> Array:
    count = min(len(data) // size, _LOOKED_AT)
    raw: Bytes = np.frombuffer(data, np.uint8, count * size).reshape(count, size)
    columns = []
    for axis in "xyz":
        at = row.fields[axis][1]  # type: ignore[index]
        columns.append(np.ascontiguousarray(raw[:, at : at + row[axis].itemsize]).view(row[axis])[:, 0])
    return np.column_stack(columns).astype(np.float64)
