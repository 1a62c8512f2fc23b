"""Measuring and watching the resident memory of a process with its children, from ``/proc``."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from relocbench.execution.descendants import PROC, descendants

INTERVAL_S = 0.05
"""between two measurements; memory that is taken and returned in between is not noticed"""


def can_watch() -> bool:
    """Whether this system reports the memory of processes; macOS does not."""
    return (PROC / "self" / "statm").exists()


def resident_bytes(pid: int) -> int:
    """The resident memory of a process and its descendants, with shared pages counted once.

    If there are descendants, it is the sum of the kernel's proportional counts (``smaps_rollup``), which take
    milliseconds.
    """
    children = descendants(pid)
    if not children:
        return _resident(pid)
    shares = ((each, _told(each, "smaps_rollup", "Pss:")) for each in (pid, *children))
    return sum(_resident(each) if share is None else share for each, share in shares)


def peak_resident_bytes(pid: int, launchers: int = 0) -> int | None:
    """The most resident memory that the processes below one have had, each at its own time, from ``VmHWM``.

    Pages that several of them share are counted for each, and those that have ended are not counted.

    Args:
        launchers: how many processes of the line below it only start the next one, and are not counted.

    Returns:
        bytes; None where the system does not tell.
    """
    peaks = [_told(each, "status", "VmHWM:") or 0 for each in descendants(pid)[launchers:]]
    return sum(peaks) if any(peaks) else None


def _told(pid: int, file: str, name: str) -> int | None:
    """Bytes by a line of a file of a process; None without such a file or line."""
    try:
        lines = (PROC / str(pid) / file).read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))
    except (OSError, StopIteration):
        return None


def _resident(pid: int) -> int:
    try:
        return int((PROC / str(pid) / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


class Watched(Protocol):
    """A worker whose memory is watched."""

    def check_memory(self, limit_bytes: int) -> None: ...


@contextmanager
def memory_watched(workers: Callable[[], Sequence[Watched]], limit_bytes: int | None) -> Iterator[None]:
    """Watch workers' memory in a thread, so that the program that waits for them may do something else."""
    if limit_bytes is None:
        yield
        return
    done = threading.Event()

    def watch() -> None:
        while not done.wait(INTERVAL_S):
            for worker in workers():
                worker.check_memory(limit_bytes)

    thread = threading.Thread(target=watch, name="memory watch", daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
