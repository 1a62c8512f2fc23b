"""Names of traversals, files named by time, and TUM trajectories, which several recording formats share."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from relocbench.arrays import Array
from relocbench.datasets.core.layout import IMAGE_SUFFIXES
from relocbench.datasets.core.pairfile import parse_pose
from relocbench.errors import DatasetError, RelocbenchError, quoted
from relocbench.files import check_distinct, plain_name, read_rows, seconds_to_ns

QuaternionOrder = Literal["xyzw", "wxyz"]


def traversal_names(sources: Sequence[Path], endings: Sequence[str] = ()) -> list[str]:
    """A name for each source, that of its folder; characters that pair-set file names cannot hold become ``-``.

    Args:
        endings: of files that are recordings too, named without them; where there are any, nothing has to exist.

    Raises:
        DatasetError: there is no source, a source is not a folder, or two have the same name.
    """
    if not sources:
        raise DatasetError(f"no recording was given; expected one or more folders{' or files' if endings else ''}")
    names: dict[str, Path] = {}
    for source in sources:
        found = source.resolve()
        if not endings and not source.is_dir():
            raise DatasetError("no such folder; expected a recording", source)
        try:
            name = plain_name(found.stem if found.suffix in endings else found.name, "traversal name")
        except ValueError:
            raise DatasetError("its name cannot name a traversal; rename or link it", source) from None
        if name in names and names[name].resolve() == found:
            raise DatasetError("is given twice; expected different recordings", source)
        if name in names:
            raise DatasetError(f"is the second recording called '{name}' (first: {names[name]})", source)
        names[name] = source
    try:
        check_distinct(names, "recordings")
    except ValueError as bad:
        raise DatasetError(str(bad)) from None
    return list(names)


def parse_time(text: str) -> int:
    """Parse a time to nanoseconds: integers are nanoseconds, numbers with a decimal point or exponent are seconds.

    Raises:
        ValueError: the text is neither.
    """
    if re.fullmatch(r"[+-]?[0-9]+", text):
        if len(text) > 30 or abs(int(text)) >= 2**63:
            raise ValueError(f"{quoted(text, 30)} is out of range: integer nanoseconds must fit 64 bits")
        return int(text)
    if re.fullmatch(r"[+-]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(\.[0-9]*)?[eE][+-]?[0-9]+)", text):
        return seconds_to_ns(text)
    raise ValueError(f"{quoted(text)} is not a time: integer nanoseconds, or seconds with a decimal point")


def read_time(text: str, path: Path, line: int | None = None, error: type[RelocbenchError] = DatasetError) -> int:
    """As :func:`parse_time`. Raises ``error`` with file and line."""
    try:
        return parse_time(text)
    except ValueError as bad:
        raise error(str(bad), path, line) from None


def name_time(text: str, path: Path) -> int:
    """The time that a file's name states, as :func:`parse_time`. Raises DatasetError."""
    try:
        time = parse_time(text)
    except ValueError as bad:
        raise DatasetError(f"the file's name {bad}", path) from None
    if time < 0:
        raise DatasetError("the file's name is a time before 1970; expected nanoseconds or seconds", path)
    return time


def timed_files(
    folder: Path, suffixes: Sequence[str] = IMAGE_SUFFIXES, parse: Callable[[str, Path], int] = name_time
) -> dict[int, Path]:
    """The files of a folder by the times in their names, in time order; a missing folder has none.

    Other files and hidden ones are skipped.

    Args:
        parse: nanoseconds of a file's name without its suffix; raises DatasetError.

    Raises:
        DatasetError: a name is not a time, or two files have the same time.
    """
    if not folder.is_dir():
        return {}
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix.lower() not in suffixes:
            continue
        time = parse(path.stem, path)
        if time in found:
            raise DatasetError(f"has the same time as {found[time].name}", path)
        found[time] = path
    return dict(sorted(found.items()))


def read_trajectory(
    path: Path, order: QuaternionOrder = "xyzw", error: type[RelocbenchError] = DatasetError
) -> dict[int, Array]:
    """Read a TUM trajectory with lines ``t tx ty tz qx qy qz qw``: timestamp_ns -> (4, 4) pose, in the file's order.

    Args:
        order: order of the quaternion's components; some trajectories that are called TUM have ``wxyz``.
        error: the error class to raise.

    Raises:
        RelocbenchError: (as ``error``) with file and line: a wrong number of columns, a field that is not a number, a
            quaternion whose norm is not 1, or times that do not increase.
    """
    poses: dict[int, Array] = {}
    last: int | None = None
    columns = f"t tx ty tz {' '.join('q' + c for c in order)}"
    for line, fields in read_rows(path, f"a trajectory ({columns})", error):
        if len(fields) != 8:
            raise error(f"expected 8 columns ({columns}), found {len(fields)}", path, line)
        time = read_time(fields[0], path, line, error)
        if last is not None and time <= last:
            raise error(f"time {fields[0]} is not later than the previous one", path, line)
        quaternion = fields[4:] if order == "xyzw" else [*fields[5:], fields[4]]
        poses[time] = parse_pose([*fields[1:4], *quaternion], path, line, error)
        last = time
    return poses
