"""Poses of a folder's clouds: TUM trajectories, KITTI's matrices, and the vertices of pose graphs (g2o and alike)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import parse_pose
from relocbench.datasets.sensors.matrices import parse_matrix
from relocbench.errors import DatasetError, quoted
from relocbench.files import read_rows

_FORMATS = "TUM (t tx ty tz qx qy qz qw), KITTI (12 numbers), or a graph (v0 x y z qx qy qz qw; VERTEX_SE3:QUAT)"
_VERTEX = re.compile(r"v?([0-9]{1,9})")


def read_cloud_poses(path: Path, count: int) -> Array:
    """Poses ``T_world_cloud`` (count, 4, 4), in the order of the lines, or of the numbers of vertices.

    Raises:
        DatasetError: with file and line: a line is in none of the formats, a pose is none, or there are not ``count``.
    """
    poses: list[tuple[int, Array]] = []
    for line, fields in read_rows(path, f"poses: {_FORMATS}", DatasetError):
        if fields[0].startswith(("EDGE", "FIX", "PARAMS")):
            continue
        if fields[0] == "VERTEX_SE3:QUAT":
            fields = fields[1:]
            number = _number(fields, path, line)
        elif len(fields) == 12:
            poses.append((len(poses), parse_matrix(fields, path, line)))
            continue
        elif len(fields) == 8 and fields[0].startswith("v"):
            number = _number(fields, path, line)
        elif len(fields) == 8:
            number = len(poses)
        else:
            raise DatasetError(f"expected {_FORMATS}; found {quoted(' '.join(fields), 60)}", path, line)
        if len(fields) != 8:
            raise DatasetError(f"expected a number and x y z qx qy qz qw, found {len(fields)} fields", path, line)
        poses.append((number, parse_pose(fields[1:], path, line)))
    if len({number for number, _ in poses}) != len(poses):
        raise DatasetError("has two poses of the same number", path)
    if len(poses) != count:
        raise DatasetError(f"holds {len(poses)} poses, but there are {count} clouds; expected one pose a cloud", path)
    return np.array([pose for _, pose in sorted(poses, key=lambda entry: entry[0])])


def _number(fields: list[str], path: Path, line: int) -> int:
    found = _VERTEX.fullmatch(fields[0]) if fields else None
    if found is None:
        raise DatasetError(
            f"expected the number of a vertex, found {quoted(fields[0] if fields else '', 30)}", path, line
        )
    return int(found[1])
