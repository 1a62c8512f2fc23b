"""The names that images had where a dataset was imported from, for formats that name images rather than tell times."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from relocbench.errors import DatasetError, quoted
from relocbench.files import parse_timestamp, read_table, write_table

NAME_COLUMNS = ("timestamp_ns", "name")


def read_names(path: Path) -> dict[int, str]:
    """Read ``names.csv`` of a traversal: timestamp_ns -> the image's name; empty without such a file.

    Raises:
        DatasetError: with file and line: a wrong header, a time or a name that occurs again.
    """
    if not path.exists() and not path.is_symlink():
        return {}
    by_time: dict[int, str] = {}
    names: set[str] = set()
    for line, (time, name) in read_table(path, NAME_COLUMNS, "names of images", DatasetError):
        timestamp_ns = parse_timestamp(time, path, line, DatasetError)
        if timestamp_ns in by_time or name in names:
            raise DatasetError(f"{quoted(name)} at {timestamp_ns} occurs again", path, line)
        by_time[timestamp_ns] = name
        names.add(name)
    return by_time


def write_names(path: Path, names: Mapping[int, str]) -> None:
    """Write the names of images, timestamp_ns -> name, in time order."""
    write_table(path, NAME_COLUMNS, sorted(names.items()))
