"""Numbers and times as text: ASCII digits, finite, within 64 bits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import ROUND_HALF_UP, Decimal, InvalidOperation
from pathlib import Path

from relocbench.errors import RelocbenchError, quoted

_MOST = 2**63 - 1
"""times and counts are kept as 64-bit integers"""
_INTEGER = re.compile(r"[+-]?[0-9]+")
_MOST_DIGITS = 30
_MOST_SECONDS = 9_000_000_000
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def parse_floats(
    fields: list[str], path: Path, line: int, names: str, error: type[RelocbenchError] = RelocbenchError
) -> list[float]:
    """Finite floats of ``fields``, as many as ``names`` has words. Raises ``error`` with file and line."""
    wanted = names.split()
    quick = quick_floats(fields) if len(fields) == len(wanted) else None
    if quick is not None:
        return quick
    if len(fields) != len(wanted):
        raise error(f"expected {len(wanted)} numbers ({names}), found {len(fields)}", path, line)
    out = []
    for name, text in zip(wanted, fields, strict=True):
        try:
            value = float(text)
        except ValueError:
            raise error(f"{name} is {quoted(text)}, expected a number", path, line) from None
        # Python takes 1_0 and the digits of every script, which other readers of the same file do not.
        if not text.isascii() or "_" in text:
            raise error(f"{name} is {quoted(text)}, expected a number", path, line)
        if value - value != 0.0:
            raise error(f"{name} is {quoted(text)[1:-1]}, expected a finite number", path, line)
        out.append(value)
    return out


def quick_floats(fields: Sequence[str]) -> list[float] | None:
    """Finite floats of fields that are all good; None where one may not be, which is then looked at by itself."""
    text = "".join(fields)
    if not text.isascii() or "_" in text:
        return None
    try:
        values = list(map(float, fields))
    except ValueError:
        return None
    total = sum(values)  # not finite if one of them is not
    return values if total - total == 0.0 else None


def quick_counts(fields: Sequence[str]) -> list[int] | None:
    """Whole numbers that fit 64 bits, of fields that all are such; None where one may not be."""
    text = "".join(fields)
    if not (text.isascii() and text.isdecimal()):
        return None
    try:
        values = list(map(int, fields))
    except ValueError:
        return None
    return values if max(values) <= _MOST else None


def whole_number(text: str) -> int | None:
    """The number that ASCII digits make, if it fits 64 bits; None for all other text.

    ``str.isdigit`` is no such test: it takes superscripts, which ``int`` refuses, and the digits of every script.
    """
    if not (text.isascii() and text.isdigit()) or len(text) > _MOST_DIGITS:
        return None
    value = int(text)
    return value if value <= _MOST else None


def parse_count(
    text: str, name: str, path: Path, line: int | None = None, error: type[RelocbenchError] = RelocbenchError
) -> int:
    """A whole number that is not negative. Raises ``error`` with file and line."""
    value = whole_number(text)
    if value is None:
        raise error(f"{name} is {quoted(text)}, expected a whole number", path, line)
    return value


def parse_timestamp(
    text: str, path: Path, line: int | None = None, error: type[RelocbenchError] = RelocbenchError
) -> int:
    """Integer nanoseconds. Raises ``error`` with file and line."""
    usual = whole_number(text)
    if usual is not None:
        return usual
    if not _INTEGER.fullmatch(text):
        raise error(f"{quoted(text)} is not a timestamp in integer nanoseconds", path, line)
    if len(text) > _MOST_DIGITS or abs(int(text)) > _MOST:
        raise error(f"{text[:_MOST_DIGITS]} is out of range; expected nanoseconds that fit 64 bits", path, line)
    return int(text)


def seconds_to_ns(text: str) -> int:
    """Decimal seconds as integer nanoseconds, digit by digit (a float would lose 128 ns today). Raises ValueError."""
    if not _DECIMAL.fullmatch(text):
        raise ValueError(f"{quoted(text)} is not a decimal number")
    try:
        seconds = Decimal(text)
    except InvalidOperation:  # an exponent beyond what a Decimal holds
        raise ValueError(f"{quoted(text)} is out of range") from None
    if not -_MOST_SECONDS < seconds < _MOST_SECONDS:
        raise ValueError(f"{quoted(text)} is out of range")
    return int((seconds * 1_000_000_000).to_integral_value(ROUND_HALF_UP))


def parse_seconds(
    text: str, path: Path, line: int | None = None, error: type[RelocbenchError] = RelocbenchError
) -> int:
    """As :func:`seconds_to_ns`. Raises ``error`` with file and line."""
    try:
        return seconds_to_ns(text)
    except ValueError as bad:
        raise error(f"{bad}; expected a time in seconds", path, line) from None
