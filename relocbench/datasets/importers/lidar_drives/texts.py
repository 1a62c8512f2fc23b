"""Tables, matrices and times as the text files of lidar datasets have them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from relocbench.arrays import Array
from relocbench.datasets.sensors.matrices import as_transform
from relocbench.errors import DatasetError
from relocbench.files import lines_of, parse_floats, read_rows, read_text
from relocbench.geometry import make_transform


def read_named_columns(path: Path, columns: Sequence[str], what: str) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and the fields of ``columns``, in that order, from a table with commas and a header.

    Raises:
        DatasetError: with file and line: a column is missing, or a line has another number of fields than the header.
    """
    lines = lines_of(read_text(path, f"{what} ({','.join(columns)})", DatasetError))
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    missing = [name for name in columns if name not in header]
    if missing:
        raise DatasetError(f"the header has no column {', '.join(missing)}", path, 1)
    wanted = [header.index(name) for name in columns]
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        fields = line.split(",")
        if len(fields) != len(header):
            raise DatasetError(f"expected {len(header)} columns, found {len(fields)}", path, number)
        yield number, [fields[i].strip() for i in wanted]


def read_matrix(path: Path, what: str, columns: int = 4) -> Array:
    """A matrix (rows, columns) of finite numbers, a row a line. Raises DatasetError with file and line."""
    names = " ".join(f"m{k}" for k in range(columns))
    found = [
        parse_floats(fields, path, line, names, DatasetError) for line, fields in read_rows(path, what, DatasetError)
    ]
    if len(found) not in (3, 4):
        raise DatasetError(f"expected 3 or 4 lines of {columns} numbers, found {len(found)}", path)
    return np.array(found)


def read_transform(path: Path, what: str) -> Array:
    """A transform (4, 4) in a file of 3 or 4 lines. Raises DatasetError with file and line."""
    return as_transform(read_matrix(path, what), path)


def finite_numbers(entry: Any, name: str, count: int, path: Path) -> Array:
    """Numbers (count,) of a YAML file, in a list or under ``data``, as calibrations of ROS have them.

    Raises:
        DatasetError: they are not ``count`` finite numbers.
    """
    try:
        numbers = np.array(entry.get("data") if isinstance(entry, dict) else entry, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise DatasetError(f"{name} is not {count} finite numbers", path)
    return numbers


def transform_from_xyzrpy(values: ArrayLike) -> Array:
    """Transforms (..., 4, 4) of x, y, z, roll, pitch, yaw (..., 6) in metres and radians."""
    v = np.asarray(values, dtype=np.float64)
    # Lower-case axes are fixed (extrinsic): about x first, about z last.
    rotation = Rotation.from_euler("xyz", v[..., 3:].reshape(-1, 3)).as_matrix()
    return make_transform(rotation.reshape(*v.shape[:-1], 3, 3), v[..., :3])
