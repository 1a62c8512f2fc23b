"""Headings, numbers and the cells of tables.

A number has one name wherever it is printed: that of the column in CSV, which says the unit
(``median_translation_error_m``). In CSV shares are 0 to 1; on pages and on the terminal they are in percent, and their
heading says so: ``coverage, %``. Two numbers in one cell have both names: ``median_seconds / p95_seconds``. Pages call
the columns ``failed`` and ``broke`` of CSV by what they count: ``declined / crashed``.

Names, messages and parameters come from whoever made the results. In tables for spreadsheets they pass through
:func:`cell`, on pages through the filters of :mod:`relocbench.pages`, so that they are shown as text and cannot act as
formulas or markup.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from relocbench.files import atomic_write
from relocbench.metrics import Interval

METHOD, RANK = "method", "rank"
SECONDS = "median_seconds"
SECONDS_AND_P95 = "median_seconds / p95_seconds"
COUNTS = "declined / crashed"
RESCORED = "rescored"
RETRIEVER, TRACKER, TOP = "retriever", "tracker", "top"
BASIN = "basin_m / basin_deg"
ELSEWHERE = ("elsewhere", "elsewhere_answered", "elsewhere_confident", "elsewhere_confident_high")
"""the columns about pairs of different places"""


def heading(name: str, unit: str = "share") -> str:
    """The heading of a column of CSV where shares are shown in percent."""
    return f"{name}, %" if unit == "share" else name


Value = str | int | float | None
_DIGITS = {"m": 3, "deg": 3, "s": 3, "count": 0}
_FORMULA = re.compile(r"[\s'\"\x00-\x20]*[=+\-@＝＋－＠]|[\t\r\n]")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def number(value: float | None, unit: str) -> str:
    """A value in its unit, without the unit's name; shares in percent, empty for None."""
    if value is None:
        return ""
    if math.isinf(value):
        return "inf"
    if unit == "bytes":
        return f"{value / 2**20:.0f} MiB"
    return f"{100 * value:.1f}" if unit == "share" else f"{value:.{_DIGITS[unit]}f}"


def with_bounds(value: float | None, interval: Interval | None, unit: str) -> str:
    """A value with its interval, as ``71.4 [65.0, 77.9]``; empty without a value."""
    if value is None:
        return ""
    bounds = "" if interval is None else f" [{number(interval.low, unit)}, {number(interval.high, unit)}]"
    return number(value, unit) + bounds


def cell(value: Value) -> Value:
    """A value for a table for spreadsheets: floats with all digits, blank for None, and text that is never a formula.

    Text that begins with ``= + - @`` (also after blanks or quotes), or with a tab or line end, is prefixed by ``'``,
    by which spreadsheets mark text. Numbers stay numbers.
    """
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str) and _FORMULA.match(value) and not _NUMBER.fullmatch(value):
        return f"'{value}"
    return value


def write_records(path: Path, records: Sequence[Mapping[str, Value]]) -> None:
    """Write records of equal keys as a CSV table of :func:`cell` values; a file without records is empty."""
    header = [list(records[0])] if records else []
    with atomic_write(path) as stream:
        rows = [*header, *(record.values() for record in records)]
        csv.writer(stream, lineterminator="\n").writerows(map(cell, row) for row in rows)
