"""The log of a training: ``log.csv`` and ``validation.csv``."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path

from baselines.files import write_whole
from relocbench.errors import MethodError, quoted

_STEP = "step"
_MOST_DIGITS = 18
SECONDS = "seconds"
"""the only column that differs from one run to the next"""

Row = dict[str, str]


class Table:
    """A CSV file whose rows begin with a step; it is rewritten at each row.

    Args:
        path: of the file.
        upto: rows of later steps, left by a training that was killed, are dropped.

    Raises:
        MethodError: the existing file is not such a table; file and line are named.
    """

    def __init__(self, path: Path, upto: int) -> None:
        self.path = path
        self.rows: list[Row] = []
        if path.exists() and upto:
            self.rows = [row for row in _rows_of(path) if int(row[_STEP]) <= upto]

    def add(self, *rows: Mapping[str, float | int | str]) -> None:
        """Append rows; a new column stays empty in earlier rows."""
        self.rows += [{key: _text(value) for key, value in row.items()} for row in rows]
        columns = list(dict.fromkeys(key for row in self.rows for key in row))
        text = io.StringIO()
        table = csv.DictWriter(text, columns, restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(self.rows)
        write_whole(self.path, text.getvalue())


def _rows_of(path: Path) -> Iterator[Row]:
    """The rows of a table."""
    lines = _lines_of(path)
    columns = lines[0][1] if lines else []
    if _STEP not in columns or len(set(columns)) != len(columns):
        raise MethodError(
            f"expected a header with '{_STEP}' and no column twice; remove the file to begin a new log", path, 1
        )
    for line, fields in lines[1:]:
        if len(fields) != len(columns):
            raise MethodError(f"expected {len(columns)} columns, found {len(fields)}", path, line)
        row = dict(zip(columns, fields, strict=True))
        if not (row[_STEP].isascii() and row[_STEP].isdigit() and len(row[_STEP]) <= _MOST_DIGITS):
            raise MethodError(f"step is {quoted(row[_STEP])}, expected a whole number", path, line)
        yield row


def _lines_of(path: Path) -> list[tuple[int, list[str]]]:
    """The line, counted from 1, and the fields of each row."""
    if not path.is_file():  # reading a pipe might never end
        raise MethodError("is not a regular file; expected the log of a training", path)
    try:
        rows = csv.reader(io.StringIO(path.read_bytes().decode("utf-8"), newline=""), strict=True)
        return [(rows.line_num, row) for row in rows]
    except (UnicodeDecodeError, csv.Error) as bad:
        raise MethodError(f"not a CSV table ({bad}); expected the log of a training", path) from None


class Window:
    """Means of values over the steps since the last row of the log.

    Args:
        sums, steps: the state in a checkpoint.
    """

    def __init__(self, sums: Mapping[str, float] | None = None, steps: int = 0) -> None:
        self.sums: dict[str, float] = dict(sums or {})
        self.steps = steps

    def add(self, values: Mapping[str, float]) -> None:
        """Add the values of one step."""
        for name, value in values.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        self.steps += 1

    def take(self) -> dict[str, float]:
        """The means; afterwards the window is empty."""
        means = {name: value / self.steps for name, value in self.sums.items()}
        self.sums, self.steps = {}, 0
        return means


def _text(value: float | int | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
