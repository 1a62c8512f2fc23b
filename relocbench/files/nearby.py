"""The folder that was meant, where somebody names the one above it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

_DEPTH = 2
"""folders within folders that are searched"""
_MOST = 1000
"""folders that are looked at, so that a mistake costs no time"""


def meant(folder: Path, holds: Callable[[Path], bool]) -> str:
    """``; did you mean FOLDER?`` for the first folder within ``folder`` for which ``holds`` is true, else nothing.

    Nearer ones come first, then those whose names come first.
    """
    level, left = [folder], _MOST
    for _ in range(_DEPTH):
        below: list[Path] = []
        for parent in level:
            try:
                below += sorted(path for path in parent.iterdir() if path.is_dir() and not path.is_symlink())
            except OSError:  # what cannot be read was not meant
                continue
        for path in below[:left]:
            if holds(path):
                return f"; did you mean {path}?"
        left -= len(below)
        level = below[: max(left, 0)]
    return ""
