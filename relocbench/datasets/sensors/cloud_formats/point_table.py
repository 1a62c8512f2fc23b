"""Tables of points as text and as bytes, which PLY and PCD files share."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import DatasetError, quoted

MOST_SCAN_BYTES = 2**27
"""greatest size of a file with a lidar scan: 5 million points of 24 bytes; a scan has about 100,000"""
_HEADER_BYTES = 65536
_MOST_DIGITS = 18
_DECIMAL_COMMA = re.compile(r"[0-9],[0-9]")
_MOST_LINE = 65536
"""characters in a line of text"""
_MOST_TEXT = 2**26
"""bytes of text, which takes more memory to read than binary data"""
_LOOKED_AT, _USUAL = 1000, 1e6
"""records that are looked at before and behind the last promised one, and the size of usual coordinates"""
_CHUNK = 65536
"""lines parsed at a time"""


def header_lines(data: bytes, is_last: Callable[[str], bool]) -> tuple[list[str], bytes] | None:
    """The lines of a header up to the last one, and the data after them; None where there is no such line.

    Args:
        is_last: whether a line, without white space around it, ends the header.
    """
    head, at = data[:_HEADER_BYTES], 0
    lines: list[str] = []
    while at < len(head):
        end = head.find(b"\n", at)
        end = end if end >= 0 else len(head)
        lines.append(head[at:end].decode("ascii", "replace").strip())
        at = end + 1
        if is_last(lines[-1]):
            return lines, data[at:]
    return None


def parse_count(text: str, path: Path) -> int:
    """Parse a count in a header. Raises DatasetError if it is not one."""
    if not (text.isascii() and text.isdigit()) or len(text) > _MOST_DIGITS:
        raise DatasetError(f"its header has '{text[:40]}' where a number is expected", path)
    return int(text)


def check_count(held: int, promised: int, path: Path) -> None:
    """Raise DatasetError if there are fewer points than the header promises."""
    if held < promised:
        raise DatasetError(f"is truncated: its header promises {promised} points, but it holds {held}", path)


def check_behind(rows: NDArray[Any], count: int, path: Path) -> None:
    """Raise DatasetError if points follow those that the header promises.

    Args:
        rows: all records that the file has room for.
        count: how many of them the header promises.
    """
    axes = [name for name in rows.dtype.names or () if name.lower() in ("x", "y", "z") and rows.dtype[name].shape == ()]
    if len(rows) <= count or len(axes) < 3:
        return
    promised, behind = (
        np.column_stack([part[axis].astype(np.float64) for axis in axes])
        for part in (rows[:count][:_LOOKED_AT], rows[count:][:_LOOKED_AT])
    )
    if points_follow(promised, behind):
        raise DatasetError(f"its header promises {count} points, but {len(rows) - count} more follow them", path)


def points_follow(promised: NDArray[Any], behind: NDArray[Any]) -> bool:
    """Whether coordinates (M, 3) that were read from bytes behind the promised ones (N, 3) are points, too."""
    known = promised[np.isfinite(promised).all(axis=1)]
    with np.errstate(invalid="ignore", over="ignore"):
        if len(known):
            low, high = known.min(axis=0), known.max(axis=0)
            near = np.all((behind >= 2 * low - high) & (behind <= 2 * high - low), axis=1)
        else:
            near = np.all((np.abs(behind) < _USUAL) & ((behind == 0) | (np.abs(behind) > 1 / _USUAL)), axis=1)
    return bool(behind.any() and np.mean(near & behind.any(axis=1)) > 0.5)


def decode_rows(body: bytes, row: np.dtype[Any], count: int) -> dict[str, NDArray[Any]]:
    """Fields of binary rows, name -> (count,) or (count, K); :func:`check_count` must have passed."""
    values = np.frombuffer(body, dtype=row, count=count) if count else np.empty(0, dtype=row)
    return {name: values[name].astype(values[name].dtype.newbyteorder("=")) for name in row.names or ()}


def parse_rows(
    body: bytes, row: np.dtype[Any], count: int, path: Path, *, first_line: int, alone: bool
) -> dict[str, NDArray[Any]]:
    """Like :func:`decode_rows`, for text with one point per line; empty lines are skipped.

    Numbers with a point become float64 whatever the header says: of a text, single precision would lose digits.

    Args:
        first_line: line number of the start of ``body`` in the file.
        alone: whether nothing but points is expected; otherwise lines after the points are skipped.

    Raises:
        DatasetError: with file and line: there are too few lines or, of points alone, too many, or a line does not hold
            the numbers of a point.
    """
    if len(body) > _MOST_TEXT:
        raise DatasetError(f"holds {len(body)} bytes of text, more than {_MOST_TEXT}; expected a binary file", path)
    row = np.dtype([(name, _wide(row[name].base), row[name].shape) for name in row.names or ()])
    wanted = sum(int(np.prod(row[name].shape)) for name in row.names or ())
    # A number takes at least two bytes: a digit and a separator.
    values = np.empty(min(count, (len(body) + 1) // max(2 * wanted, 1)), dtype=row)
    filled = 0
    found = _lines(body, first_line, wanted)
    for lines in _chunks(found, count if wanted else 0):
        for number, line in lines:
            if len(line) > _MOST_LINE or len(line.split()) != wanted:
                raise DatasetError(f"expected {wanted} numbers ({' '.join(row.names or ())[:120]})", path, number)
        try:
            values[filled : filled + len(lines)] = _numbers(lines, row)
        except (ValueError, OverflowError):
            wrong, line = _wrong_line(lines, row)
            what = (
                "decimal commas" if _DECIMAL_COMMA.search(line) else "values that are not numbers of the header's types"
            )
            raise DatasetError(f"holds {what}: {quoted(line.strip(), 60)}", path, wrong) from None
        filled += len(lines)
    check_count(filled, count, path)
    more = sum(len(line.split()) == wanted for _, line in found) if alone and wanted else 0
    if more:
        raise DatasetError(f"its header promises {count} points, but {more} more follow them", path)
    return {name: np.ascontiguousarray(values[name]) for name in row.names or ()}


def _lines(body: bytes, first_line: int, wanted: int) -> Iterator[tuple[int, str]]:
    """The non-empty lines with their numbers; commas between ``wanted`` numbers become spaces."""
    for number, raw in enumerate(io.BytesIO(body), start=first_line):
        if not raw.isspace():
            line = raw.decode("ascii", "replace")
            yield number, line.replace(",", " ") if "," in line and len(line.split()) != wanted else line


def _chunks(lines: Iterator[tuple[int, str]], count: int) -> Iterator[list[tuple[int, str]]]:
    """The next ``count`` lines, in chunks."""
    while chunk := list(islice(lines, min(_CHUNK, count))):
        yield chunk
        count -= len(chunk)


def _wide(kind: np.dtype[Any]) -> np.dtype[Any]:
    return np.dtype(np.float64) if kind.kind == "f" else kind


def _numbers(lines: list[tuple[int, str]], row: np.dtype[Any]) -> NDArray[Any]:
    return np.loadtxt([line for _, line in lines], dtype=row, comments=None, ndmin=1)


def _wrong_line(lines: list[tuple[int, str]], row: np.dtype[Any]) -> tuple[int, str]:
    """The first line, with its number, that cannot be parsed, found by bisection."""
    while len(lines) > 1:
        first = lines[: len(lines) // 2]
        try:
            _numbers(first, row)
            lines = lines[len(first) :]
        except (ValueError, OverflowError):
            lines = first
    return lines[0]
