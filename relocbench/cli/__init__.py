"""The command line: one small module a command, no maths."""

from __future__ import annotations

import errno
import os
import sys

from relocbench.errors import RelocbenchError

USER_ERROR = 2
INTERRUPTED = 130
_SURROUNDINGS = {
    getattr(errno, name)
    for name in ("EACCES", "EDQUOT", "EIO", "EISDIR", "ELOOP", "ENAMETOOLONG", "ENOSPC", "ENOTDIR", "EPERM", "EROFS")
}
"""what the system refuses: no mistake of the program"""


def main() -> None:
    """Run the command line; a user's mistake is one line and exit status 2, a bug is a traceback."""
    from relocbench.cli.app import app

    try:
        app(prog_name="relocbench", standalone_mode=True)
    except RelocbenchError as bad:
        print(f"relocbench: {bad}", file=sys.stderr)
        sys.exit(USER_ERROR)
    except SystemExit as done:
        if done.code == INTERRUPTED:  # what typer makes of Ctrl-C
            print("relocbench: interrupted; the same command goes on where it stopped", file=sys.stderr)
        raise
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as bad:
        if bad.errno not in _SURROUNDINGS:
            raise
        place = f"{bad.filename}: " if bad.filename else ""
        print(f"relocbench: {place}{bad.strerror}", file=sys.stderr)
        sys.exit(USER_ERROR)
