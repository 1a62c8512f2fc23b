"""The columns of a task's tables, each defined once; CSV, JSON, pages and the terminal show those that they name.

In CSV and JSON shares are 0 to 1 and a column is called by its key; on pages and on the terminal shares are in percent,
and the heading says so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from relocbench.leaderboard.common.model import Method, Row, rank_text
from relocbench.leaderboard.common.text import COUNTS, RANK, Value, heading, with_bounds
from relocbench.metrics import Interval

B = TypeVar("B")
T = TypeVar("T", bound="Ranked")
R = TypeVar("R", bound=Row[Method])
L_contra = TypeVar("L_contra", contravariant=True)


class Ranked(Protocol):
    """A table."""

    @property
    def rows(self) -> Sequence[Row[Method]]: ...


@dataclass(frozen=True, eq=False)
class Line(Generic[B, T, R]):
    """A line of a table, with the table and the set that it is of."""

    set: B
    table: T
    row: R | None
    """None for what chance scores"""

    def value(self, metric: str) -> float | None:
        """A number of the row; None where there is none."""
        return None if self.row is None else self.row.values.get(metric)

    def interval(self, metric: str) -> Interval | None:
        return None if self.row is None else self.row.intervals.get(metric)

    def of_row(self, value: Callable[[R], Value]) -> Value:
        """What the row has besides its numbers; None where there is no row."""
        return None if self.row is None else value(self.row)


@dataclass(frozen=True, eq=False)
class Column(Generic[L_contra]):
    """A column: what it is called and what it holds."""

    key: str
    value: Callable[[L_contra], Value]
    unit: str = ""
    """share, m, deg or s; empty for what is shown as it is"""
    shown: Callable[[L_contra], str] | None = None
    """the text for people, if it is another than that of the value in its unit"""
    bounds: Callable[[L_contra], Interval | None] | None = None
    """the interval that pages show behind the value"""
    definition: str = ""
    """what the number is, in words"""
    higher_is_better: bool | None = None
    for_programs: bool = True
    """whether CSV and JSON have it: not where it puts several of their columns into one cell"""

    @property
    def heading(self) -> str:
        return heading(self.key, self.unit)

    def text(self, line: L_contra, *, bounds: bool = True) -> str:
        """The cell for people, with its interval."""
        if self.shown is not None:
            return self.shown(line)
        value = self.value(line)
        if not self.unit:
            return "" if value is None else str(value)
        assert value is None or isinstance(value, int | float)
        interval = self.bounds(line) if bounds and self.bounds is not None else None
        return with_bounds(value, interval, self.unit)


def by_key(columns: Iterable[Column[L_contra]]) -> dict[str, Column[L_contra]]:
    """The columns by their keys, in their order; of one that is given twice the first."""
    out: dict[str, Column[L_contra]] = {}
    for column in columns:
        out.setdefault(column.key, column)
    return out


class HasIntervals(Protocol):
    """A line with numbers that have intervals."""

    def interval(self, metric: str) -> Interval | None: ...


def bounds_columns(metrics: Iterable[str]) -> list[Column[HasIntervals]]:
    """The two bounds of the intervals of some metrics, as columns of their own."""
    return [_bound(metric, end) for metric in metrics for end in ("low", "high")]


def _bound(metric: str, end: str) -> Column[HasIntervals]:
    return Column(f"{metric}_{end}", lambda line: getattr(line.interval(metric), end, None), "share")


def number_column(
    key: str,
    unit: str = "share",
    *,
    definition: str = "",
    higher_is_better: bool | None = None,
    value: Callable[[Line[B, T, R]], Value] | None = None,
) -> Column[Line[B, T, R]]:
    """A number of the rows, with its interval where they have one.

    Args:
        value: where it is another than that of the row, such as what chance scores.
    """
    return Column(
        key,
        value or (lambda line: line.value(key)),
        unit,
        bounds=lambda line: line.interval(key),
        definition=definition,
        higher_is_better=higher_is_better,
    )


def rank_column() -> Column[Line[B, T, R]]:
    """Ranks, which are not shown where all methods share one."""

    def shown(line: Line[B, T, R]) -> str:
        return "" if line.row is None else rank_text(line.row, line.table.rows)

    return Column(RANK, lambda line: line.of_row(lambda row: row.rank), shown=shown)


def family_column() -> Column[Line[B, T, R]]:
    """The method that stands for a method and its near-copies where ranks count methods."""
    return Column("family", lambda line: line.of_row(lambda row: row.family[0] if row.family else None))


def counts_column() -> Column[Line[B, T, R]]:
    """How many answers a method declined, and on how many it crashed, in one cell."""

    def shown(line: Line[B, T, R]) -> str:
        return "" if line.row is None or line.row.missing else f"{line.row.failed} / {line.row.broke}"

    return Column(COUNTS, lambda line: None, shown=shown, for_programs=False)


def records(columns: Iterable[Column[L_contra]], lines: Iterable[L_contra]) -> list[dict[str, Value]]:
    """The rows of CSV and JSON."""
    chosen = [column for column in columns if column.for_programs]
    return [{column.key: column.value(line) for column in chosen} for line in lines]


def texts(columns: Sequence[Column[L_contra]], lines: Iterable[L_contra]) -> tuple[list[str], list[list[str]]]:
    """The headings and the cells of a table for people."""
    return [column.heading for column in columns], [[column.text(line) for column in columns] for line in lines]
