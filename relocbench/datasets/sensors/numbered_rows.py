"""Tables whose rows belong to frames by their number: row 0 to frame 0, row 1 to frame 1, and so on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.core.pairfile import any_non_finite
from relocbench.datasets.sensors.pose_columns import is_value
from relocbench.datasets.sensors.pose_tables import Row
from relocbench.datasets.sensors.times import check_increasing, times_in_ns
from relocbench.errors import DatasetError
from relocbench.files import fields_of, lines_of, read_text, whole_number


@dataclass(frozen=True, eq=False)
class NumberedRows:
    """The rows of a table by the number of their frame."""

    path: Path
    rows: Sequence[Row | None]
    """None where the line is empty, or its values are commented out: the frame was lost. The last one has values"""
    spare: int
    """empty lines at the end, which may belong to frames or not"""

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def filled(self) -> dict[int, Row]:
        """The rows with values by the number of their frame."""
        return {number: row for number, row in enumerate(self.rows) if row is not None}

    def check_covers(self, frames: int, what: str) -> None:
        """Raise DatasetError if there are fewer rows than frames, so that no one can tell which are missing.

        Args:
            frames: their number, or one more than that of the last one.
            what: that there are so many of, such as ``images``.
        """
        if len(self) + self.spare < frames:
            message = f"holds {len(self)} rows, but {what} go up to number {frames - 1}"
            raise DatasetError(f"{message}; expected {frames} rows or more, empty ones for lost frames", self.path)

    def check_agrees(self, other: NumberedRows) -> None:
        """Raise DatasetError if the numbers of rows differ, so that no one can tell which of either are missing."""
        if max(len(self), len(other)) > min(len(self) + self.spare, len(other) + other.spare):
            message = f"holds {len(self)} rows, but {other.path.name} {len(other)}"
            raise DatasetError(f"{message}; expected a row for each frame, empty ones for lost frames", self.path)

    def of_files(self, files: Sequence[Path]) -> list[int]:
        """The number of the row of each file: its place among them, or the number in its name.

        Raises:
            DatasetError: there are not as many rows as files, nor as many as their names count to, from 0 or 1.
        """
        if self._may_be(len(files)):
            return list(range(len(files)))
        numbers = [-1 if (number := whole_number(path.stem)) is None else number for path in files]
        for first in (0, 1):
            if min(numbers) >= first and self._may_be(max(numbers) + 1 - first):
                return [number - first for number in numbers]
        message = f"holds {len(self)} rows for {len(files)} files"
        raise DatasetError(
            f"{message}; expected a row for each, or for each number, empty ones for lost ones", self.path
        )

    def _may_be(self, count: int) -> bool:
        """Whether there may be so many rows."""
        return len(self) <= count <= len(self) + self.spare


def read_numbered_rows(path: Path, what: str) -> NumberedRows:
    """Read a table; commas or spaces part fields.

    A first line of words is a header. Comments are no rows, except for those of numbers alone, as many as a row has:
    rows that somebody took out.

    Raises:
        DatasetError: with file and line: the file is missing or no text, or has decimal commas.
    """
    found: list[Row | str | None] = []
    started = False
    for number, line in enumerate(lines_of(read_text(path, what, DatasetError)), start=1):
        content, mark, comment = line.partition("#")
        fields = fields_of(content, path, number, DatasetError)
        if fields and not started and not any(map(is_value, fields)):
            found = []  # what is above a header is no row either
        else:
            found.append(Row(number, fields) if fields else comment if mark else None)
            started = started or bool(fields)
    width = next((len(row.fields) for row in found if isinstance(row, Row)), 0)
    rows = [row if isinstance(row, Row) else None for row in found if not _is_remark(row, width)]
    filled = max((index + 1 for index, row in enumerate(rows) if row is not None), default=0)
    return NumberedRows(path, rows[:filled], len(rows) - filled)


def _is_remark(row: Row | str | None, width: int) -> bool:
    """Whether a line is a comment that is no row which somebody took out."""
    if not isinstance(row, str):
        return False
    words = row.replace(",", " ").split()
    return len(words) != width or not all(word[:1] in "0123456789+-." for word in words)


def read_numbered_times(
    path: Path, own_ns: int = 1, *, dates_only: bool = False
) -> tuple[NumberedRows, dict[int, int], str]:
    """Times of frames, one a line: the rows, the nanoseconds by frame where there is a time, and the unit in words.

    A time that is not finite, such as NaN, is none.

    Args:
        own_ns, dates_only: as of :func:`~.times.times_in_ns`.

    Raises:
        DatasetError: with file and line: a row is not one time, times do not increase, or the file is missing.
    """
    rows = read_numbered_rows(path, "times, one a line")
    for row in rows.filled.values():
        if len(row.fields) != 1:
            raise DatasetError(f"expected one time, found {len(row.fields)} columns", path, row.line)
    timed = {number: row for number, row in rows.filled.items() if not any_non_finite(row.fields)}
    lines = [row.line for row in timed.values()]
    texts = [row.fields[0] for row in timed.values()]
    read = times_in_ns(texts, lambda i: (path, lines[i]), own_ns, dates_only=dates_only)
    check_increasing(read.ns, texts, path, lines)
    return rows, dict(zip(timed, read.ns, strict=True)), read.unit
