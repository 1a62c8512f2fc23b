"""The folder that was meant, where somebody names the one above it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

_DEPTH = 2
"""folders within folders that are searched"""
_MOST = 1000
"""folders that are looked at, and entries of each, so that a mistake costs no time"""


def did_you_mean(folder: Path, holds: Callable[[Path], bool]) -> str:
    """``; did you mean FOLDER?`` for the first folder within ``folder`` for which ``holds`` is true, else nothing.

    Nearer ones come first, then those whose names come first.
    """
    level, left = [folder], _MOST
    for _ in range(_DEPTH):
        below = [path for parent in level for path in _folders_in(parent)][:left]
        for path in below:
            if _is(path, holds):
                return f"; did you mean {path}?"
        left -= len(below)
        level = below
    return ""


def _folders_in(parent: Path) -> Iterator[Path]:
    """The folders in a folder by name, of so many of its entries that it costs no time; none that cannot be read."""
    try:
        with os.scandir(parent) as entries:
            found = [entry.name for entry in islice(entries, _MOST) if entry.is_dir(follow_symlinks=False)]
    except OSError:  # what cannot be read was not meant
        return iter(())
    return (parent / name for name in sorted(found))


def _is(path: Path, holds: Callable[[Path], bool]) -> bool:
    try:
        return holds(path)
    except OSError:
        return False
