"""Published tables: the rows of Markdown pages and CSV files, each with its line number."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

_RULE = re.compile(r"\s*\|?\s*:?-+:?\s*(\|\s*:?-+:?\s*)*\|?\s*")
_CELL_BORDER = re.compile(r"(?<!\\)\|")
_MARKUP = re.compile(r"[*_`]|</?\w+>")
_DELIMITERS = ",;\t"


@dataclass(frozen=True)
class TableRow:
    """A row below the header of a table."""

    line: int
    """1-based line number in the file"""
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A header and its rows, without markup and surrounding blanks."""

    line: int
    """1-based line number of the header"""
    header: tuple[str, ...]
    rows: tuple[TableRow, ...]


def read_tables(text: str) -> tuple[Table, ...]:
    """Read all tables of a Markdown page, or the one table of a CSV file.

    A text is Markdown if it has a table header with a rule of dashes below it. Tables in fenced code blocks are
    examples and are ignored. CSV fields may be separated by commas, semicolons or tabs; lines that begin with # are
    comments.

    Returns:
        the tables in the order of the file; none where there is no table.

    Raises:
        ValueError: a cell of a CSV file is longer than ``csv.field_size_limit()``.
    """
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").split("\n")
    tables = tuple(_markdown_tables(lines))
    return tables or _csv_table(lines)


def _markdown_tables(lines: Sequence[str]) -> Iterator[Table]:
    number, fenced = 0, False
    while number < len(lines):
        fenced ^= lines[number].lstrip().startswith(("```", "~~~"))
        if fenced or not _is_header(lines, number):
            number += 1
            continue
        first = number
        number += 2
        rows = []
        while number < len(lines) and "|" in lines[number]:
            rows.append(TableRow(number + 1, _markdown_cells(lines[number])))
            number += 1
        yield Table(first + 1, _markdown_cells(lines[first]), tuple(rows))


def _is_header(lines: Sequence[str], number: int) -> bool:
    """Whether the next line is a rule with as many cells."""
    if number + 1 >= len(lines) or "|" not in lines[number] or "|" not in lines[number + 1]:
        return False
    rule = lines[number + 1]
    return bool(_RULE.fullmatch(rule)) and len(_markdown_cells(rule)) == len(_markdown_cells(lines[number]))


def _markdown_cells(line: str) -> tuple[str, ...]:
    inner = line.strip().removeprefix("|")
    if inner.endswith("|") and not inner.endswith("\\|"):
        inner = inner[:-1]
    return tuple(_MARKUP.sub("", cell.replace("\\|", "|")).strip() for cell in _CELL_BORDER.split(inner))


def _csv_table(lines: Sequence[str]) -> tuple[Table, ...]:
    filled = [(n, line) for n, line in enumerate(lines, start=1) if line.strip() and not line.startswith("#")]
    if not filled:
        return ()
    header = filled[0][1]
    delimiter = max(_DELIMITERS, key=header.count)
    reader = csv.reader((line + "\n" for _, line in filled), delimiter=delimiter, skipinitialspace=True)
    rows = []
    try:
        for cells in reader:  # a quoted cell may span several lines: a row's line number is that of its last line
            rows.append(TableRow(filled[reader.line_num - 1][0], tuple(" ".join(cell.split()) for cell in cells)))
    except csv.Error:
        most = csv.field_size_limit()
        raise ValueError(
            f"a cell above line {filled[reader.line_num - 1][0]} has more than {most:,} characters"
        ) from None
    return (Table(rows[0].line, rows[0].cells, tuple(rows[1:])),)
