"""A table of a results folder, stated once: a typed record, whose fields are the columns of the file.

What the cells of a column are, stands in the annotation of its field::

    @dataclass(frozen=True)
    class QueryAnswer(Record):
        query: Annotated[str, TEXT]
        positives: Annotated[int, COUNT]

    ANSWERS = Schema(QueryAnswer)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_type_hints

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError
from relocbench.files import (
    header_fault,
    parse_count,
    parse_floats,
    parse_timestamp,
    quick_counts,
    quick_floats,
    read_csv,
    read_table_chunks,
    write_table,
)

ALL = "all"
"""the group of all pairs of a set; and all start offsets together"""
STATUSES = ("ok", "failed", "error")
"""the method answered; it reported a failure; it raised, crashed or broke the contract"""
_YEAR_S = 366 * 86400.0
KEY_COLUMNS = ("ref_timestamp_ns", "query_timestamp_ns")


@dataclass(frozen=True)
class TableRow:
    """A row whose fields are read by name and type; each method raises PredictionError if the field is not valid."""

    path: Path
    line: int
    """1-based line number on which the row begins"""
    fields: Mapping[str, str]

    def __getitem__(self, name: str) -> str:
        return self.fields[name]

    def fault(self, message: str) -> PredictionError:
        """The error for a fault of this row."""
        return PredictionError(message, self.path, self.line)

    def timestamp(self, name: str) -> int:
        """An integer timestamp in nanoseconds."""
        return parse_timestamp(self[name], self.path, self.line, PredictionError)

    def key(self) -> PairKey:
        """The reference and query timestamp of a pair."""
        ref, query = map(self.timestamp, KEY_COLUMNS)
        return ref, query

    def count(self, name: str) -> int:
        """A whole number that is not negative."""
        return parse_count(self[name], name, self.path, self.line, PredictionError)

    def number(self, name: str) -> float:
        """A finite number."""
        return parse_floats([self[name]], self.path, self.line, name, PredictionError)[0]

    def number_or_none(self, name: str) -> float | None:
        """A finite number, or None for a blank field."""
        return self.number(name) if self[name] else None

    def seconds_or_none(self, name: str) -> float | None:
        """A time that a method took, from 0 to a year, or None for a blank field."""
        seconds = self.number_or_none(name)
        if seconds is not None and not is_duration(seconds):
            raise self.fault(f"{name} is {self[name][:60]}, expected a time of at least 0 and at most a year")
        return seconds

    def error(self, name: str) -> float:
        """An error: a number of at least 0, or ``inf``."""
        value = math.inf if self[name] == "inf" else self.number(name)
        if value < 0:
            raise self.fault(f"{name} is {self[name]}, expected an error of at least 0, or inf")
        return value


def is_duration(seconds: float) -> bool:
    """Whether a method can have taken so many seconds: from 0 to a year."""
    return 0 <= seconds <= _YEAR_S


def float_text(value: float | None) -> str:
    """A float with all its digits; blank for None."""
    return "" if value is None else repr(float(value))


def seconds_text(value: float | None) -> str:
    """Seconds rounded to microseconds; blank for None."""
    return "" if value is None else repr(round(float(value), 6))


T = TypeVar("T")


def _as_is(value: object) -> object:
    return value


def _never(texts: Sequence[str]) -> None:
    return None


@dataclass(frozen=True)
class Kind(Generic[T]):
    """What the cells of a column are."""

    read: Callable[[TableRow, str], T]
    """the value of a field of a row, by its name; raises PredictionError with file and line"""
    text: Callable[[T], object] = _as_is
    """what is written for a value"""
    quick: Callable[[Sequence[str]], Sequence[T] | None] = _never
    """the values of a whole column, many times as fast; None where one of its cells needs a closer look"""


def one_of(names: Sequence[str]) -> Kind[str]:
    """One of some words."""
    known = frozenset(names)

    def read(row: TableRow, name: str) -> str:
        if row[name] not in known:
            raise row.fault(f"{name} is '{row[name][:60]}', expected {', '.join(names)}")
        return row[name]

    return Kind(read, quick=lambda texts: texts if known.issuperset(texts) else None)


def or_blank(kind: Kind[T]) -> Kind[T | None]:
    """As another kind, or nothing at all."""

    def quick(texts: Sequence[str]) -> list[T | None] | None:
        filled = [text for text in texts if text]
        given = kind.quick(filled) if filled else []
        if given is None:
            return None
        values = iter(given)
        return [next(values) if text else None for text in texts]

    return Kind(
        lambda row, name: kind.read(row, name) if row[name] else None,
        lambda value: "" if value is None else kind.text(value),
        quick,
    )


def _quick_optional(texts: Sequence[str]) -> list[float | None] | None:
    values = quick_floats([text or "0" for text in texts])
    return None if values is None else [value if text else None for text, value in zip(texts, values, strict=True)]


def _quick_seconds(texts: Sequence[str]) -> list[float | None] | None:
    values = _quick_optional(texts)
    return None if values is None or not all(v is None or is_duration(v) for v in values) else values


TEXT = Kind(TableRow.__getitem__, quick=lambda texts: texts)
TIMESTAMP = Kind(TableRow.timestamp, quick=quick_counts)
"""nanoseconds"""
COUNT = Kind(TableRow.count, quick=quick_counts)
NUMBER = Kind(TableRow.number_or_none, float_text, _quick_optional)
"""a finite number with all its digits, or nothing"""
SECONDS = Kind(TableRow.seconds_or_none, seconds_text, _quick_seconds)
"""rounded to microseconds, or nothing"""
ERROR = Kind(TableRow.error, float_text)
"""a number of at least 0, or ``inf``"""
STATUS = one_of(STATUSES)


@dataclass(frozen=True)
class Record:
    """A row of a table."""

    @property
    def named(self) -> str:
        """What the row is of, of which a table has one row only; empty where it may have more."""
        return ""

    def contradiction(self) -> str | None:
        """What in the row does not fit together, in words."""
        return None


@dataclass(frozen=True)
class PairRecord(Record):
    """A row about a pair."""

    ref_timestamp_ns: Annotated[int, TIMESTAMP]
    query_timestamp_ns: Annotated[int, TIMESTAMP]

    @property
    def key(self) -> PairKey:
        """The reference and query timestamp."""
        return self.ref_timestamp_ns, self.query_timestamp_ns

    @property
    def named(self) -> str:
        return f"pair {self.ref_timestamp_ns} {self.query_timestamp_ns}"


R = TypeVar("R", bound=Record)


class Schema(Generic[R]):
    """The columns of a table, and its reading and writing, as a record states them."""

    def __init__(self, record: type[R], *, last_optional: bool = False) -> None:
        """State a table.

        Args:
            last_optional: whether a table that was made elsewhere may lack the last column, which is blank there.
        """
        hints = get_type_hints(record, include_extras=True)
        self._make: Callable[..., R] = record
        self._kinds: dict[str, Kind[Any]] = {f.name: hints[f.name].__metadata__[0] for f in fields(record)}
        self.columns: tuple[str, ...] = tuple(self._kinds)
        self._last_optional = last_optional

    def of(self, values: Iterable[object]) -> R:
        """The record with these values, in the order of the columns."""
        return self._make(*values)

    def write(self, path: Path, rows: Iterable[R]) -> None:
        """Write the table whole or not at all, in the order given."""
        texts = ([kind.text(getattr(row, name)) for name, kind in self._kinds.items()] for row in rows)
        write_table(path, self.columns, texts)

    def read(self, path: Path, keep: Callable[[Sequence[str]], bool] | None = None) -> list[R]:
        """Read the table.

        Args:
            keep: whether a row with these cells is read and checked, if not all are.

        Raises:
            PredictionError: with file and line: a wrong header, a field that cannot be read, a row that contradicts
                itself or occurs again.
        """
        out: list[R] = []
        seen: set[str] = set()
        for lines, rows in self.chunks(path):
            kept = [place for place, row in enumerate(rows) if keep is None or keep(row)]
            usual = self.together([rows[place] for place in kept])
            for number, place in enumerate(kept):
                row = self.row(path, lines[place], rows[place]) if usual is None else usual[number]
                named = row.named
                if named in seen:
                    raise PredictionError(f"{named} occurs again", path, lines[place])
                if named:
                    seen.add(named)
                out.append(row)
        return out

    def chunks(self, path: Path) -> Iterator[tuple[list[int], list[list[str]]]]:
        """The rows in chunks: the line numbers that they begin on, and their fields, blank where one is optional.

        Raises:
            PredictionError: with file and line: a wrong header, a row of another length.
        """
        head = next(read_csv(path, f"a table ({','.join(self.columns)})", PredictionError), (1, []))[1]
        lacking = self._lacking(head)
        columns = self.columns[: len(self.columns) - len(lacking)]
        for lines, rows in read_table_chunks(path, columns, error=PredictionError):
            yield lines, [[*row, *lacking] for row in rows] if lacking else rows

    def _lacking(self, head: Sequence[str]) -> list[str]:
        """A blank for the last column where a table with this header lacks it, and may."""
        return [""] if self._last_optional and tuple(head) == self.columns[:-1] else []

    def row(self, path: Path, line: int, texts: Sequence[str]) -> R:
        """One row. Raises PredictionError with file and line."""
        cells = self._cells(path, line, texts)
        row = self._make(*(kind.read(cells, name) for name, kind in self._kinds.items()))
        wrong = row.contradiction()
        if wrong is not None:
            raise cells.fault(wrong)
        return row

    def together(self, rows: Sequence[Sequence[str]]) -> list[R] | None:
        """Rows by whole columns, many times as fast as :meth:`row`; None where one of them needs a closer look."""
        if not rows:
            return []
        columns = []
        for kind, texts in zip(self._kinds.values(), zip(*rows, strict=True), strict=True):
            values = kind.quick(texts)
            if values is None:
                return None
            columns.append(values)
        made = list(map(self._make, *columns))
        return None if any(row.contradiction() is not None for row in made) else made

    def readable(self, path: Path, findings: Findings) -> Iterator[tuple[TableRow, R | None]]:
        """Each row with its record, None where it has a fault; all that is wrong with the table becomes a fault."""
        first = dict[str, int]()
        with findings.catching():
            rows = read_csv(path, f"a table ({','.join(self.columns)})", PredictionError)
            header = next(rows, (1, []))[1]
            lacking = self._lacking(header)
            if not lacking and tuple(header) != self.columns:
                raise PredictionError(header_fault(self.columns, header), path, 1)
            for line, row_texts in rows:
                texts = [*row_texts, *lacking]
                if len(texts) != len(self.columns):
                    findings.fault(f"expected {len(header)} columns, found {len(row_texts)}", path, line)
                    continue
                cells, values = self._cells(path, line, texts), []
                for name, kind in self._kinds.items():
                    with findings.catching():
                        values.append(kind.read(cells, name))
                row = self._make(*values) if len(values) == len(self.columns) else None
                if row is not None and (wrong := row.contradiction()) is not None:
                    findings.fault(wrong, path, line)
                    row = None
                if row is not None and row.named and first.setdefault(row.named, line) != line:
                    findings.fault(f"{row.named} occurs again (first on line {first[row.named]})", path, line)
                yield cells, row

    def check(self, path: Path, findings: Findings) -> None:
        """Record all that is wrong with the table."""
        for _ in self.readable(path, findings):
            pass

    def _cells(self, path: Path, line: int, texts: Sequence[str]) -> TableRow:
        return TableRow(path, line, dict(zip(self.columns, texts, strict=True)))
