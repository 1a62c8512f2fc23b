"""Files that can be opened and read to an end, and their content."""

from __future__ import annotations

import stat
from pathlib import Path

from relocbench.errors import RelocbenchError

MAX_BYTES = 512 * 2**20
"""a table of two million pairs is smaller"""


def plain_file(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Path:
    """``path`` itself. Opening a pipe would wait for whoever writes to it, and a device may never come to an end.

    Raises:
        RelocbenchError: (as ``error``) it is one of them. What else keeps it from being read is told by opening it.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return path
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise error(f"is a pipe, a socket or a device; expected {what}", path)
    return path


def read_bytes(
    path: Path, what: str, error: type[RelocbenchError] = RelocbenchError, most_bytes: int = MAX_BYTES
) -> bytes:
    """The content of a file.

    Raises:
        RelocbenchError: (as ``error``) naming the file and what it should have been: missing, not readable, or more
            than ``most_bytes``.
    """
    try:
        with plain_file(path, what, error).open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except FileNotFoundError:
        raise error(f"missing; expected {what}", path) from None
    except IsADirectoryError:
        raise error(f"is a folder; expected {what}", path) from None
    except OSError as bad:
        raise error(f"cannot be read ({bad.strerror}); expected {what}", path) from None
    except ValueError:  # a name with a NUL character
        raise error(f"no file has such a name; expected {what}", path) from None
    if len(data) > most_bytes:
        raise error(f"has more than {most_bytes // 2**20} MiB; expected {what}", path)
    return data
