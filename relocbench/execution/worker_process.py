"""A worker process as its parent sees it: what it is given, what it reports, and how it is ended.

A worker is the leader of a session of its own. A terminal's Ctrl-C does not reach it, and everything that it started is
ended with it.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context, resource_tracker
from typing import Any

from relocbench.execution.calling import single_threaded_children
from relocbench.execution.descendants import descendants
from relocbench.execution.limits import Limits, Loss, Step, size_text
from relocbench.execution.memory import resident_bytes
from relocbench.execution.serving import Done, Raised, Ready, serve

_EXIT_GRACE_S = 1.0
"""time after which a worker that was ordered to end, or that has closed its pipe, is killed"""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_live: set[WorkerProcess] = set()


class WorkerProcess:
    """A worker in a fresh interpreter: forking a process that has threads (OpenMP, Open3D, torch) can hang."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs,))
        self.ready = False
        self.work: tuple[int, Any] | None = None
        """index and unit in progress"""
        self.series: Iterator[Any] | None = None
        """what the last unit is of"""
        self.step: Step | None = None
        self._deadline: float | None = None
        self._loss: Loss | None = None
        self._reaped = False
        self._lock = threading.Lock()
        resource_tracker.ensure_running()  # it would unblock signals while it starts
        # This comes last: once an interruption can arrive, all that is needed to end the worker is known.
        with single_threaded_children(), _signals_held():
            self.process.start()
            _live.add(self)
            theirs.close()

    @property
    def pid(self) -> int:
        assert self.process.pid is not None
        return self.process.pid

    def give(self, function: Any, index: int, unit: Any) -> None:
        """Send the worker a call of ``function`` on ``unit``."""
        self.work = (index, unit)
        with suppress(OSError):  # a death is reported by ``listen``
            self.connection.send((function, unit))

    def seconds_left(self) -> float:
        """The time left for the step in progress."""
        return float("inf") if self._deadline is None else self._deadline - time.monotonic()

    def listen(self, limits: Limits | None) -> Done | Raised | Loss | None:
        """The outcome of the unit in progress, if there is one; a worker whose step takes too long is ended here."""
        try:
            while self.connection.poll():
                message = self.connection.recv()
                if isinstance(message, Done | Raised):
                    self.work, self.step, self._deadline = None, None, None
                    return message
                if isinstance(message, Ready):
                    self.ready = True
                else:
                    self._take_step(message, limits)
        except (EOFError, OSError):
            return self._loss_at_end()
        if limits is not None and self.seconds_left() <= 0:
            self._end_for("time", _time_message(self.step, limits))
        if self._loss is not None or self._has_exited():
            return self._loss_at_end()
        return None

    def check_memory(self, limit_bytes: int) -> None:
        """End the worker if a method is running and more memory is held; may be called from another thread."""
        with self._lock:
            current = self.step
            if current is None or self._reaped or self._loss is not None or resident_bytes(self.pid) <= limit_bytes:
                return
            self._loss = Loss(current, "memory", f"took more memory than the limit of {size_text(limit_bytes)}")
            self._kill()

    def release(self) -> None:
        """Let an idle worker end by itself, which it does when the connection is closed."""
        self.connection.close()

    def end(self, patience_s: float = 0.0) -> None:
        """End the process and everything that it started."""
        until = time.monotonic() + patience_s
        while time.monotonic() < until and not self._has_exited():
            time.sleep(0.005)
        with self._lock:
            if not self._reaped:
                self._kill()
                self._reaped = True
                self.process.join()
        self.connection.close()
        _live.discard(self)

    def _take_step(self, message: Step | None, limits: Limits | None) -> None:
        before, self.step = self.step, message
        self._deadline = None
        if limits is not None and message is not None:
            self._deadline = time.monotonic() + message.times * limits.time_s
        if limits is not None and limits.memory_bytes is not None and message is None and before is not None:
            # A short call may fall between two measurements; memory that it keeps is noticed here.
            self.step = before
            self.check_memory(limits.memory_bytes)
            self.step = None

    def _end_for(self, kind: Any, words: str) -> None:
        with self._lock:
            if self._loss is None and not self._reaped:
                self._loss = Loss(self.step, kind, words)
                self._kill()

    def _loss_at_end(self) -> Loss:
        """The loss of a worker that has died, or that has closed its pipe, which is treated alike."""
        verdict, current = self._loss, self.step
        self.end(0.0 if verdict else _EXIT_GRACE_S)
        return self._loss or Loss(current, "death", _exit_description(self.process.exitcode))

    def _has_exited(self) -> bool:
        """Whether the process has ended, without collecting its exit status: until then its id is not reused.

        End of file on the pipe is not enough, since children may hold it open after their parent has died.
        """
        if self._reaped:
            return True
        if not hasattr(os, "waitid"):
            return not self.process.is_alive()
        try:
            return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        except ChildProcessError:
            return True

    def _kill(self) -> None:
        with suppress(OSError):
            os.kill(self.pid, signal.SIGSTOP)  # so that it starts nothing else meanwhile
        for child in descendants(self.pid):
            with suppress(OSError):
                os.kill(child, signal.SIGKILL)
        with suppress(OSError):  # the group does not exist before the worker has a session of its own
            os.killpg(self.pid, signal.SIGKILL)
        with suppress(OSError):
            os.kill(self.pid, signal.SIGKILL)


def end_workers() -> None:
    """End every worker process that this process has started, at once."""
    for worker in list(_live):
        with suppress(OSError):
            worker.end()


atexit.register(end_workers)  # runs before multiprocessing's own handler, which waits for processes without a limit


@contextmanager
def _signals_held() -> Iterator[None]:
    """Hold back Ctrl-C and termination while a worker starts; they act afterwards, when the worker can be ended.

    The new process inherits the block until it has a session of its own. A mask belongs to a thread, and the system may
    deliver a signal to any other thread: Python's handlers wait as well.
    """
    heard: list[int] = []
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        known = {number: handler for number in _SIGNALS if callable(handler := signal.getsignal(number))}
        handlers = {number: signal.signal(number, lambda number, _: heard.append(number)) for number in known}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for arrived in heard[:1]:
            signal.raise_signal(arrived)


def _time_message(current: Step | None, limits: Limits) -> str:
    times = 1.0 if current is None else current.times
    if times == 1:
        return f"took longer than the time limit of {limits.time_s:g} s"
    return f"took longer than {times * limits.time_s:g} s, {times:g} times the time limit"


def _exit_description(code: int | None) -> str:
    if code == os.EX_PROTOCOL:
        return "the method's process sent something other than an answer to the question"
    if code is None or code >= 0:
        return f"exit status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = str(-code)
    hint = ": out of memory, or killed from outside" if name == "SIGKILL" else ""
    return f"signal {name}{hint}"
