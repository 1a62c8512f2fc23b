"""What code that is not ours prints: messages on standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout


@contextmanager
def messages_to_stderr() -> Iterator[None]:
    """What code that is not ours prints is a message; standard output holds a command's result alone (``--json``).

    The descriptor itself is turned round, so that libraries and child processes obey too.
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
