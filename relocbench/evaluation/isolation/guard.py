"""The boundary to a method's own code: whatever it raises costs the call in progress, not the run."""

from __future__ import annotations

import errno
import operator
import signal
import sysconfig
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from relocbench.errors import one_line, raised
from relocbench.tracking import MOST_QUERIES, SupportsBatch

MOST_NEIGHBOURS = 100
"""frames on each side of a keyframe that a tracker may request"""


def guarded(call: Callable[[], Any], *, placed: bool = False) -> tuple[Any, str | None]:
    """Call a method's own code and catch whatever it raises.

    Everything that can be raised is caught, ``KeyboardInterrupt`` included. Only where the user did interrupt is
    ``KeyboardInterrupt`` raised again, even if the method caught it.

    Args:
        placed: also tell the file and line, for the author of the method; results do not keep paths of a machine.

    Returns:
        the value, and None or what was raised, in one line.
    """
    with _interrupts() as came:
        try:
            value, crash = call(), None
        except BaseException as bad:  # noqa: BLE001  the boundary to code that is not ours
            value, crash = None, raised(bad) + (_place(bad) if placed else "") + _way_out(bad)
    if came:
        raise KeyboardInterrupt
    return value, crash


def _way_out(bad: BaseException) -> str:
    sandboxed = isinstance(bad, OSError) and bad.errno == errno.EROFS
    return " (a method writes below TMPDIR and HOME, or runs with --sandbox none)" if sandboxed else ""


def _place(bad: BaseException) -> str:
    """Where it was raised: the last line of code that is neither installed nor ours, else the last one of a file."""
    try:
        frames = traceback.extract_tb(bad.__traceback__)[1:]  # the first is that of guarded
    except BaseException:  # noqa: BLE001  an exception whose traceback cannot be read has no place
        return ""
    apart = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    apart.append(str(Path(__file__).parents[2]))  # relocbench itself
    of_files = [frame for frame in frames if Path(frame.filename).is_absolute()]
    own = [frame for frame in of_files if not any(Path(frame.filename).is_relative_to(folder) for folder in apart)]
    for frame in (own or of_files)[-1:]:
        return f" ({one_line(frame.filename, 300)}, line {frame.lineno})"
    return ""


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Record the interrupt signals that arrive meanwhile; they keep their usual effect."""
    came: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():
        yield came  # worker processes ignore Ctrl-C, and other threads never receive it
        return
    act = before

    def note(number: int, frame: Any) -> None:
        came.append(number)
        act(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)


def implements(method: Any, protocol: Any) -> bool:
    """Whether a method implements a protocol; an attribute that cannot be read counts as missing."""
    return bool(guarded(lambda: isinstance(method, protocol))[0])


def capabilities(method: Any) -> tuple[bool, bool]:
    """Whether a tracker, or its class, can match single pixels, and whether it starts from a prior."""
    match = guarded(lambda: callable(getattr(method, "match", None)))[0] is True
    return match, guarded(lambda: bool(getattr(method, "uses_prior", False)))[0] is True


def neighbours_of(tracker: Any) -> tuple[int, str | None]:
    """The number of frames on each side of a keyframe that a tracker requests; and what is wrong with its request."""
    return _count(tracker, "neighbours", 0, least=0, most=MOST_NEIGHBOURS)


def batch_of(tracker: Any) -> tuple[int, str | None]:
    """The number of queries that a tracker answers in one call; and what is wrong with its ``batch_size``."""
    if not implements(tracker, SupportsBatch):
        return 1, None
    count, fault = _count(tracker, "batch_size", MOST_QUERIES, least=1)
    return min(count, MOST_QUERIES), fault


def _count(tracker: Any, name: str, usual: int, *, least: int, most: int | None = None) -> tuple[int, str | None]:
    """An attribute that is a whole number, or the least that is allowed and what is wrong with it."""
    value, crash = guarded(lambda: getattr(tracker, name, usual))
    if crash is not None:
        return least, f"its attribute '{name}' cannot be read: {crash}"
    count, crash = guarded(lambda: int(operator.index(value)))
    if crash is not None or count < least or (most is not None and count > most):
        shown, to = guarded(lambda: one_line(value, 100))[0], "" if most is None else f" to {most}"
        return least, f"its attribute '{name}' is {shown}, expected a whole number from {least}{to}"
    return count, None
