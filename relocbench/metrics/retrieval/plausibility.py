"""Whether a published row of R@1 and AP can be true, by what a single positive for each query allows.

With one positive for each query AP = (R@1 + MRR) / 2. A query whose positive is not at the first position has a
reciprocal rank of at most 1/2, so that, in percent, ``R@1 <= AP <= R@1 + (100 - R@1) / 4``. Published numbers are
rounded: a row is at fault only if no numbers that round to the printed ones satisfy the bounds.

The bounds hold for the trapezoid AP and one positive for each query, as from drone to satellite in University-1652.
They do not hold for the rectangle AP (there, the MRR), nor with several positives, as from satellite to drone.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from relocbench.errors import RelocbenchError
from relocbench.metrics.retrieval.tables import Table, TableRow, read_tables

_NOT_REPORTED = frozenset({"", "-", "--", "–", "—", "n/a", "na", "none", "?"})
_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*%?(?:\s*(?:±|\+-|\+/-)\s*[0-9.]+\s*%?|\s*\([0-9.]+\s*%?\))?")
"""a number that may be followed by a deviation: 75.93, 75.93 %, 75.93 ± 0.3, 75.93 (0.3)"""
_RECALL_NAMES = frozenset({"r@1", "recall@1", "r1", "rank1", "rank@1"})
_AP_NAMES = frozenset({"ap", "map"})
_HUNDRED = Decimal(100)


@dataclass(frozen=True)
class TableFault:
    """A fault of one row of a table; it prints as one line."""

    path: Path | str
    line: int
    row: str
    """the row's first cell, or its number where that is empty"""
    message: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.row}: {self.message}"


@dataclass(frozen=True)
class TableCheck:
    """The result of checking the rows of a file."""

    faults: tuple[TableFault, ...]
    checked: int
    """number of rows that report both numbers"""
    not_reported: int
    """number of rows that lack one of them"""


def check_single_positive_tables(
    text: str, path: Path | str, *, recall_column: str | None = None, ap_column: str | None = None
) -> TableCheck:
    """Check every row of every table that has columns for R@1 and AP, in percent.

    Args:
        text: the text of a Markdown page or a CSV file, as :func:`read_tables` takes it.
        path: the file, for messages.
        recall_column, ap_column: names of the columns, where they are not among R@1, Recall@1, R1, Rank-1 and AP, mAP.
            Case, blanks and a trailing % do not matter.

    Returns:
        The faults, in the order of the file, and the number of rows.

    Raises:
        RelocbenchError: no table has both columns, or one has two of a name.
    """
    wanted = (_names(recall_column, _RECALL_NAMES), _names(ap_column, _AP_NAMES))
    checks = []
    try:
        tables = read_tables(text)
    except ValueError as bad:
        raise RelocbenchError(f"{bad}; expected a table of results", path) from None
    for table in tables:
        recall, ap = (_column(table, names, path) for names in wanted)
        if recall is not None and ap is not None:
            checks.append(_checked(table, recall, ap, path))
    if not checks:
        columns = f"'{recall_column or 'R@1'}' and '{ap_column or 'AP'}'"
        raise RelocbenchError(f"no table with the columns {columns}; expected at least one", path)
    return TableCheck(
        faults=tuple(fault for check in checks for fault in check.faults),
        checked=sum(check.checked for check in checks),
        not_reported=sum(check.not_reported for check in checks),
    )


def single_positive_fault(recall_at_1: str, average_precision: str) -> str | None:
    """The fault of a pair of published numbers in percent, or None if they can be true.

    Numbers are given as printed, since their digits tell how far they were rounded: "75.93" stands for 75.925 to
    75.935. A deviation behind a number is ignored.
    """
    numbers = []
    for name, cell in (("R@1", recall_at_1), ("AP", average_precision)):
        match = _NUMBER.fullmatch(cell.strip())
        if match is None:
            return f"{name} '{cell}' is not a number; expected percent such as 75.93"
        if Decimal(match[1]) > _HUNDRED:
            return f"{name} {match[1]} is above 100 percent"
        numbers.append(Decimal(match[1]))
    r, ap = numbers
    r_low, r_high = _rounded_from(r)
    ap_low, ap_high = _rounded_from(ap)
    if ap_high < r_low:
        return f"AP {ap} is below R@1 {r}; with one positive it cannot be"
    if ap_low > _largest_ap(r_high):
        return f"AP {ap} is above {_largest_ap(r):.2f}, the most that R@1 {r} allows with one positive"
    return None


def _checked(table: Table, recall: int, ap: int, path: Path | str) -> TableCheck:
    faults: list[TableFault] = []
    checked = not_reported = 0
    for number, row in enumerate(table.rows, start=1):
        name = (row.cells[0] if row.cells else "") or f"row {number}"
        if len(row.cells) != len(table.header):
            message = f"{len(row.cells)} cells; expected {len(table.header)}, as in the header"
            faults.append(TableFault(path, row.line, name, message))
            continue
        if any(row.cells[column].lower() in _NOT_REPORTED for column in (recall, ap)):
            not_reported += 1
            continue
        checked += 1
        fault = single_positive_fault(row.cells[recall], row.cells[ap])
        if fault is not None:
            faults.append(TableFault(path, row.line, name, fault))
    if _looks_like_shares(table, recall, ap):
        header = " | ".join(table.header)
        faults.insert(0, TableFault(path, table.line, header, "no number above 1; expected percent, not shares"))
    return TableCheck(tuple(faults), checked, not_reported)


def _looks_like_shares(table: Table, recall: int, ap: int) -> bool:
    numbers = list(_numbers_of(table.rows, recall, ap))
    return bool(numbers) and max(numbers) <= 1 and max(numbers) > 0


def _numbers_of(rows: tuple[TableRow, ...], *columns: int) -> Iterator[Decimal]:
    for row in rows:
        for column in columns:
            match = _NUMBER.fullmatch(row.cells[column]) if column < len(row.cells) else None
            if match is not None:
                yield Decimal(match[1])


def _largest_ap(recall: Decimal) -> Decimal:
    return min(_HUNDRED, recall + (_HUNDRED - recall) / 4)


def _rounded_from(value: Decimal) -> tuple[Decimal, Decimal]:
    """The interval of numbers that round to the printed digits."""
    exponent = value.as_tuple().exponent
    assert isinstance(exponent, int)  # a finite number
    half = Decimal(5).scaleb(exponent - 1)
    return value - half, value + half


def _names(given: str | None, usual: frozenset[str]) -> frozenset[str]:
    return usual if given is None else frozenset({_plain(given)})


def _column(table: Table, names: frozenset[str], path: Path | str) -> int | None:
    found = [number for number, name in enumerate(table.header) if _plain(name) in names]
    if len(found) > 1:
        shown = ", ".join(f"'{table.header[number]}'" for number in found)
        raise RelocbenchError(f"columns {shown} have the same name; expected one: name the column", path, table.line)
    return found[0] if found else None


def _plain(name: str) -> str:
    """A column's name without case, blanks and brackets: ``Recall @1 (%)`` and ``recall@1`` are the same."""
    return re.sub(r"[\s\-()\[\]%]", "", name).lower()
