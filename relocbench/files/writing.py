"""Files that appear whole or not at all."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any

from relocbench.errors import RelocbenchError
from relocbench.files.plain import plain_file

_PART = re.compile(r"\..*\.[0-9a-f]{4,8}\.part(\..*)?")


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Write a file beside ``path``, flush it to the disk and rename it; on an error nothing is left behind."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except FileExistsError as bad:  # a file, or a symbolic link that leads nowhere
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), bad.filename) from None
    # The part's name keeps the suffix, which image and table writers go by.
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    newline = None if "b" in mode else "\n"
    encoding = None if "b" in mode else "utf-8"
    try:
        with part.open(mode, newline=newline, encoding=encoding) as stream:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
            part.replace(path)
    except OSError as bad:
        if bad.errno == errno.ENOENT and bad.filename == str(part) and bad.filename2 is None:
            # The folder is there and the file cannot be opened: a file system of the kernel's own.
            raise PermissionError(errno.EACCES, "no file can be created here", str(path)) from None
        if bad.filename in (None, str(part)):  # a full disk does not say which file did not fit
            bad.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text whole or not at all."""
    with atomic_write(path) as stream:
        stream.write(text)


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes whole or not at all."""
    with atomic_write(path, "wb") as stream:
        stream.write(data)


def link_file(source: Path, path: Path) -> None:
    """Make ``path`` a symbolic link to ``source``; an existing link or file is replaced in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part")
    part.symlink_to(source.resolve())
    part.replace(path)


@contextmanager
def locked_folder(folder: Path, error: type[RelocbenchError] = RelocbenchError) -> Iterator[None]:
    """Be the only process that works in a folder. The system lets go of it however the process ends.

    Raises:
        RelocbenchError: (as ``error``) another process holds the lock.
    """
    taken = "another process holds the lock of this folder; wait for it to end"
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise error(taken, folder) from None
        except OSError:
            pass  # a file system without locks: as safe as before
        if not folder.exists() or not os.path.samestat(os.fstat(descriptor), folder.stat()):
            raise error(taken, folder)  # it ended, and took the folder away, just now
        yield
    finally:
        os.close(descriptor)


@contextmanager
def locked_output(folder: Path, error: type[RelocbenchError] = RelocbenchError) -> Iterator[None]:
    """Be the only process that writes to an output folder. It is made, and removed again where nothing was written.

    Within it the same folder may be entered again, by a part of the work that guards itself.

    Raises:
        RelocbenchError: (as ``error``) another process holds the lock, or it is a symbolic link that leads nowhere.
    """
    if folder.is_symlink() and not folder.exists():
        raise error("is a symbolic link that leads nowhere; expected a folder to write to", folder)
    if folder.exists() and not folder.is_dir():
        yield  # whoever writes says what was expected
        return
    made = [path for path in folder.parents if not path.exists()]
    existed = folder.is_dir()
    folder.mkdir(parents=True, exist_ok=True)
    about = folder.stat()
    if (about.st_dev, about.st_ino) in _written_to.get():
        yield
        return
    try:
        with locked_folder(folder, error):
            token = _written_to.set(_written_to.get() | {(about.st_dev, about.st_ino)})
            try:
                yield
            finally:
                _written_to.reset(token)
                if not existed:
                    _remove_if_empty(folder)
    finally:
        for path in made:
            _remove_if_empty(path)


_written_to: ContextVar[frozenset[tuple[int, int]]] = ContextVar("_written_to", default=frozenset())
"""device and inode of folders that this thread of work is alone in"""


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def remove_parts(folder: Path, *, deep: bool = True) -> None:
    """Remove what writers that were killed left behind; what a living one is writing stays.

    Args:
        deep: in the folders within as well.
    """
    for part in folder.rglob(".*.part*") if deep else folder.glob(".*.part*"):
        with suppress(OSError):
            if _PART.fullmatch(part.name) and (part.is_symlink() or not _held(part)):
                part.unlink(missing_ok=True)


def _held(path: Path) -> bool:
    """Whether a living process holds the lock of a file that it writes. Raises OSError when the file is gone."""
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            pass  # a file system without locks: as safe as before
    return False


def sha256_file(path: Path) -> str:
    """Hex digest of a file's content (links are followed)."""
    with plain_file(path, "a file").open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
