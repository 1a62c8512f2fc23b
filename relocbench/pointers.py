"""Small text files that stand for large ones, which a clone without Git LFS or git-annex has in their place."""

from __future__ import annotations

import stat
from pathlib import Path

_MOST_BYTES = 1024
"""pointers are shorter: https://github.com/git-lfs/git-lfs/blob/main/docs/spec.md"""
_LFS = b"version https://git-lfs.github.com/spec/"
_ANNEX = b"/annex/objects/"


def pointer_fault(path: Path) -> str | None:
    """What a file says that holds no content but a pointer of Git LFS or git-annex to it; None for any other path."""
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode) or not len(_ANNEX) <= found.st_size < _MOST_BYTES:
            return None
        with path.open("rb") as stream:
            text = stream.read(_MOST_BYTES)
    except (OSError, ValueError):
        return None
    if text.startswith(_LFS):
        size = next((line[5:] for line in text.split(b"\n") if line.startswith(b"size ") and line[5:].isdigit()), b"?")
        return f"is a pointer of Git LFS to a file of {size.decode()[:20]} bytes, which `git lfs pull` fetches"
    if text.startswith(_ANNEX):
        return "is a pointer of git-annex to a file, which `git annex get` fetches"
    return None
