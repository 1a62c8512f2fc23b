"""CSV tables: every row with the line it begins on, whatever its quoted fields hold."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, TypeVar

from relocbench.errors import RelocbenchError
from relocbench.files.numbers import parse_timestamp
from relocbench.files.text import read_text
from relocbench.files.writing import atomic_write

Value = TypeVar("Value")

CHUNK_ROWS = 8192
"""rows that are read at a time: their text takes some 10 MB, however long the table is"""


def read_csv(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Iterator[tuple[int, list[str]]]:
    """1-based line and fields of each row, the header's among them; an empty line is a row without fields.

    Raises:
        RelocbenchError: (as ``error``) with file and line: no text, a quotation mark that is not closed, a field that
            is longer than ``csv.field_size_limit()``.
    """
    for lines, rows in _chunks(path, what, error):
        yield from zip(lines, rows, strict=True)


def read_table(
    path: Path, columns: Sequence[str], what: str = "", error: type[RelocbenchError] = RelocbenchError
) -> Iterator[tuple[int, list[str]]]:
    """1-based line and fields of each row below the header, which must be ``columns``; as many fields as columns.

    Raises:
        RelocbenchError: (as ``error``) with file and line.
    """
    for lines, rows in read_table_chunks(path, columns, what, error):
        yield from zip(lines, rows, strict=True)


def read_table_chunks(
    path: Path, columns: Sequence[str], what: str = "", error: type[RelocbenchError] = RelocbenchError
) -> Iterator[tuple[list[int], list[list[str]]]]:
    """As :func:`read_table`, the lines and the rows of many rows at a time, which is faster for long tables.

    Raises:
        RelocbenchError: (as ``error``) with file and line, after the rows above it.
    """
    headed = False
    for lines, rows in _chunks(path, what or f"a table ({','.join(columns)})", error):
        if not headed:
            if rows[0] != list(columns):
                raise error(header_fault(columns, rows[0]), path, 1)
            headed, lines, rows = True, lines[1:], rows[1:]
        odd = next((place for place, row in enumerate(rows) if len(row) != len(columns)), len(rows))
        if odd:
            yield lines[:odd], rows[:odd]
        if odd < len(rows):
            raise error(f"expected {len(columns)} columns, found {len(rows[odd])}", path, lines[odd])
    if not headed:
        raise error(header_fault(columns, ()), path, 1)


def header_fault(columns: Sequence[str], found: Sequence[str]) -> str:
    """What is wrong with a header that is not ``columns``; what it lacks is named, since long texts are cut."""
    lacking = [name for name in columns if name not in found] if set(columns) & set(found) else []
    return f"expected the header {','.join(columns)}" + (f"; it lacks {', '.join(lacking)}" if lacking else "")


def values_by_time(
    rows: Iterable[tuple[int, list[str]]],
    path: Path,
    parse: Callable[[list[str], int], Value],
    error: type[RelocbenchError] = RelocbenchError,
    each: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> dict[int, Value]:
    """The values of rows that begin with a time in nanoseconds; times must increase.

    Args:
        rows: line and fields of each.
        parse: makes a value of the fields after the time, and the line.
        each: entered for every row; a row whose error it catches is left out.

    Raises:
        RelocbenchError: (as ``error``) with file and line; or what ``parse`` raises.
    """
    values: dict[int, Value] = {}
    latest: int | None = None
    for line, row in rows:
        with each():
            time = parse_timestamp(row[0] if row else "", path, line, error)
            last, latest = latest, time if latest is None else max(latest, time)
            value = parse(row[1:], line)
            if last is not None and time <= last:
                raise error(f"timestamp {time} does not come after {last}", path, line)
            values[time] = value
    return values


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a header and the rows below it, whole or not at all; floats keep all their digits."""
    with atomic_write(path) as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(columns)
        table.writerows(rows)


def _chunks(path: Path, what: str, error: type[RelocbenchError]) -> Iterator[tuple[list[int], list[list[str]]]]:
    """The lines that rows begin on, and their fields, at most :data:`CHUNK_ROWS` at a time and at least one."""
    reader = csv.reader(io.StringIO(read_text(path, what, error), newline=""), strict=True)
    ends: list[int] = [0]
    rows: list[list[str]] = []
    bad: csv.Error | None = None
    while bad is None:
        ends, rows = ends[-1:], []
        try:
            for row in itertools.islice(reader, CHUNK_ROWS):
                rows.append(row)
                ends.append(reader.line_num)
        except csv.Error as fault:
            bad = fault
        if rows:
            yield [end + 1 for end in ends[:-1]], rows
        elif bad is None:
            return
    raise error(f"{_fault(bad)}; expected {what}", path, ends[-1] + 1)


def _fault(bad: csv.Error) -> str:
    text = str(bad)
    if "field limit" in text:
        return f"a field has more than {csv.field_size_limit():,} characters"
    if "end of data" in text or "after" in text:
        return "a quotation mark is out of place or not closed"
    return f"not a CSV table ({text})"
