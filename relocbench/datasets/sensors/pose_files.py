"""Files of poses alone in the formats that SLAM systems and data sets write, told apart by their columns.

=======  ==========================================================================================================
columns  what a line holds
=======  ==========================================================================================================
8        ``t tx ty tz qx qy qz qw`` (TUM), or ``t tx ty tz qw qx qy qz``, which nothing but the user can tell
8, csv   the header of ``poses.csv`` and its rows: ``timestamp_ns,tx,ty,tz,qx,qy,qz,qw``
12       the upper three rows of a pose (KITTI); times are in a file of their own
13       a time, and the same
=======  ==========================================================================================================
"""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.traversal import POSE_COLUMNS, read_poses
from relocbench.datasets.sensors.matrices import parse_matrix
from relocbench.datasets.sensors.trajectories import QuaternionOrder, read_time, read_trajectory
from relocbench.errors import DatasetError
from relocbench.files import read_rows

_EXPECTED = (
    "expected 8 columns (t tx ty tz and a quaternion), 12 (the upper three rows of a pose) or 13 (a time before them)"
)
"""of rotations that are printed with few digits"""
_STEADY = 0.97
_WANDERS = 0.99
_BETTER = 8.0
"""lengths of the mean of unit directions of travel in the rig's axes: above the first it is one direction, below the
second it need not be; and how many times farther from 1 it must be in the wrong order than in the right one"""
_FEWEST_STEPS = 20


def read_pose_file(path: Path, order: QuaternionOrder = "xyzw", times: Path | None = None) -> dict[int, Array]:
    """Read a file of poses: timestamp_ns -> (4, 4) ``T_world_rig``, in time order.

    Args:
        order: order of the quaternion's components; the header of ``poses.csv`` says it itself.
        times: file with the time of each line, for poses without times; default: ``STEM.times.txt`` beside the file.

    Raises:
        DatasetError: with file and line: a wrong number of columns, a field that is not a number, a rotation that is
            none, times that do not increase, or none at all.
    """
    if path.is_dir():
        raise DatasetError("is a folder; expected a file of poses", path)
    first = next(islice(read_rows(path, "a file of poses", DatasetError), 1), None)
    if first is None:
        raise DatasetError(f"holds no pose; {_EXPECTED}", path)
    number, fields = first
    if fields == list(POSE_COLUMNS):
        return _some(read_poses(path), path)
    if len(fields) == 8:
        return read_trajectory(path, order)
    if len(fields) not in (12, 13):
        raise DatasetError(f"{_EXPECTED}, found {len(fields)}", path, number)
    return _matrices(path, len(fields), times)


def _some(poses: dict[int, Array], path: Path) -> dict[int, Array]:
    if not poses:
        raise DatasetError("holds no pose below its header", path)
    return poses


def _matrices(path: Path, columns: int, times: Path | None) -> dict[int, Array]:
    """Poses of twelve numbers a line, with their times before them or in another file."""
    listed = None if columns == 13 else _times(path, times)
    poses: dict[int, Array] = {}
    last: int | None = None
    for row, (number, fields) in enumerate(read_rows(path, "a file of poses", DatasetError)):
        if len(fields) != columns:
            raise DatasetError(f"expected {columns} columns as in the first line, found {len(fields)}", path, number)
        if listed is None:
            time = read_time(fields[0], path, number)
            if last is not None and time <= last:
                raise DatasetError(f"time {fields[0]} is not later than the previous one", path, number)
        elif row < len(listed):
            time = listed[row]
        else:
            break
        poses[time] = parse_matrix(fields[-12:], path, number)
        last = time
    if listed is not None:
        _check_count(path, listed, times)
    return poses


def _check_count(path: Path, listed: list[int], times: Path | None) -> None:
    rows = sum(1 for _ in read_rows(path, "a file of poses", DatasetError))
    if rows != len(listed):
        raise DatasetError(f"holds {len(listed)} times, but {path.name} has {rows} poses", times or _beside(path))


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.stem}.times.txt")


def _times(path: Path, times: Path | None) -> list[int]:
    """The times of a file's lines, nanoseconds, from the file that is named or the one beside it."""
    file = times or _beside(path)
    if times is None and not file.exists():
        raise DatasetError(f"12 columns are poses without times; expected {file.name} beside it, or --times FILE", path)
    found: list[int] = []
    for number, fields in read_rows(file, "times, one a line", DatasetError):
        if len(fields) != 1:
            raise DatasetError(f"expected one time, found {len(fields)} columns", file, number)
        found.append(read_time(fields[0], file, number))
        if len(found) > 1 and found[-1] <= found[-2]:
            raise DatasetError(f"time {fields[0]} is not later than the previous one", file, number)
    return found


def likely_order(T_world_rig: Array, order: QuaternionOrder) -> QuaternionOrder:
    """The order in which quaternions make more sense: what drives or walks moves mostly one way in its own axes.

    With the components in the wrong order rotations are wrong but valid, and neither their size from one pose to the
    next nor anything else about them tells; the direction of travel in the rig's axes does, once the road bends. The
    other order is told only where this direction wanders in the given one and is steady in the other.

    Args:
        T_world_rig: (N, 4, 4) as read in ``order``.
    """
    from scipy.spatial.transform import Rotation  # imported late: loading takes a while

    quaternions = Rotation.from_matrix(T_world_rig[:, :3, :3]).as_quat()
    # The four numbers of each line, put into their places by the other order.
    turned = quaternions[:, [3, 0, 1, 2]] if order == "wxyz" else quaternions[:, [1, 2, 3, 0]]
    other = Rotation.from_quat(turned).as_matrix()
    steady = [_steadiness(T_world_rig[:, :3, 3], R) for R in (T_world_rig[:, :3, :3], other)]
    given, turned_round = steady
    if given is None or turned_round is None or given > _WANDERS or turned_round < _STEADY:
        return order
    if 1 - given < _BETTER * (1 - turned_round):
        return order
    return "xyzw" if order == "wxyz" else "wxyz"


def _steadiness(positions: Array, R_world_rig: Array) -> float | None:
    """Length of the mean of the unit directions of travel in the rig's axes, 0 to 1; None where little moves."""
    # Equal distances along the path: what stands still has no direction.
    chosen = spaced(positions, path_lengths(positions)[-1] / 1000)
    steps = np.diff(positions[chosen], axis=0)
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    if len(steps) < _FEWEST_STEPS or not lengths.all():
        return None
    directions = np.einsum("nji,nj->ni", R_world_rig[chosen[:-1]], steps)
    directions /= lengths
    return float(np.linalg.norm(directions.mean(axis=0)))


def path_lengths(positions: Array) -> Array:
    """Metres (N,) along a path from the first of its positions (N, 2 or 3), at least one, to each."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def spaced(positions: Array, apart_m: float) -> list[int]:
    """Rows of positions (N, 3) at least ``apart_m`` along the path from the one before, the first among them."""
    rows, last = [], -np.inf
    for row, metres in enumerate(path_lengths(positions).tolist()):
        if metres - last >= apart_m - 1e-9:
            rows.append(row)
            last = metres
    return rows
