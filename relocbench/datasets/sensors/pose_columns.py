"""The columns of a table of poses: those that its header names, in any order, or those of the format."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from relocbench.errors import DatasetError
from relocbench.files import fields_of, lines_of, read_text

POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TIME = re.compile(
    r"((field|pose|header|stamp)\.)*(t|ts|time|times|timestamp|timestamps|stamp|gpstime|n?secs?|(nano)?seconds)"
    r"([._ ](ns|nsec|us|ms|s|sec))?"
)
_UNIT_NS = {"ns": 1, "nsec": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "sec": 10**9}
_POSITION = re.compile(r"(.*\.)?(|t|p|tran|trans|translation|pos|position|loc|location|p_[a-z0-9_]+)")
_QUATERNION = re.compile(r"(.*[._])?(q|quat|quaternion|orientation|rot|rotation)|q_[a-z0-9_]+")
_UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]")
_LONGEST = 4000
"""characters of a header; searching a longer text for names and units could take long"""
_STAMP = "header.stamp"
"""of the two times of a message that rostopic writes, the one that the sensor gave it"""


@dataclass(frozen=True)
class Header:
    """A header that names the columns of a pose."""

    line: int
    count: int
    """columns that it names"""
    time: int
    """column of the time, the first where none is named"""
    pose: tuple[int, ...]
    """columns of x, y, z, qx, qy, qz, qw"""
    unit_ns: int | None
    """nanoseconds of the unit of times, if it is named"""

    @property
    def columns(self) -> tuple[int, ...]:
        """Those of the time and of the pose."""
        return self.time, *self.pose

    def others(self, count: int) -> tuple[int, ...]:
        """The other ones of so many."""
        return tuple(column for column in range(count) if column not in self.columns)

    @property
    def order(self) -> str:
        """The components of the quaternion in the order of their columns, such as ``wxyz``."""
        return "".join(axis for _, axis in sorted(zip(self.pose[3:], "xyzw", strict=True)))

    @property
    def quaternion(self) -> str:
        """The same as names of columns, such as ``qw qx qy qz``."""
        return " ".join(f"q{axis}" for axis in self.order)


def read_pose_columns(
    path: Path, what: str, *, more: bool = False
) -> tuple[Header | None, list[tuple[int, list[str]]]]:
    """The header of a table, if it names the columns of a pose, and line and fields of each row.

    A header is the first line, if it holds no number, or a comment before the first row. Under a header a row is
    its time and its fields in the order of :data:`POSE`, without one its fields as they stand.

    Args:
        what: the columns of a table without header, for messages.
        more: rows go on with the other fields, of which there need not be as many as the header names.

    Raises:
        DatasetError: with file and line: another number of columns than the header names, a header that does not name
            the columns of a pose, or decimal commas.
    """
    header: Header | None = None
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines_of(read_text(path, what, DatasetError)), start=1):
        content, _, comment = line.partition("#")
        fields = fields_of(content, path, number, DatasetError)
        if not fields:
            if not rows:
                header = parse_header(comment, number) or header
        elif not rows and header is None and not any(map(is_value, fields)):
            header = parse_header(content, number)
            if header is None:
                raise DatasetError(f"its header does not name the columns of a pose; expected {what}", path, number)
        else:
            if header is not None:
                others = header.others(len(fields)) if more else ()
                fields = fields if more else _as_many(content, fields, header, path, number)
                if len(fields) <= max(header.columns):
                    raise DatasetError(
                        f"expected the columns that line {header.line} names, found {len(fields)}", path, number
                    )
                fields = [fields[column] for column in (*header.columns, *others)]
            rows.append((number, fields))
    return header, rows


def parse_header(text: str, line: int) -> Header | None:
    """The columns that a line names; None if it does not name those of a pose, each once."""
    if len(text) > _LONGEST:
        return None
    # A unit belongs to the name before it.
    words = text.split(",") if "," in text else re.sub(r"\s+(?=[\[(])", "", text).split()
    names = [word.strip(" \t%\"'").lower() for word in words]
    times: dict[int, int | None] = {}
    found: dict[str, int] = {}
    for column, name in enumerate(names):
        bare = _UNIT.sub("", name)
        unit, time = _UNIT.search(name), _TIME.fullmatch(bare)
        what = _meaning(bare)
        if time is not None:
            times[column] = _UNIT_NS.get(unit[1] if unit else time[6] or "")
        elif what in found:
            return None
        elif what:
            found[what] = column
    if len(times) > 1:
        times = {column: unit for column, unit in times.items() if names[column].endswith(_STAMP)}
        if len(times) != 1:
            return None
    if len(found) != len(POSE) or (not times and 0 in found.values()):
        return None
    column, unit_ns = next(iter(times.items()), (0, None))
    return Header(line, len(names), column, tuple(found[name] for name in POSE), unit_ns)


def _meaning(name: str) -> str:
    """The entry of :data:`POSE` that a column's name stands for; empty: none."""
    axis, stem = name[-1:], name[:-1].rstrip("._- ")
    if axis and axis in "xyzw" and _QUATERNION.fullmatch(stem):
        return f"q{axis}"
    return axis if axis and axis in "xyz" and _POSITION.fullmatch(stem) else ""


def is_value(text: str) -> bool:
    """Whether a field is, or is meant to be, a number."""
    return text[:1] in "0123456789+-." or text.lower() in ("nan", "inf", "infinity")


def _as_many(content: str, fields: list[str], header: Header, path: Path, line: int) -> list[str]:
    """The fields of a row. Raises DatasetError if there are not as many as the header names."""
    if len(fields) != header.count and content.count(",") == header.count - 1:
        fields = [field.strip() for field in content.split(",")]  # some are blank, or hold several words
    if len(fields) != header.count:
        message = f"expected {header.count} columns, as line {header.line} names them, found {len(fields)}"
        raise DatasetError(message, path, line)
    return fields
