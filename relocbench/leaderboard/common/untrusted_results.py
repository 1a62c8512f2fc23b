"""Checks of a results folder that may come from a stranger, made before anything in it is read.

Everything that a leaderboard reads must lie in the folder: a link that leads out of it would publish other files of
the reader's. Anything but files and folders is refused, since reading a pipe, for instance, would never end.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.errors import PredictionError
from relocbench.evaluation.common.folders import SetLike

_LONGEST_NAME = 200
"""in bytes; file names of most systems hold 255, and pictures are named after a dataset and a pair set"""


def check_folder(results: Path) -> None:
    """Check every entry below a results folder; the folder itself may be a link.

    Raises:
        PredictionError: a link leads out of the folder, nowhere or to a folder that holds it, or an entry is neither a
            file nor a folder.
    """
    root = Path(os.path.realpath(results))
    for path, mode in _entries(root):
        if stat.S_ISLNK(mode):
            target = Path(os.path.realpath(path))
            if not target.is_relative_to(root):
                raise PredictionError(
                    "is a link that leads out of the results folder; expected the file itself in its place", path
                )
            mode = target.lstat().st_mode if target.exists() else mode
            if stat.S_ISLNK(mode):
                raise PredictionError("is a link that leads nowhere; expected a file or folder", path)
            if stat.S_ISDIR(mode) and path.is_relative_to(target):
                raise PredictionError("is a link to a folder that holds it; expected a file or folder", path)
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise PredictionError("is neither a file nor a folder; expected results of the evaluate commands", path)


def check_same_questions(tables: Iterable[tuple[str, str, object, Path]]) -> None:
    """Raise PredictionError unless all methods answered the same questions.

    Args:
        tables: pair set or task, label of the method, what it was asked, and the path of its table.
    """
    first: dict[str, tuple[str, object]] = {}
    for unit, label, asked, path in tables:
        other, expected = first.setdefault(unit, (label, asked))
        if asked != expected:
            why = f"answers other questions of '{unit}' than the table of '{other}', or has other facts of them"
            raise PredictionError(f"{why}; score both again", path)


def check_lies_with(dataset: str, fingerprint: str, record: SetLike, path: Path) -> None:
    """Raise PredictionError, with the path of its record, unless a run was made for the set that it lies with."""
    if fingerprint != record.fingerprint:
        raise PredictionError(
            f"was made for {dataset}@{fingerprint[:SHORT]}, but lies among the results of "
            f"{record.name}@{record.fingerprint[:SHORT]}",
            path,
        )


def check_file_names(names: Iterable[str], what: str, path: Path) -> None:
    """Check names from a record that become parts of file names. Raises PredictionError with the record's path."""
    for name in names:
        plain = name.isprintable() and not name.startswith(".") and "/" not in name and "\\" not in name
        if not name or not plain or len(name.encode(errors="replace")) > _LONGEST_NAME:
            shown = ascii(name[:60]).strip("'")
            raise PredictionError(
                f"{what} '{shown}' cannot be part of a file's name; expected at most {_LONGEST_NAME} printable "
                "characters without / that do not begin with a dot",
                path,
            )


def _entries(folder: Path) -> Iterator[tuple[Path, int]]:
    """Yield every entry below a folder with its mode; links are not followed."""
    folders = [folder]
    while folders:
        try:
            with os.scandir(folders.pop()) as entries:
                in_order = sorted(entries, key=lambda entry: entry.name)
        except (NotADirectoryError, FileNotFoundError):
            continue
        for entry in in_order:
            path = Path(entry.path)
            yield path, entry.stat(follow_symlinks=False).st_mode
            if entry.is_dir(follow_symlinks=False):
                folders.append(path)
