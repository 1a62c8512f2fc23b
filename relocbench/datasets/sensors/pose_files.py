"""Files of poses alone in the formats that SLAM systems and data sets write, told apart by their columns.

=======  ==========================================================================================================
columns  what a line holds
=======  ==========================================================================================================
8        ``t tx ty tz qx qy qz qw`` (TUM), or ``t tx ty tz qw qx qy qz``, which the user or a header tells
any      a header that names the columns of a time and a pose in any order, such as that of ``poses.csv``, and its rows
12       the upper three rows of a pose (KITTI); times are in a file of their own
13       a time, and the same
=======  ==========================================================================================================
"""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.motion.orientation import QuaternionOrder
from relocbench.datasets.sensors.numbered_rows import read_numbered_rows, read_numbered_times
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_columns import read_pose_columns
from relocbench.datasets.sensors.pose_tables import (
    MATRIX,
    PoseTable,
    pose_table,
    read_matrix_rows,
    read_trajectory,
    short_name,
)
from relocbench.errors import DatasetError
from relocbench.progress import SILENT, Reporter

_EXPECTED = (
    "expected 8 columns (t tx ty tz and a quaternion), 12 (the upper three rows of a pose) or 13 (a time before them)"
)


def read_pose_file(
    path: Path,
    order: QuaternionOrder | None = None,
    times: Path | None = None,
    reporter: Reporter = SILENT,
) -> PoseTable:
    """Read a file of poses ``T_world_rig`` of a drive, without rows that have no pose and without outliers.

    Args:
        order: order of the quaternion's components; None: as a header says, or ``xyzw``.
        times: file with the time of each line, for poses without times; default: ``STEM.times.txt`` beside the file.
        reporter: is told which rows were left out, and what is implausible.

    Raises:
        DatasetError: with file and line: a wrong number of columns, a header that names another order than ``order``, a
            field that is not a number, a rotation that is none, times that go back, no pose at all, or
            poses that cannot be those of a drive.
    """
    if path.is_dir():
        raise DatasetError("is a folder; expected a file of poses", path)
    _, rows = read_pose_columns(path, _EXPECTED.removeprefix("expected "))
    if not rows:
        raise DatasetError(f"holds no pose; {_EXPECTED}", path)
    line, fields = rows[0]
    if len(fields) == 8:
        poses = read_trajectory(path, order, reporter=reporter)
    elif len(fields) == 12:
        poses = _matrices_of_frames(path, times or _beside(path), reporter)
    elif len(fields) == 13:
        poses = read_matrix_rows(path, reporter)
    else:
        raise DatasetError(f"{_EXPECTED}, found {len(fields)}", path, line)
    if not len(poses.times_ns):
        raise DatasetError("holds no pose", path)
    return plausible(poses, reporter)


def _matrices_of_frames(path: Path, times: Path, reporter: Reporter) -> PoseTable:
    """Poses of twelve numbers a line, with their times in the same lines of another file."""
    if times == _beside(path) and not times.exists():
        raise DatasetError(
            f"12 columns are poses without times; expected {times.name} beside it, or --times FILE", path
        )
    rows = read_numbered_rows(path, "a file of poses")
    timed, time_of, _ = read_numbered_times(times)
    timed.check_agrees(rows)
    both = {number: row for number, row in rows.filled.items() if number in time_of}
    found = pose_table(list(both.values()), MATRIX, path, reporter, times=[time_of[number] for number in both])
    if len(both) < len(rows):
        reporter.note(f"{short_name(path)}: {len(rows) - len(both)} of {len(rows)} frames are without a pose or a time")
    return found


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.stem}.times.txt")
