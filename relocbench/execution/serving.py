"""The main loop of a worker process: one unit after another, until the parent closes the connection."""

from __future__ import annotations

import ctypes
import fcntl
import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for
from typing import Any

from relocbench.errors import RelocbenchError
from relocbench.execution.calling import call, pin_threads
from relocbench.execution.descendants import end_descendants
from relocbench.execution.limits import tell_steps_to

_PR_SET_CHILD_SUBREAPER = 36


@dataclass(frozen=True)
class Ready:
    """The interpreter has started."""


@dataclass(frozen=True)
class Done:
    """The result of a unit."""

    result: Any


@dataclass(frozen=True)
class Raised:
    """An exception that a unit raised, with its traceback."""

    exception: Exception
    traceback: str


class RemoteTraceback(Exception):
    """The cause of an exception from a worker, which shows where it was raised."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def serve(connection: Connection) -> None:
    """Call functions on units as they arrive."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    _keep_what_it_starts()
    _end_with_parent()
    pin_threads()
    speaker = _Speaker(connection)
    tell_steps_to(speaker.send)
    speaker.send(Ready())
    while True:
        try:
            function, unit = connection.recv()
        except (EOFError, ConnectionResetError):
            end_descendants()
            return
        except Exception as bad:  # noqa: BLE001  a unit that cannot be unpickled here
            speaker.send(_raised(bad))
            continue
        try:
            speaker.send(Done(call(function, unit)))
        except (BrokenPipeError, ConnectionResetError):
            return
        except BaseException as bad:  # noqa: BLE001  the other side raises it again
            speaker.send(_raised(bad))


class _Speaker:
    """Sends messages from this process alone: a child that a method forked and that returns from it ends here."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._pid = connection, os.getpid()

    def send(self, message: Any) -> None:
        if os.getpid() != self._pid:
            os._exit(1)
        self._connection.send(message)


def _raised(bad: BaseException) -> Raised:
    where = traceback.format_exc()
    if not isinstance(bad, Exception):
        bad = RelocbenchError(f"a worker process raised {type(bad).__name__}: {bad}")
    try:
        pickle.loads(pickle.dumps(bad))
    except Exception:  # noqa: BLE001  whatever an exception's own methods do
        bad = RuntimeError(f"{type(bad).__name__}: {bad}")
    return Raised(bad, where)


def _keep_what_it_starts() -> None:
    """Make processes whose parent ends children of the worker, so that they can be found (Linux only)."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _end_with_parent() -> None:
    """End this worker with its parent: otherwise it would go on with its unit while the same job is run again."""
    parent = parent_process()
    if parent is None:
        return
    if hasattr(fcntl, "F_SETSIG"):
        # The kernel kills the whole group when the other end of the pipe closes, whatever the worker is doing.
        pipe = parent.sentinel
        fcntl.fcntl(pipe, fcntl.F_SETOWN, -os.getpid())
        fcntl.fcntl(pipe, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)
    threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """End the group where the kernel does not, or if the parent was gone before the kernel was asked to."""
    wait_for([sentinel])
    os.killpg(0, signal.SIGKILL)
