"""Redirecting what third-party code prints to standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout


@contextmanager
def messages_to_stderr() -> Iterator[None]:
    """Redirect standard output to standard error while third-party code runs: only a command's result belongs on it.

    The file descriptor itself is redirected, so that native libraries and child processes are included.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
