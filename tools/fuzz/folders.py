"""Folders of inputs: copied with links and pipes as they are, and looked at before and after."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

Look = dict[str, tuple[int, int, int, int]]
"""path -> kind, size, time of the last change, number of the inode"""


def copy_tree(source: Path, target: Path) -> None:
    """Copy a folder; links stay links and pipes stay pipes."""
    target.mkdir(parents=True)
    for path in sorted(source.iterdir()):
        new, mode = target / path.name, path.lstat().st_mode
        if stat.S_ISDIR(mode):
            copy_tree(path, new)
        elif stat.S_ISLNK(mode):
            new.symlink_to(path.readlink())
        elif stat.S_ISFIFO(mode):
            os.mkfifo(new)
        else:
            shutil.copyfile(path, new)


def look(folder: Path) -> Look:
    """What stands in a folder now; nothing is opened."""
    found: Look = {}
    waiting = [folder]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                status = entry.stat(follow_symlinks=False)
                found[entry.path] = (stat.S_IFMT(status.st_mode), status.st_size, status.st_mtime_ns, status.st_ino)
                if entry.is_dir(follow_symlinks=False):
                    found[entry.path] = (stat.S_IFDIR, 0, 0, status.st_ino)
                    waiting.append(Path(entry.path))
    return found


def difference(before: Look, after: Look) -> str:
    """A path that differs, in words; empty where none does."""
    for path in sorted(before.keys() | after.keys()):
        if before.get(path) != after.get(path):
            what = "is new" if path not in before else "is gone" if path not in after else "was changed"
            return f"{path!r} {what}"
    return ""


def empty(folder: Path) -> None:
    """Remove all that a folder holds."""
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def restore(folder: Path, source: Path, before: Look) -> bool:
    """Make a copy of ``source`` what it was before; whether anything had changed."""
    after = look(folder)
    changed = [Path(path) for path in sorted(before.keys() | after.keys()) if before.get(path) != after.get(path)]
    for path in changed:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    for path in changed:
        original = source / path.relative_to(folder)
        if original.is_dir():
            path.mkdir(exist_ok=True, parents=True)
        elif original.exists() and not path.exists():
            path.parent.mkdir(exist_ok=True, parents=True)
            shutil.copyfile(original, path)
    return bool(changed)
