"""The tables of a results folder: written whole, and read row by row with typed fields, or in chunks of rows."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError
from relocbench.files import atomic_write, parse_count, parse_floats, parse_timestamp, read_table, read_table_chunks

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


def read_rows(path: Path, columns: Sequence[str]) -> Iterator[TableRow]:
    """Yield the rows of a table.

    Raises:
        PredictionError: with file and line: a wrong header, a row of another length, a field that cannot be read.
    """
    for line, row in read_table(path, columns, error=PredictionError):
        yield TableRow(path, line, dict(zip(columns, row, strict=True)))


def read_chunks(path: Path, columns: Sequence[str]) -> Iterator[tuple[list[int], list[list[str]]]]:
    """The rows of a long table in chunks: the line numbers that rows begin on, and their fields.

    Raises:
        PredictionError: as :func:`read_rows`.
    """
    return read_table_chunks(path, columns, error=PredictionError)


def write_rows(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write a CSV table, whose header is the first of ``rows``, whole or not at all."""
    with atomic_write(path) as stream:
        csv.writer(stream, lineterminator="\n").writerows(rows)


def float_text(value: float | None) -> str:
    """A float with all its digits; blank for None."""
    return "" if value is None else repr(float(value))


def seconds_text(value: float | None) -> str:
    """Seconds rounded to microseconds; blank for None."""
    return "" if value is None else repr(round(float(value), 6))
