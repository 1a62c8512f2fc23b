"""Tables of poses by time: one unit of time, times that increase, and rows without a pose, whatever the columns.

A row whose pose is not finite, such as one of NaN, says that there is no pose at its time: it is left out and counted
in a note. So is a row that repeats the one before. A time that goes back is an error: two runs in one file must not be
sorted into one another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.pairfile import QUATERNION_TOLERANCE, missing
from relocbench.datasets.motion.orientation import QuaternionOrder
from relocbench.datasets.sensors.matrices import POSE_ENTRIES, rotations_at_fault
from relocbench.datasets.sensors.pose_columns import read_pose_columns
from relocbench.datasets.sensors.times import times_in_ns, times_in_unit
from relocbench.errors import DatasetError
from relocbench.files import parse_floats, quick_floats, read_rows
from relocbench.geometry import make_transform, project_to_rotation, transform_from_tq
from relocbench.progress import SILENT, Reporter

_SAME = 1e-6
"""largest difference between the numbers of two rows that are one"""


class Row(NamedTuple):
    """A row of a table."""

    line: int
    fields: list[str]
    """in a table of poses the numbers of the pose"""
    time: str = ""
    """as it stands; empty where the time is known otherwise"""


@dataclass(frozen=True, eq=False)
class PoseTable:
    """The poses of a table."""

    path: Path
    times_ns: Times
    """(N,) strictly increasing"""
    transforms: Array
    """(N, 4, 4)"""
    lines: Sequence[int] = ()
    """(N,) where each pose stands; empty where it is in no line of a text"""
    breaks: tuple[int, ...] = ()
    """rows of poses before which nobody knows the way: after a jump, a hole, or poses that were left out"""

    @property
    def by_time(self) -> dict[int, Array]:
        """timestamp_ns -> (4, 4), in time order."""
        return dict(zip(self.times_ns.tolist(), self.transforms, strict=True))


class PoseFault(ValueError):
    """The numbers of a row are no pose."""

    def __init__(self, row: int, message: str) -> None:
        self.row = row
        super().__init__(message)


@dataclass(frozen=True)
class PoseNumbers:
    """How the numbers of a row make a pose."""

    names: str
    """of the numbers, parted by blanks"""
    transforms: Callable[[Array], Array]
    """makes (N, 4, 4) of (N, M) numbers; raises :class:`PoseFault`"""


def _of_quaternions(values: Array) -> Array:
    norms = np.linalg.norm(values[:, 3:], axis=1)
    off = np.flatnonzero(np.abs(norms - 1.0) > QUATERNION_TOLERANCE)
    if off.size:
        raise PoseFault(int(off[0]), f"quaternion qx qy qz qw has norm {norms[off[0]]:.6g}, expected 1")
    return transform_from_tq(values[:, :3], values[:, 3:])


def _of_matrices(values: Array) -> Array:
    matrices = values.reshape(-1, 3, 4)
    off = rotations_at_fault(matrices[:, :, :3])
    if off.size:
        raise PoseFault(int(off[0]), "the upper left 3x3 of the matrix is not a rotation")
    return make_transform(project_to_rotation(matrices[:, :, :3]), matrices[:, :, 3])


TQ = PoseNumbers("tx ty tz qx qy qz qw", _of_quaternions)
MATRIX = PoseNumbers(POSE_ENTRIES, _of_matrices)


def pose_table(
    rows: Sequence[Row],
    kind: PoseNumbers,
    path: Path,
    reporter: Reporter = SILENT,
    *,
    own_ns: int = 1,
    unit_ns: int | None = None,
    times: Sequence[int] | None = None,
) -> PoseTable:
    """The poses of rows.

    Args:
        reporter: is told which rows were left out, and of a unit of time that was told from digits.
        own_ns: nanoseconds of the unit that the format gives whole numbers (:func:`times_in_ns`).
        unit_ns: nanoseconds of the unit that the table itself names.
        times: nanoseconds of the rows, where these do not follow from their text.

    Raises:
        DatasetError: with file and line: a field that is not a number or a time, a rotation that is none, a time that
            goes back, or two poses at one time.
    """
    posed = [
        i for i, row in enumerate(rows) if not missing(row.fields if times is not None else [row.time, *row.fields])
    ]
    chosen = [rows[i] for i in posed]
    if len(chosen) < len(rows):
        first = next(row.line for i, row in enumerate(rows) if i >= len(posed) or posed[i] != i)
        count = len(rows) - len(chosen)
        reporter.note(f"{short_name(path)}: {count} of {len(rows)} rows have no pose (NaN), the first is line {first}")
    if times is not None:
        ns = [times[i] for i in posed]
    elif unit_ns is not None:
        ns = times_in_unit([row.time for row in chosen], lambda i: (path, chosen[i].line), unit_ns)
    else:
        read = times_in_ns([row.time for row in chosen], lambda i: (path, chosen[i].line), own_ns)
        ns = read.ns
        if read.by_digits:
            reporter.note(f"{short_name(path)}: times are read as {read.unit}, told by their number of digits")
    values = _values(chosen, kind, path)
    kept, repeated = _in_order(chosen, ns, values, path)
    if repeated:
        message = f"{len(repeated)} rows repeat the one before and are left out, the first is line {repeated[0]}"
        reporter.note(f"{short_name(path)}: {message}")
    lines = [chosen[i].line for i in kept]
    try:
        transforms = kind.transforms(values[kept]) if kept else np.zeros((0, 4, 4))
    except PoseFault as bad:
        raise DatasetError(str(bad), path, lines[bad.row]) from None
    return PoseTable(path, np.array([ns[i] for i in kept], dtype=np.int64), transforms, lines)


def _values(rows: Sequence[Row], kind: PoseNumbers, path: Path) -> Array:
    """The numbers (N, M) of rows."""
    width = len(kind.names.split())
    quick = None
    if all(len(row.fields) == width for row in rows):
        quick = quick_floats([field for row in rows for field in row.fields])
    if quick is None:
        quick = [value for row in rows for value in parse_floats(row.fields, path, row.line, kind.names, DatasetError)]
    return np.array(quick, dtype=np.float64).reshape(-1, width)


def _in_order(rows: Sequence[Row], ns: Sequence[int], values: Array, path: Path) -> tuple[list[int], list[int]]:
    """Indices of the rows to keep, and lines of those that repeat the one before. Raises DatasetError."""
    kept: list[int] = []
    repeated: list[int] = []
    for index, time in enumerate(ns):
        last = kept[-1] if kept else None
        if last is None or time > ns[last]:
            kept.append(index)
            continue
        row, before = rows[index], rows[last]
        if time < ns[last]:
            message = f"time {row.time or time} is not later than {before.time or ns[last]} on line {before.line}"
            raise DatasetError(f"{message}; expected times that increase, and one run a file", path, row.line)
        if np.abs(values[index] - values[last]).max() > _SAME:
            raise DatasetError(
                f"time {row.time or time} is that of line {before.line}, which has another pose", path, row.line
            )
        repeated.append(row.line)
    return kept, repeated


def short_name(path: Path) -> str:
    """The file and its folder, for notes."""
    return f"{path.parent.name}/{path.name}" if path.parent.name else path.name


def read_trajectory(
    path: Path,
    order: QuaternionOrder | None = None,
    reporter: Reporter = SILENT,
    *,
    own_ns: int = 1,
) -> PoseTable:
    """Read a table ``t tx ty tz qx qy qz qw`` (TUM), or one whose header names these columns, in any order.

    Args:
        order: order of the quaternion's components; None: as the header says, or ``xyzw``.
        reporter, own_ns: as of :func:`pose_table`.

    Raises:
        DatasetError: as :func:`~.pose_columns.read_pose_columns` and :func:`pose_table`, or the header names the
            quaternion's components in another order than ``order``.
    """
    columns = f"t tx ty tz {' '.join('q' + c for c in order or 'xyzw')}"
    header, found = read_pose_columns(path, f"a trajectory ({columns})")
    if header is not None and order not in (None, header.order):
        raise DatasetError(
            f"its header names {header.quaternion}, but quaternions are to be read as {order}", path, header.line
        )
    rows = []
    for line, fields in found:
        if len(fields) != 8:
            raise DatasetError(f"expected 8 columns ({columns}), found {len(fields)}", path, line)
        turned = header is None and order == "wxyz"
        rows.append(Row(line, [*fields[1:4], *fields[5:], fields[4]] if turned else fields[1:], fields[0]))
    if header is not None and header.order != "xyzw":
        reporter.note(
            f"{short_name(path)}: quaternions are read in the order that line {header.line} names: {header.quaternion}"
        )
    unit_ns = None if header is None else header.unit_ns
    return pose_table(rows, TQ, path, reporter, own_ns=own_ns, unit_ns=unit_ns)


def read_matrix_rows(
    path: Path, reporter: Reporter, time_of: Callable[[str, Path, int], int | None] | None = None
) -> PoseTable:
    """Read rows of a time and the upper three rows of a pose, between commas or spaces.

    Args:
        time_of: nanoseconds of the first field of a row, with file and line, where this is no time; None leaves the
            row out.
        reporter: as of :func:`pose_table`.

    Raises:
        DatasetError: as :func:`pose_table`.
    """
    names = f"time {POSE_ENTRIES}"
    rows = []
    for line, (time, *fields) in read_rows(path, f"poses ({names})", DatasetError):
        if len(fields) != 12:
            raise DatasetError(f"expected 13 columns ({names}), found {len(fields) + 1}", path, line)
        rows.append(Row(line, fields, time))
    if time_of is None:
        return pose_table(rows, MATRIX, path, reporter)
    known = [(ns, row) for row in rows if (ns := time_of(row.time, path, row.line)) is not None]
    return pose_table([row for _, row in known], MATRIX, path, reporter, times=[ns for ns, _ in known])
