"""The processes that a process has started, and theirs, from ``/proc``."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")
_ENDING_S = 2.0


def descendants(pid: int) -> list[int]:
    """The children of a process, their children, and so on, without those that have ended."""
    found: list[int] = []
    left = [pid]
    while left:
        for path in PROC.glob(f"{left.pop()}/task/*/children"):
            try:
                children = [int(word) for word in path.read_text().split()]
            except OSError:
                continue
            found += children
            left += children
    return found


def end_descendants() -> None:
    """Kill everything that this process has started, whatever session it is in.

    A child that has ended leaves its own children to this process where it is their subreaper, so that they are found
    when it is looked again.
    """
    until = time.monotonic() + _ENDING_S
    while (left := descendants(os.getpid())) and time.monotonic() < until:
        for pid in left:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        time.sleep(0.002)
