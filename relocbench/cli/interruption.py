"""One Ctrl-C, or a termination signal, ends a command within seconds, whatever it is doing.

The signal becomes a KeyboardInterrupt, and what is open is closed on its way out. Where that takes too long (native
code that does not return, a pool that waits for its threads) a thread of its own ends the process: what is written is a
journal or a whole file at any moment, so that nothing is lost by it.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import NoReturn

INTERRUPTED = 130
_MESSAGE = "relocbench: interrupted; the same command goes on where it stopped"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_GRACE_S = 1.5
"""for the orderly way out"""

_heard = threading.Event()
"""a signal came"""
_told = threading.Event()


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it both signals interrupt; in the main thread alone, since Python hears of none in others."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = os.pipe()
    for end in (reader, writer):
        os.set_blocking(end, end is reader)
    threading.Thread(target=_see_that_it_ends, args=(reader,), daemon=True).start()
    wakeup = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    before = {number: signal.signal(number, _interrupt) for number in _SIGNALS}
    hook, sys.excepthook = sys.excepthook, _of_other_threads(sys.excepthook)
    _told.clear()
    try:
        yield
    except Exception as raised:
        if _heard.is_set():  # compiled code may give the interruption on as an error of its own, as pydantic's does
            raise KeyboardInterrupt from raised
        raise
    finally:
        if not _heard.is_set():  # else the thread goes on seeing to it, until the interpreter has ended
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(wakeup)
            sys.excepthook = hook
            os.close(writer)


def tell_once() -> None:
    """The line on standard error, if it was not written yet."""
    if not _told.is_set():
        _told.set()
        print(_MESSAGE, file=sys.stderr, flush=True)


def leave() -> NoReturn:
    """End the process after an interruption, with what is registered for its end.

    After a signal the interpreter itself is not taken down. With large libraries and compiled code that takes seconds,
    and the thread that sees to the end could not break it off: Python ends other threads first.
    """
    if not _heard.is_set():
        sys.exit(INTERRUPTED)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # nobody reads any more
            stream.flush()
    os._exit(INTERRUPTED)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _heard.set()
    for each in _SIGNALS:
        signal.signal(each, signal.SIG_IGN)  # one is enough; a second would break off what the first has begun
    raise KeyboardInterrupt


def _of_other_threads(hook: Callable[..., object]) -> Callable[..., object]:
    """The same, but silent about what other threads meet once a signal has come.

    A thread of :mod:`multiprocessing` that hands files to workers meets their end, and may be told of it before this
    process hears of the signal that ended them.
    """

    def of_all(kind: type[BaseException], value: BaseException, trace: TracebackType | None) -> None:
        if threading.current_thread() is threading.main_thread() or not _heard.wait(_GRACE_S / 3):
            hook(kind, value, trace)

    return of_all


def _see_that_it_ends(reader: int) -> None:
    """Woken by the signal itself, which the main thread may not hear for long."""
    while word := os.read(reader, 1):
        if word[0] in _SIGNALS:
            _heard.set()
            threading.Event().wait(_GRACE_S)
            if not _told.is_set():
                os.write(2, f"{_MESSAGE}\n".encode())  # not by the stream, which the main thread may hold
            processes = sys.modules.get("relocbench.execution")
            if processes is not None:
                processes.end_workers()
            os._exit(INTERRUPTED)
    os.close(reader)
