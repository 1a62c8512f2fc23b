"""The log of a training: rows of ``log.csv`` and ``validation.csv``, which a person can plot."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path

from baselines.files import write_whole

TIMED = "seconds"
"""the one column that differs from one run to the next"""

Row = dict[str, str]


class Table:
    """A CSV file whose rows begin with a step; it is written whole at each row.

    Args:
        path: of the file.
        upto: rows of later steps, left by a training that was killed, are dropped.
    """

    def __init__(self, path: Path, upto: int) -> None:
        self.path = path
        self.rows: list[Row] = []
        if path.exists() and upto:
            with path.open(newline="", encoding="utf-8") as stream:
                self.rows = [row for row in csv.DictReader(stream) if int(row["step"]) <= upto]

    def add(self, *rows: Mapping[str, float | int | str]) -> None:
        """Append rows; a column that is new stays empty in the rows before."""
        self.rows += [{key: _text(value) for key, value in row.items()} for row in rows]
        columns = list(dict.fromkeys(key for row in self.rows for key in row))
        text = io.StringIO()
        table = csv.DictWriter(text, columns, restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(self.rows)
        write_whole(self.path, text.getvalue())


class Window:
    """Means over the steps since the last row.

    Args:
        sums, steps: as they stood in a checkpoint.
    """

    def __init__(self, sums: Mapping[str, float] | None = None, steps: int = 0) -> None:
        self.sums: dict[str, float] = dict(sums or {})
        self.steps = steps

    def add(self, values: Mapping[str, float]) -> None:
        """The values of one step."""
        for name, value in values.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        self.steps += 1

    def take(self) -> dict[str, float]:
        """The means; the window is empty afterwards."""
        means = {name: value / self.steps for name, value in self.sums.items()}
        self.sums, self.steps = {}, 0
        return means


def _text(value: float | int | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
