"""Transforms as the numbers of a matrix, which several recording formats have."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.errors import DatasetError
from relocbench.files import parse_floats
from relocbench.geometry import is_rotation, make_transform, project_to_rotation

POSE_ENTRIES = "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz"
_PRINTED = 1e-3
"""tolerance for rotations that are printed with some digits"""


def as_transform(matrix: Array, path: Path, line: int | None = None, tolerance: float = _PRINTED) -> Array:
    """The transform (4, 4) of a matrix (3 or 4, 4) that was read from ``path``.

    Raises:
        DatasetError: its upper left part is not a rotation.
    """
    if not is_rotation(matrix[:3, :3], tolerance):
        raise DatasetError("the upper left 3x3 of the matrix is not a rotation", path, line)
    return make_transform(project_to_rotation(matrix[:3, :3]), matrix[:3, 3])


def parse_matrix(fields: list[str], path: Path, line: int) -> Array:
    """The transform (4, 4) whose upper three rows are twelve fields. Raises DatasetError with file and line."""
    matrix = np.array(parse_floats(fields, path, line, POSE_ENTRIES, DatasetError)).reshape(3, 4)
    return as_transform(matrix, path, line)


def rotations_at_fault(rotations: Array) -> Indices:
    """Indices of those of (N, 3, 3) that are no rotations within what printing leaves of one."""
    near = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2)) <= _PRINTED
    return np.flatnonzero(~(near & (np.linalg.det(rotations) > 0)))
