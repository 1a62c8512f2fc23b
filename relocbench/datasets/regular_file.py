"""Binary files as a whole, where they are plain files of a bounded size."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from relocbench.errors import DatasetError, RelocbenchError

MOST_SCAN_BYTES = 2**27
"""of a file with a lidar scan: 5 million points of 24 bytes; a scan has some 100,000"""


def read_regular(path: Path, what: str, most_bytes: int, error: type[RelocbenchError] = DatasetError) -> bytes:
    """The content of a file.

    A pipe or a device, which may never end, is refused without waiting for it, also behind a link.

    Args:
        what: the file should have been, for the message.
        most_bytes: a larger file is refused before memory is taken for it.

    Raises:
        RelocbenchError: (as ``error``) missing, not readable, no plain file, or too large.
    """
    try:
        # Opening a pipe would wait for its writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        link = " (a link to a file that is gone)" if path.is_symlink() else ""
        raise error(f"missing{link}; expected {what}", path) from None
    except OSError as bad:
        raise error(f"cannot be read ({bad.strerror}); expected {what}", path) from None
    try:
        return _read(descriptor, path, what, most_bytes, error)
    except OSError as bad:
        raise error(f"cannot be read ({bad.strerror}); expected {what}", path) from None
    finally:
        os.close(descriptor)


def _read(descriptor: int, path: Path, what: str, most_bytes: int, error: type[RelocbenchError]) -> bytes:
    found = os.fstat(descriptor)
    if stat.S_ISDIR(found.st_mode):
        raise error(f"is a folder; expected {what}", path)
    if not stat.S_ISREG(found.st_mode):
        raise error(f"is no plain file; expected {what}", path)
    if found.st_size > most_bytes:
        raise error(f"holds {found.st_size} bytes; of {what} at most {most_bytes} are read", path)
    with open(descriptor, "rb", closefd=False) as stream:
        return stream.read(found.st_size)
