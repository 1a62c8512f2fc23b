"""Tables of points as text and as bytes, which PLY and PCD files share."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import DatasetError

MOST_SCAN_BYTES = 2**27
"""greatest size of a file with a lidar scan: 5 million points of 24 bytes; a scan has about 100,000"""
_MOST_DIGITS = 18
_MOST_LINE = 65536
"""characters in a line of text"""
_MOST_TEXT = 2**26
"""bytes of text, which takes more memory to read than binary data"""
_CHUNK = 65536
"""lines parsed at a time"""


def parse_count(text: str, path: Path) -> int:
    """Parse a count in a header. Raises DatasetError if it is not one."""
    if not (text.isascii() and text.isdigit()) or len(text) > _MOST_DIGITS:
        raise DatasetError(f"its header has '{text[:40]}' where a number is expected", path)
    return int(text)


def check_count(held: int, promised: int, path: Path) -> None:
    """Raise DatasetError if there are fewer points than the header promises."""
    if held < promised:
        raise DatasetError(f"is truncated: its header promises {promised} points, but it holds {held}", path)


def decode_rows(body: bytes, row: np.dtype[Any], count: int) -> dict[str, NDArray[Any]]:
    """Fields of binary rows, name -> (count,) or (count, K); :func:`check_count` must have passed."""
    values = np.frombuffer(body, dtype=row, count=count) if count else np.empty(0, dtype=row)
    return {name: values[name].astype(values[name].dtype.newbyteorder("=")) for name in row.names or ()}


def parse_rows(body: bytes, row: np.dtype[Any], count: int, path: Path, *, first_line: int) -> dict[str, NDArray[Any]]:
    """Like :func:`decode_rows`, for text with one point per line; empty lines and lines after the points are skipped.

    Args:
        first_line: line number of the start of ``body`` in the file.

    Raises:
        DatasetError: with file and line: there are too few lines, or a line does not hold the numbers of a point.
    """
    if len(body) > _MOST_TEXT:
        raise DatasetError(f"holds {len(body)} bytes of text, more than {_MOST_TEXT}; expected a binary file", path)
    wanted = sum(int(np.prod(row[name].shape)) for name in row.names or ())
    # A number takes at least two bytes: a digit and a separator.
    values = np.empty(min(count, (len(body) + 1) // max(2 * wanted, 1)), dtype=row)
    filled = 0
    for lines in _chunks(body, first_line, count if wanted else 0):
        for number, line in lines:
            if len(line) > _MOST_LINE or len(line.split()) != wanted:
                raise DatasetError(f"expected {wanted} numbers ({' '.join(row.names or ())[:120]})", path, number)
        try:
            values[filled : filled + len(lines)] = _numbers(lines, row)
        except (ValueError, OverflowError):
            wrong = _wrong_line(lines, row)
            raise DatasetError("holds values that are not numbers of the header's types", path, wrong) from None
        filled += len(lines)
    check_count(filled, count, path)
    return {name: np.ascontiguousarray(values[name]) for name in row.names or ()}


def _chunks(body: bytes, first_line: int, count: int) -> Iterator[list[tuple[int, str]]]:
    """The first ``count`` non-empty lines with their numbers, in chunks."""
    full = ((n, line) for n, line in enumerate(io.BytesIO(body), start=first_line) if not line.isspace())
    lines = ((n, line.decode("ascii", "replace")) for n, line in islice(full, count))
    while chunk := list(islice(lines, _CHUNK)):
        yield chunk


def _numbers(lines: list[tuple[int, str]], row: np.dtype[Any]) -> NDArray[Any]:
    return np.loadtxt([line for _, line in lines], dtype=row, comments=None, ndmin=1)


def _wrong_line(lines: list[tuple[int, str]], row: np.dtype[Any]) -> int:
    """Number of the first line that cannot be parsed, found by bisection."""
    while len(lines) > 1:
        first = lines[: len(lines) // 2]
        try:
            _numbers(first, row)
            lines = lines[len(first) :]
        except (ValueError, OverflowError):
            lines = first
    return lines[0][0]
