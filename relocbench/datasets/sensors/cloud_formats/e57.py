"""E57 files, by pye57: one or more setups of a scanner, each with its pose.

Format: ASTM E2807, "Standard specification for 3D imaging data exchange".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.cloud_formats.e57_header import check_header
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import make_transform, project_to_rotation

EXTRA = "pip install 'relocbench[clouds]'"


@dataclass(frozen=True, eq=False)
class Setup:
    """The points of one setup of the scanner."""

    points: Array
    """(N, 3) metres in the scanner's frame"""
    T_file_setup: Array
    """(4, 4); the identity if the file states no pose"""
    posed: bool
    """whether the file states a pose"""


def read_e57(path: Path, wanted: Sequence[int], most_points: int) -> tuple[list[Setup], int]:
    """Some setups of a file, and how many it holds.

    Args:
        wanted: numbers of the setups, from 0; none: all.

    Raises:
        ConfigError: pye57 is not installed.
        DatasetError: the file is damaged, has no such setup, or the setups hold more than ``most_points``.
    """
    try:
        import pye57
    except ImportError:
        raise ConfigError(f".e57 files need the package pye57: {EXTRA}") from None
    check_header(path)
    try:
        file = pye57.E57(str(path))
        try:
            count = int(file.scan_count)
            numbers = list(wanted) or list(range(count))
            missing = [n for n in numbers if not 0 <= n < count]
            if missing:
                raise DatasetError(f"has no setup {missing[0]}; it holds {count}, counted from 0", path)
            headers = [file.get_header(n) for n in numbers]
            total = sum(int(header.point_count) for header in headers)
            if total > most_points:
                raise DatasetError(f"holds {total} points, more than {most_points}; select setups or thin it", path)
            return [_setup(file, n, header) for n, header in zip(numbers, headers, strict=True)], count
        finally:
            file.close()
    except DatasetError:
        raise
    # The library raises errors of its own C++ parts besides Python's.
    except Exception as bad:
        raise DatasetError(f"cannot be read as E57 ({type(bad).__name__})", path) from bad


def _setup(file: object, number: int, header: object) -> Setup:
    if not int(header.point_count):  # type: ignore[attr-defined]
        return Setup(np.empty((0, 3)), np.eye(4), False)
    data = file.read_scan(number, transform=False, ignore_missing_fields=True)  # type: ignore[attr-defined]
    if "cartesianX" in data:
        points = np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"]).astype(np.float64)
    else:
        r, azimuth, elevation = (
            np.asarray(data[f"spherical{name}"], dtype=np.float64) for name in ("Range", "Azimuth", "Elevation")
        )
        level = r * np.cos(elevation)
        points = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), r * np.sin(elevation)])
    posed = bool(header.has_pose())  # type: ignore[attr-defined]
    T = np.eye(4)
    if posed:
        rotation = project_to_rotation(np.asarray(header.rotation_matrix, dtype=np.float64))  # type: ignore[attr-defined]
        T = make_transform(rotation, np.asarray(header.translation, dtype=np.float64))  # type: ignore[attr-defined]
    return Setup(points[np.isfinite(points).all(axis=1)], T, posed)
