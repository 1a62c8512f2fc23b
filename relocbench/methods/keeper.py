"""A supervisor of a program that is run as a method: when either it or its caller ends, all its descendants are ended.

It is run as a script, ``python keeper.py CONTROL PARENT COMMAND...``, and imports only the standard library.
``CONTROL`` is the read end of a pipe that nobody writes to: it reaches its end once the calling process has closed it
or is gone, for whatever reason. The keeper is the subreaper of the program's descendants (``prctl``, Linux): processes
that were forked off become its children when their parents end, even those with a session of their own, and are
killed. It ends as the program ended: with the same status, or by the same signal. Both have sessions of their own: a
signal to the program's group reaches nobody else, and what ends the caller's group leaves the keeper to do its work.
"""

from __future__ import annotations

import ctypes
import os
import resource
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

_SET_PDEATHSIG, _SET_CHILD_SUBREAPER = 1, 36
_LOOK_S = 1.0
_KILLING_S = 5.0


def main(control: int, parent: int, command: list[str]) -> None:
    os.set_inheritable(control, False)
    _own_session()
    _prctl(_SET_CHILD_SUBREAPER, 1)
    # The signal of a child wakes the wait below; its handler need not do anything.
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    program = os.fork()
    if program == 0:
        _become(command)
    # Only the program holds its streams, so that they end when it does.
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)
    status = None
    while status is None and os.getppid() == parent:
        ready, _, _ = select.select([control, woken], [], [], _LOOK_S)
        if woken in ready:
            os.read(woken, 4096)
        status = _reap().get(program)
        if control in ready:
            break
    _end_all()
    if status is not None and os.WIFSIGNALED(status):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        if os.WTERMSIG(status) != signal.SIGKILL:
            signal.signal(os.WTERMSIG(status), signal.SIG_DFL)
        os.kill(os.getpid(), os.WTERMSIG(status))
    os._exit(1 if status is None else os.WEXITSTATUS(status))


def _become(command: list[str]) -> None:
    """Replace this process by the program, which dies with the keeper and has default signal handlers."""
    _own_session()
    signal.set_wakeup_fd(-1)
    for number in (signal.SIGCHLD, signal.SIGINT, signal.SIGPIPE, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    _prctl(_SET_PDEATHSIG, signal.SIGKILL)
    try:
        os.execvp(command[0], command)
    except OSError as bad:
        os.write(2, f"cannot start '{command[0]}' ({bad.strerror})\n".encode(errors="replace"))
    os._exit(127)


def _own_session() -> None:
    with suppress(PermissionError):  # it leads one
        os.setsid()


def _reap() -> dict[int, int]:
    """Collect all children that have ended; returns their statuses by process id."""
    ended = {}
    with suppress(ChildProcessError):
        while True:
            process, status = os.waitpid(-1, os.WNOHANG)
            if not process:
                break
            ended[process] = status
    return ended


def _end_all() -> None:
    """Kill all children until there is none: when a child is gone, its own children become ours."""
    until = time.monotonic() + _KILLING_S
    while (children := _children()) and time.monotonic() < until:
        for process in children:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)
        _reap()
        time.sleep(0.002)


def _children() -> list[int]:
    """The ids of this process's children, including those that have ended but were not waited for."""
    children = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # The program's name is in parentheses and may contain anything.
            fields = stat.read_bytes().rpartition(b")")[2].split()
            if int(fields[1]) == os.getpid():
                children.append(int(stat.parent.name))
    return children


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
