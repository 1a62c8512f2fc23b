"""CSV tables: every row with the line it begins on, whatever its quoted fields hold."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from relocbench.errors import RelocbenchError
from relocbench.files.text import read_text


def read_csv(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Iterator[tuple[int, list[str]]]:
    """1-based line and fields of each row, the header's among them; an empty line is a row without fields.

    Raises:
        RelocbenchError: (as ``error``) with file and line: no text, a quotation mark that is not closed, a field that
            is longer than ``csv.field_size_limit()``.
    """
    rows = csv.reader(io.StringIO(read_text(path, what, error), newline=""), strict=True)
    line = 1
    while True:
        try:
            row = next(rows, None)
        except csv.Error as bad:
            raise error(f"{_fault(bad)}; expected {what}", path, line) from None
        if row is None:
            return
        yield line, row
        line = rows.line_num + 1


def read_table(
    path: Path, columns: Sequence[str], what: str = "", error: type[RelocbenchError] = RelocbenchError
) -> Iterator[tuple[int, list[str]]]:
    """1-based line and fields of each row below the header, which must be ``columns``; as many fields as columns.

    Raises:
        RelocbenchError: (as ``error``) with file and line.
    """
    header = ",".join(columns)
    rows = read_csv(path, what or f"a table ({header})", error)
    if next(rows, (1, []))[1] != list(columns):
        raise error(f"expected the header {header}", path, 1)
    for line, row in rows:
        if len(row) != len(columns):
            raise error(f"expected {len(columns)} columns, found {len(row)}", path, line)
        yield line, row


def _fault(bad: csv.Error) -> str:
    text = str(bad)
    if "field limit" in text:
        return f"a field has more than {csv.field_size_limit():,} characters"
    if "end of data" in text or "after" in text:
        return "a quotation mark is out of place or not closed"
    return f"not a CSV table ({text})"
