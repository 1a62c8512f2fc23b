"""Kills a job at a point that it reaches. Python imports this module by its name as it starts, in workers as well.

The environment variable ``FAULT_POINT`` holds JSON: ``events`` (the kinds that count), ``path`` (a regular expression
of the files that count), ``count`` (the event that is fatal; 0 only counts), ``dies`` and ``trace`` (a folder). An
event is counted, and may be fatal, before it takes effect:

``write``
    a file is about to be opened that will be renamed when it is whole,
``rename``
    that file is whole and on the disk, but has its temporary name,
``append``
    lines were flushed to a journal (this one is counted when it is done),
``remove``
    a file is about to be removed.

The job's processes count together, in the order of a lock. The first of them to start Python is the main one; it
hands its number down in ``FAULT_JOB``, as workers lead sessions of their own.
"""

from __future__ import annotations

import builtins
import fcntl
import io
import json
import os
import re
import signal
import sys
import threading
from contextlib import suppress
from typing import Any

_PART = re.compile(r"^\.(.*)\.[0-9a-f]{8}\.part(\.[^.]*)?$")
_JOURNALS = (".jsonl", ".journal")


class FaultPoint:
    """Counts events of this process and its siblings, and kills them."""

    def __init__(self, events: list[str], path: str, count: int, dies: str, trace: str) -> None:
        self.events = frozenset(events)
        self.path = re.compile(path)
        self.count = count
        self.dies = dies
        self.trace = os.path.join(trace, "events.jsonl")  # noqa: PTH118 - pathlib is slow to load
        self.landed = os.path.join(trace, "landed.json")  # noqa: PTH118
        self.lock = threading.RLock()
        self.busy = False
        self.job = int(os.environ.setdefault("FAULT_JOB", str(os.getpid())))

    def audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        """What the interpreter is about to do, by the names of its audit events."""
        if event == "open":
            path, mode, _ = arguments
            if isinstance(path, str) and isinstance(mode, str) and mode[0] in "wx":
                final = _final(path)
                if final != path:
                    self.reach("write", final)
        elif event == "os.rename":
            self.reach("rename", os.fsdecode(arguments[1]))
        elif event == "os.remove":
            path = os.fsdecode(arguments[0])
            if _final(path) == path:  # writers tidy up temporary names that are gone
                self.reach("remove", path)

    def reach(self, event: str, path: str) -> None:
        """Count an event and die where it is the fatal one."""
        if event not in self.events or not self.path.search(path):
            return
        with self.lock:
            if self.busy:
                return
            self.busy = True
            try:
                self._reach(event, path)
            finally:
                self.busy = False

    def _reach(self, event: str, path: str) -> None:
        here = os.getpid()
        if self.dies == "worker" and here == self.job:
            return
        stream = os.open(self.trace, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            fcntl.flock(stream, fcntl.LOCK_EX)
            size = os.fstat(stream).st_size
            number = os.pread(stream, size, 0).count(b"\n") + 1
            told = {"number": number, "event": event, "path": path, "process": here, "main": here == self.job}
            os.write(stream, (json.dumps(told) + "\n").encode())
            if number == self.count:
                landed = os.open(self.landed, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
                os.write(landed, json.dumps(told).encode())
                os.close(landed)
                self._kill(here)
        finally:
            os.close(stream)

    def _kill(self, here: int) -> None:
        """With the lock held, so that nobody counts further before the signal arrives."""
        if self.dies == "worker":
            os.kill(here, signal.SIGKILL)
        elif self.dies == "main":
            os.kill(self.job, signal.SIGKILL)
        else:
            if here != self.job:
                os.kill(self.job, signal.SIGSTOP)  # it must not see its workers die
            for process in (*_descendants(self.job), self.job):
                if process != here:
                    _end(process)
            os.kill(here, signal.SIGKILL)


def _end(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)


def _descendants(process: int) -> list[int]:
    """Children of a process, their children, and so on."""
    found = []
    with suppress(OSError):  # it has ended just now
        for thread in os.listdir(f"/proc/{process}/task"):  # noqa: PTH208
            with open(f"/proc/{process}/task/{thread}/children") as stream:  # noqa: PTH123
                for child in map(int, stream.read().split()):
                    found += [child, *_descendants(child)]
    return found


def _final(path: str) -> str:
    """The name that a temporary file gets when it is whole; other names are returned as they are."""
    folder, _, name = path.rpartition("/")
    found = _PART.match(name)
    return f"{folder}/{found[1]}{found[2] or ''}" if found else path


def _watching_journals(point: FaultPoint, opened: Any) -> Any:
    """``open`` whose journals count each time they are flushed."""

    def watched(file: Any, *arguments: Any, **named: Any) -> Any:
        stream = opened(file, *arguments, **named)
        if isinstance(file, int) or not os.fspath(file).endswith(_JOURNALS) or not stream.writable():
            return stream
        path, flush = os.fspath(file), stream.flush
        known = 0

        def flushed() -> None:
            nonlocal known
            flush()
            size = os.fstat(stream.fileno()).st_size
            if size > known:
                known = size
                point.reach("append", path)

        stream.flush = flushed
        return stream

    return watched


def _install() -> None:
    point = FaultPoint(**json.loads(os.environ["FAULT_POINT"]))
    sys.addaudithook(point.audit)
    builtins.open = io.open = _watching_journals(point, io.open)


if "FAULT_POINT" in os.environ:
    _install()
