"""The times of the clouds of a folder: from a file, from their names, or by a rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from math import gcd
from pathlib import Path

from relocbench.datasets.sensors.numbered_rows import read_numbered_times
from relocbench.datasets.sensors.times import times_in_ns
from relocbench.errors import DatasetError, quoted
from relocbench.files import natural, read_rows, whole_number

TIME_FILES = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv")


Timed = Sequence[tuple[int | None, Path]]
"""clouds with their times in nanoseconds, None where there is none"""


def clouds_with_times(files: list[Path], folder: Path, rate_hz: float | None) -> tuple[Timed, str]:
    """The clouds with their times, in the order of these, and where the times are from.

    A cloud whose row in the file of times is empty has None.

    Args:
        files: the clouds.
        folder: the folder of the drive, which may hold one of :data:`TIME_FILES`, or that of the clouds.
        rate_hz: clouds a second, if they are numbered and no file has their times.

    Raises:
        DatasetError: with file and line: the times do not fit the clouds, are no times, or do not increase.
    """
    ordered = sorted(files, key=lambda path: natural(path.name))
    candidates = [place / name for place in (folder, ordered[0].parent) for name in TIME_FILES]
    table = next((path for path in candidates if path.is_file()), None)
    if table is not None:
        return _from_table(ordered, table)
    if rate_hz is not None:
        at = _places(ordered)
        timed = [(round(place * 1e9 / rate_hz), path) for place, path in zip(at, ordered, strict=True)]
        lost = at[-1] + 1 - len(at)
        return timed, f"{rate_hz:g} clouds a second, by their names{f', {lost} of which are missing' if lost else ''}"
    texts = [path.stem for path in ordered]
    try:
        read = times_in_ns(texts, lambda i: (ordered[i], None), dates_only=True)
    except DatasetError as bad:
        message = f"{bad.expected}; for numbered clouds give {TIME_FILES[0]} or --rate-hz"
        raise DatasetError(message, bad.path) from None
    return _by_time(ordered, read.ns, None), f"names of the files, in {read.unit}"


def _places(files: Sequence[Path]) -> list[int]:
    """The place of each cloud in a drive: by the numbers in their names, so that lost ones shift none, or by order."""
    numbers = [whole_number(path.stem) for path in files]
    known = [number for number in numbers if number is not None]
    if len(known) < 2 or len(known) < len(files):
        return list(range(len(files)))
    step = gcd(*(b - a for a, b in pairwise(known)))  # more than 1 where every n-th cloud was kept
    if not step:
        return list(range(len(files)))
    return [(number - known[0]) // step for number in known]


def _from_table(files: list[Path], table: Path) -> tuple[Timed, str]:
    """Times from a file with a time a line, or the name of a cloud and its time, or its time and name."""
    rows = list(read_rows(table, "times of clouds", DatasetError))
    if rows and not any(_is_number(word) for word in rows[0][1]):
        rows = rows[1:]  # a header
    if rows and all(len(fields) == 2 and sum(map(_is_number, fields)) >= 1 for _, fields in rows):
        return _named(files, rows, table)
    numbered, time_of, unit = read_numbered_times(table, dates_only=True)
    chosen = zip(numbered.of_files(files), files, strict=True)
    return [(time_of.get(row), path) for row, path in chosen], f"{table.name}, in {unit}"


def _named(files: list[Path], rows: list[tuple[int, list[str]]], table: Path) -> tuple[Timed, str]:
    known = {path.name: path for path in files} | {path.stem: path for path in files}
    hits = [sum(Path(fields[k]).name in known for _, fields in rows) for k in (0, 1)]
    name_first = hits[0] >= hits[1]
    chosen: dict[Path, str] = {}
    lines = []
    for line, fields in rows:
        name, time = fields if name_first else fields[::-1]
        path = known.get(Path(name).name)
        if path is None:
            raise DatasetError(f"names a cloud {quoted(name)} that does not exist", table, line)
        if path in chosen:
            raise DatasetError(f"names {path.name} a second time", table, line)
        chosen[path] = time
        lines.append(line)
    read = times_in_ns(list(chosen.values()), lambda i: (table, lines[i]), dates_only=True)
    return _by_time(list(chosen), read.ns, table), f"{table.name}, in {read.unit}"


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[+-]?[0-9]*\.?[0-9]+([eE][+-]?[0-9]+)?", text) is not None


def _by_time(files: Sequence[Path], times: Sequence[int], table: Path | None) -> Timed:
    found: dict[int, Path] = {}
    for path, time in zip(files, times, strict=True):
        if time in found:
            raise DatasetError(f"{path.name} has the same time as {found[time].name}", table or path)
        found[time] = path
    return sorted(found.items())
