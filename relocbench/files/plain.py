"""Files that can be opened and read to an end, and their content."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from relocbench.errors import RelocbenchError
from relocbench.pointers import pointer_fault

MAX_BYTES = 512 * 2**20
"""a table of two million pairs is smaller"""
_CHUNK_BYTES = 2**16


def plain_file(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Path:
    """``path`` itself. Opening a pipe would wait for whoever writes to it, and a device may never come to an end.

    Raises:
        RelocbenchError: (as ``error``) it is one of them, or a pointer of Git LFS or git-annex to the content. Other
            faults are reported when it is opened.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return path
    _check_plain(mode, path, what, error)
    fault = pointer_fault(path)
    if fault is not None:
        raise error(f"{fault}; expected {what}", path)
    return path


def read_bytes(
    path: Path, what: str, error: type[RelocbenchError] = RelocbenchError, most_bytes: int = MAX_BYTES
) -> bytes:
    """The content of a file, which is looked at before memory is taken for it.

    Raises:
        RelocbenchError: (as ``error``) naming the file and what it should have been: missing, not readable, a folder, a
            pipe or a device (also behind a link), a pointer of Git LFS, or more than ``most_bytes``.
    """
    try:
        # Should it have become a pipe since it was looked at, opening it does not wait for its writer.
        descriptor = os.open(plain_file(path, what, error), os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        link = " (a link to a file that is gone)" if path.is_symlink() else ""
        raise error(f"missing{link}; expected {what}", path) from None
    except OSError as bad:
        raise error(f"cannot be read ({bad.strerror}); expected {what}", path) from None
    except ValueError:  # a name with a NUL character
        raise error(f"no file has such a name; expected {what}", path) from None
    try:
        return _read(descriptor, path, what, error, most_bytes)
    except OSError as bad:
        raise error(f"cannot be read ({bad.strerror}); expected {what}", path) from None
    finally:
        os.close(descriptor)


def _read(descriptor: int, path: Path, what: str, error: type[RelocbenchError], most_bytes: int) -> bytes:
    found = os.fstat(descriptor)
    if stat.S_ISDIR(found.st_mode):
        raise error(f"is a folder; expected {what}", path)
    _check_plain(found.st_mode, path, what, error)
    size, read = found.st_size, 0
    chunks: list[bytes] = []
    with open(descriptor, "rb", closefd=False) as stream:
        while size <= most_bytes and (chunk := stream.read(max(size - read, _CHUNK_BYTES))):
            chunks.append(chunk)
            read += len(chunk)
            size = max(size, read)  # it may grow, and what the system tells of itself has size 0
    if size > most_bytes:
        raise error(f"holds {size} bytes; of {what} at most {most_bytes} are read", path)
    return b"".join(chunks)


def _check_plain(mode: int, path: Path, what: str, error: type[RelocbenchError]) -> None:
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise error(f"is a pipe, a socket or a device; expected {what}", path)
