"""Poses of a folder's clouds: TUM trajectories, KITTI's matrices, and the vertices of pose graphs (g2o and alike)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import missing
from relocbench.datasets.sensors.numbered_rows import read_numbered_rows
from relocbench.datasets.sensors.pose_columns import read_pose_columns
from relocbench.datasets.sensors.pose_tables import MATRIX, TQ, PoseNumbers, Row, pose_table
from relocbench.datasets.sensors.times import check_increasing, times_in_ns
from relocbench.errors import DatasetError, quoted

_FORMATS = "TUM (t tx ty tz qx qy qz qw), KITTI (12 numbers), or a graph (v0 x y z qx qy qz qw; VERTEX_SE3:QUAT)"
_VERTEX = re.compile(r"v?([0-9]{1,9})")
_GRAPH = ("v", "VERTEX", "EDGE", "FIX", "PARAMS")


def read_cloud_poses(path: Path, count: int) -> list[Array | None]:
    """Poses ``T_world_cloud`` (4, 4), in the order of the lines, or of the numbers of vertices.

    A cloud whose line is empty, commented out or not finite has None.

    Raises:
        DatasetError: with file and line: a line is in none of the formats, a pose is none, times go back, or there are
            not ``count`` lines.
    """
    rows = read_numbered_rows(path, f"poses: {_FORMATS}")
    if any(row.fields[0].startswith(_GRAPH) for row in rows.filled.values()):
        vertices = _vertices(rows.filled, path)
        _check_count(len(vertices), 0, count, path)
        found = _poses(vertices, TQ, path)
        return [found.get(number) for number in sorted(vertices)]
    _check_count(len(rows), rows.spare, count, path)
    if all(len(row.fields) == 12 for row in rows.filled.values()):
        found = _poses(rows.filled, MATRIX, path)
    else:
        found = _poses(_timed(rows.filled, path), TQ, path)
    return [found.get(number) for number in range(count)]


def _check_count(lines: int, spare: int, count: int, path: Path) -> None:
    if not lines <= count <= lines + spare:
        raise DatasetError(f"holds {lines} poses, but there are {count} clouds; expected one line a cloud", path)


def _poses(rows: Mapping[int, Row], kind: PoseNumbers, path: Path) -> dict[int, Array]:
    ordered = sorted(rows)
    return pose_table([rows[number] for number in ordered], kind, path, times=ordered).by_time


def _vertices(rows: Mapping[int, Row], path: Path) -> dict[int, Row]:
    """The poses of vertices by their number."""
    found: dict[int, Row] = {}
    for row in rows.values():
        fields = row.fields[1:] if row.fields[0] == "VERTEX_SE3:QUAT" else row.fields
        if fields[0].startswith(_GRAPH[1:]):
            continue
        if len(fields) != 8:
            raise DatasetError(f"expected a number and x y z qx qy qz qw, found {len(fields)} fields", path, row.line)
        number = _VERTEX.fullmatch(fields[0])
        if number is None:
            raise DatasetError(f"expected the number of a vertex, found {quoted(fields[0], 30)}", path, row.line)
        if int(number[1]) in found:
            raise DatasetError(f"has a second pose of vertex {int(number[1])}", path, row.line)
        found[int(number[1])] = Row(row.line, fields[1:])
    return found


def _timed(rows: Mapping[int, Row], path: Path) -> dict[int, Row]:
    """The poses of a trajectory by the number of their line, in the columns that a header names."""
    header, _ = read_pose_columns(path, f"poses: {_FORMATS}")
    for row in rows.values():
        if len(row.fields) != 8:
            found = quoted(" ".join(row.fields), 60)
            raise DatasetError(f"expected {_FORMATS}; found {found}", path, row.line)
    chosen = range(8) if header is None else header.columns
    columns = {number: [row.fields[column] for column in chosen] for number, row in rows.items()}
    posed = [number for number, fields in columns.items() if not missing(fields)]
    texts, lines = [columns[number][0] for number in posed], [rows[number].line for number in posed]
    check_increasing(times_in_ns(texts, lambda i: (path, lines[i])).ns, texts, path, lines)
    return {number: Row(rows[number].line, columns[number][1:]) for number in posed}
