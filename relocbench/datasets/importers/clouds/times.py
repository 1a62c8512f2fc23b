"""The times of the clouds of a folder: from a file, from their names, or by a rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from relocbench.arrays import Times
from relocbench.errors import DatasetError, quoted
from relocbench.files import parse_seconds, read_rows, whole_number

TIME_FILES = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv")
NS_BY_DIGITS = {10: 10**9, 13: 10**6, 16: 10**3, 19: 1}
"""digits of a whole number that is a time between 2001 and 2286 -> nanoseconds of its unit"""
_UNITS = {10**9: "seconds", 10**6: "milliseconds", 10**3: "microseconds", 1: "nanoseconds"}


def clouds_with_times(files: list[Path], folder: Path, rate_hz: float | None) -> tuple[dict[int, Path], str]:
    """The clouds by time, in the order of their times, and where these are from.

    Args:
        files: the clouds.
        folder: the folder of the drive, which may hold one of :data:`TIME_FILES`, or that of the clouds.
        rate_hz: clouds a second, if they are numbered and no file has their times.

    Raises:
        DatasetError: with file and line: the times do not fit the clouds, are no times, or do not increase.
    """
    ordered = sorted(files, key=_natural)
    candidates = [place / name for place in (folder, ordered[0].parent) for name in TIME_FILES]
    table = next((path for path in candidates if path.is_file()), None)
    if table is not None:
        return _from_table(ordered, table)
    values = [path.stem for path in ordered]
    if rate_hz is not None:
        numbered = {round(number * 1e9 / rate_hz): path for number, path in enumerate(ordered)}
        return numbered, f"{rate_hz:g} clouds a second, in the order of their names"
    times, unit = _parsed(values, [(path, None) for path in ordered])
    return _by_time(ordered, times, None), f"names of the files, in {unit}"


def _natural(path: Path) -> tuple[list[tuple[int, str]], str]:
    """A key that puts 2 before 10."""
    parts = re.split(r"([0-9]+)", path.name)
    return [(int(part), "") if part.isdigit() and part.isascii() else (-1, part) for part in parts], path.name


def _from_table(files: list[Path], table: Path) -> tuple[dict[int, Path], str]:
    """Times from a file with a time a line, or the name of a cloud and its time, or its time and name."""
    rows = list(read_rows(table, "times of clouds", DatasetError))
    if rows and not any(_is_number(word) for word in rows[0][1]):
        rows = rows[1:]  # a header
    if rows and all(len(fields) == 2 and sum(map(_is_number, fields)) >= 1 for _, fields in rows):
        return _named(files, rows, table)
    for line, fields in rows:
        if len(fields) != 1:
            raise DatasetError(f"expected a time, or a cloud and its time, found {len(fields)} columns", table, line)
    if len(rows) != len(files):
        raise DatasetError(f"holds {len(rows)} times for {len(files)} clouds", table)
    times, unit = _parsed([fields[0] for _, fields in rows], [(table, line) for line, _ in rows])
    return _by_time(files, times, table), f"{table.name}, in {unit}"


def _named(files: list[Path], rows: list[tuple[int, list[str]]], table: Path) -> tuple[dict[int, Path], str]:
    known = {path.name: path for path in files} | {path.stem: path for path in files}
    hits = [sum(Path(fields[k]).name in known for _, fields in rows) for k in (0, 1)]
    name_first = hits[0] >= hits[1]
    chosen: dict[Path, str] = {}
    places = []
    for line, fields in rows:
        name, time = fields if name_first else fields[::-1]
        path = known.get(Path(name).name)
        if path is None:
            raise DatasetError(f"names a cloud {quoted(name)} that does not exist", table, line)
        if path in chosen:
            raise DatasetError(f"names {path.name} a second time", table, line)
        chosen[path] = time
        places.append((table, line))
    times, unit = _parsed(list(chosen.values()), places)
    return _by_time(list(chosen), times, table), f"{table.name}, in {unit}"


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[+-]?[0-9]*\.?[0-9]+([eE][+-]?[0-9]+)?", text) is not None


def _parsed(texts: list[str], places: Sequence[tuple[Path, int | None]]) -> tuple[Times, str]:
    """Times and their unit: a point means seconds, else the number of digits decides."""
    if any(whole_number(text) is None for text in texts):
        seconds = [parse_seconds(text, *place, DatasetError) for text, place in zip(texts, places, strict=True)]
        return np.array(seconds), "seconds"
    longest = max(texts, key=lambda text: len(text.lstrip("0")))
    digits = len(longest.lstrip("0"))
    factor = NS_BY_DIGITS.get(digits)
    if factor is None:
        path, line = places[texts.index(longest)]
        raise DatasetError(
            f"{quoted(longest, 40)} is not a time since 1970: whole numbers have 10 (s), 13 (ms), 16 (us) or 19 (ns) "
            f"digits, seconds a decimal point; for numbered clouds give {TIME_FILES[0]} or --rate-hz",
            path,
            line,
        )
    return np.array([int(text) * factor for text in texts], dtype=np.int64), _UNITS[factor]


def _by_time(files: list[Path], times: Times, table: Path | None) -> dict[int, Path]:
    found: dict[int, Path] = {}
    for path, time in zip(files, times.tolist(), strict=True):
        if time in found:
            raise DatasetError(f"{path.name} has the same time as {found[time].name}", table or path)
        found[time] = path
    return dict(sorted(found.items()))
