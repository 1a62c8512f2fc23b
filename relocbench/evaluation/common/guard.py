"""The boundary to a method's own code: whatever it raises costs the question, not the run."""

from __future__ import annotations

import operator
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from relocbench.errors import one_line, raised

MOST_NEIGHBOURS = 100
"""frames on each side of a keyframe that a tracker may ask for"""


def guarded(call: Callable[[], Any]) -> tuple[Any, str | None]:
    """The value of a method's own code, or what it raised, in one line: a method's bug costs its question only.

    That holds of everything that can be raised, ``KeyboardInterrupt`` included, unless the user did interrupt: then
    it goes on, even where the method caught it.
    """
    with _interrupts() as came:
        try:
            value, broke = call(), None
        except BaseException as bad:  # noqa: BLE001  the boundary to code that is not ours
            value, broke = None, raised(bad)
    if came:
        raise KeyboardInterrupt
    return value, broke


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Signals of an interruption that reached this process meanwhile; they have the effect that they always have."""
    came: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():
        yield came  # worker processes pass Ctrl-C over; threads never see it
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


def offers(method: Any, protocol: Any) -> bool:
    """Whether a method has what a protocol asks; an attribute that cannot be read is not there."""
    return bool(guarded(lambda: isinstance(method, protocol))[0])


def neighbours_of(tracker: Any) -> tuple[int, str | None]:
    """How many frames on each side of a keyframe a tracker asks for, and what is wrong with what it says of that."""
    value, broke = guarded(lambda: getattr(tracker, "neighbours", 0))
    if broke is not None:
        return 0, f"its attribute 'neighbours' cannot be read: {broke}"
    count, broke = guarded(lambda: operator.index(value))
    if broke is not None or not 0 <= count <= MOST_NEIGHBOURS:
        told = guarded(lambda: one_line(value, 100))[0]
        return 0, f"its attribute 'neighbours' is {told}, expected a whole number from 0 to {MOST_NEIGHBOURS}"
    return int(count), None
