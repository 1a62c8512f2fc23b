"""Times as text: whole numbers in the unit that their digits tell, or seconds with a decimal point; one unit a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from relocbench.arrays import Times
from relocbench.errors import DatasetError, quoted
from relocbench.files import quick_counts, seconds_to_ns

NS_BY_DIGITS = {10: 10**9, 13: 10**6, 16: 10**3, 19: 1}
"""digits of a whole number that is a time between 2001 and 2286 -> nanoseconds of its unit"""
UNITS = {10**9: "seconds", 10**6: "milliseconds", 10**3: "microseconds", 1: "nanoseconds"}
_KINDS = (
    "10 (seconds), 13 (milliseconds), 16 (microseconds) or 19 (nanoseconds) digits, or seconds with a decimal point"
)
_WHOLE = re.compile(r"[+-]?[0-9]+")
_SECONDS = re.compile(r"[+-]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(\.[0-9]*)?[eE][+-]?[0-9]+)")
_MOST_DIGITS = 30
_MOST = 2**63 - 1
_MOST_SECONDS = 9_000_000_000
_SLOW_NS = 10 * 10**9
_FAST_NS = 100_000
"""times of the digits of a date whose steps would be longer than the first, and in the unit of the format at least the
second, count from the start of a recording instead"""

Place = Callable[[int], tuple[Path, int | None]]
"""file and line of the text of an index, for messages"""


@dataclass(frozen=True)
class ReadTimes:
    """Times that were read, and how."""

    ns: list[int]
    """nanoseconds"""
    unit: str
    """of the texts, such as ``seconds``"""
    by_digits: bool
    """whether the texts are whole numbers in another unit than the format's own"""


def times_in_ns(
    texts: Sequence[str],
    at: Place,
    own_ns: int = 1,
    *,
    dates_only: bool = False,
    like: Sequence[str] = (),
) -> ReadTimes:
    """The times of a column or of the names of files, all in one unit.

    Numbers with a decimal point or an exponent are seconds. Whole numbers of 10, 13, 16 and 19 digits are seconds,
    milliseconds, microseconds and nanoseconds since 1970; other ones, and those whose steps show that they count from
    the start of a recording, are in the unit of the format.

    Args:
        at: file and line of each text.
        own_ns: nanoseconds of the unit that the format gives whole numbers.
        dates_only: whole numbers that are no times since 1970 are refused.
        like: other whole numbers of the same recording, by which the unit is told too.

    Raises:
        DatasetError: with file and line: a text is not a time, does not fit 64 bits, or is in another unit than the
            others.
    """
    whole = _whole(texts, at)
    if whole is None:
        return ReadTimes(_seconds(texts, at), "seconds", by_digits=False)
    if not whole:
        return ReadTimes([], UNITS[own_ns], by_digits=False)
    _check_one_unit(texts, whole, at)
    others = quick_counts(like) if like else None
    factor = _unit_ns(np.array(whole if others is None else [*whole, *others], dtype=np.int64), own_ns)
    largest = max(range(len(whole)), key=lambda i: abs(whole[i]))
    if dates_only and factor is None:
        raise DatasetError(f"{quoted(texts[largest], 40)} is not a time since 1970; expected {_KINDS}", *at(largest))
    unit_ns = factor or own_ns
    if abs(whole[largest]) * unit_ns > _MOST:
        message = f"{quoted(texts[largest], 40)} is out of range as {UNITS[unit_ns]}: nanoseconds must fit 64 bits"
        raise DatasetError(message, *at(largest))
    return ReadTimes([value * unit_ns for value in whole], UNITS[unit_ns], by_digits=unit_ns != own_ns)


def times_in_unit(texts: Sequence[str], at: Place, unit_ns: int) -> list[int]:
    """The times of a column whose unit is named, in nanoseconds, with or without a decimal point.

    Raises:
        DatasetError: with file and line: a text is not a time, does not fit 64 bits, or has the digits of a date in
            another unit.
    """
    whole = quick_counts(texts) if texts else []
    factor = None if not whole else _unit_ns(np.array(whole, dtype=np.int64), unit_ns)
    if factor not in (None, unit_ns):
        message = f"{quoted(texts[0], 30)} has the digits of a date in {UNITS[factor]}, not in {UNITS[unit_ns]}"
        raise DatasetError(f"{message}, as the header says", *at(0))
    out = []
    for index, text in enumerate(texts):
        if not (_WHOLE.fullmatch(text) or _SECONDS.fullmatch(text)) or len(text) > _MOST_DIGITS:
            raise DatasetError(f"{quoted(text)} is not a time in {UNITS[unit_ns]}", *at(index))
        value = Decimal(text) * unit_ns if abs(Decimal(text).adjusted()) < _MOST_DIGITS else Decimal(_MOST + 1)
        if abs(value) > _MOST:
            raise DatasetError(f"{quoted(text)} is out of range as {UNITS[unit_ns]}", *at(index))
        out.append(int(value.to_integral_value()))
    return out


def unit_of_dates(values: Iterable[int]) -> int | None:
    """Nanoseconds of the unit that whole numbers have by their digits and steps; None where they are no dates."""
    found = np.array(list(values), dtype=np.int64)
    return _unit_ns(found, 1) if len(found) else None


def check_increasing(ns: Sequence[int], texts: Sequence[str], path: Path, lines: Sequence[int]) -> None:
    """Raise DatasetError with file and line at the first time that is not later than the one before."""
    for index in range(1, len(ns)):
        if ns[index] <= ns[index - 1]:
            message = f"time {texts[index]} is not later than {texts[index - 1]} on line {lines[index - 1]}"
            raise DatasetError(f"{message}; expected times that increase, and one run a file", path, lines[index])


def time_in_name(path: Path, own_ns: int = 1) -> int:
    """The time that a file is named by, as :func:`times_in_ns`, which is to be used where there are several."""
    return times_in_ns([path.stem], lambda _: (path, None), own_ns).ns[0]


def _whole(texts: Sequence[str], at: Place) -> list[int] | None:
    """The numbers, if all are whole ones; None if they are seconds."""
    quick = quick_counts(texts) if texts else []
    if quick is not None:
        return quick
    points = 0
    for index, text in enumerate(texts):
        if _SECONDS.fullmatch(text):
            points += 1
        elif not _WHOLE.fullmatch(text):
            raise DatasetError(
                f"{quoted(text)} is not a time; expected a whole number, or seconds with a point", *at(index)
            )
        elif len(text) > _MOST_DIGITS or abs(int(text)) > _MOST:
            raise DatasetError(f"{quoted(text, 30)} is out of range: whole nanoseconds must fit 64 bits", *at(index))
    return None if points else [int(text) for text in texts]


def _seconds(texts: Sequence[str], at: Place) -> list[int]:
    """Nanoseconds of seconds with a decimal point, or without one where a writer left out zeros."""
    out = []
    whole = [_WHOLE.fullmatch(text) is not None for text in texts]
    largest = max(abs(float(text)) for text, is_whole in zip(texts, whole, strict=True) if not is_whole)
    most = min(10 * largest + 100, _MOST_SECONDS)
    if any(is_whole and abs(int(text)) > most for text, is_whole in zip(texts, whole, strict=True)):
        rare = whole.index(2 * sum(whole) <= len(whole))
        message = f"{quoted(texts[rare], 30)} is {'a whole number' if whole[rare] else 'seconds with a decimal point'}"
        raise DatasetError(f"{message}, and most others are not; expected one unit of time", *at(rare))
    for index, text in enumerate(texts):
        try:
            out.append(seconds_to_ns(text))
        except ValueError as bad:
            raise DatasetError(f"{bad}; expected a time in seconds", *at(index)) from None
    return out


def _digits(values: Times) -> Times:
    """Number of digits of each value, without leading zeros."""
    return np.searchsorted(10 ** np.arange(19, dtype=np.int64), np.abs(values), side="right").astype(np.int64)


def _check_one_unit(texts: Sequence[str], values: list[int], at: Place) -> None:
    """Dates of different numbers of digits, without a value in between, are in different units."""
    digits = _digits(np.array(values, dtype=np.int64))
    seen = sorted(set(digits.tolist()))
    mixed = [(a, b) for a, b in pairwise(seen) if {a, b} <= set(NS_BY_DIGITS)]
    if not mixed:
        return
    first = next(i for i in range(len(values)) if digits[i] in mixed[0])
    other = next(i for i in range(first, len(values)) if digits[i] in mixed[0] and digits[i] != digits[first])
    message = f"{quoted(texts[other], 30)} has {digits[other]} digits and {quoted(texts[first], 30)} {digits[first]}"
    raise DatasetError(f"{message}; expected one unit of time", *at(other))


def _unit_ns(values: Times, own_ns: int) -> int | None:
    """Nanoseconds of the unit of whole numbers; None where they are no dates."""
    digits = _digits(values)
    usual = int(np.bincount(digits).argmax())
    factor = NS_BY_DIGITS.get(usual)
    if factor is None or factor == own_ns:
        return factor
    steps = np.diff(np.unique(values[digits == usual]))
    if not len(steps):
        return factor
    step = float(np.median(steps))
    counts_from_start = step * factor > _SLOW_NS and step * own_ns >= _FAST_NS
    return None if counts_from_start else factor
