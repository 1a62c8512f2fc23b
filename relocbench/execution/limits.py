"""Limits of time and memory on third-party code, and how a worker process reports what it is doing.

Code in a worker marks each call of a method by :func:`step`. The process that waits for the worker ends it when a step
takes too long or too much memory: code that hangs cannot be asked to stop.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

TIME_LIMIT_S = 300.0
"""the default limit for one pair or image"""
MANY_TIMES = 10.0
"""factor on the time limit for what is done once: the constructor, preparing, and a first call, which may compile"""
IN_A_ROW = 10
"""calls of a method that may be lost with no answer in between; then the method is given up"""
_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12, "KI": 2**10, "MI": 2**20, "GI": 2**30, "TI": 2**40}


@dataclass(frozen=True)
class Limits:
    """Limits of one step of a method."""

    time_s: float = TIME_LIMIT_S
    memory_bytes: int | None = None
    """resident memory of the worker process with its children; None for no limit"""


@dataclass(frozen=True)
class Step:
    """A call of a method in a worker."""

    name: str
    """in words; empty where the keys are description enough"""
    keys: tuple[Any, ...] = ()
    """the pairs that the call is about"""
    times: float = 1.0
    """factor on the time limit"""


@dataclass(frozen=True)
class Loss:
    """How a worker ended before its unit was done."""

    step: Step | None
    """the call in progress; None between calls"""
    kind: Literal["time", "memory", "death"]
    words: str
    """which limit was exceeded; for a death, the exit status or signal"""
    workers: int = 1
    """number of workers that ended on the unit, one after the other"""

    @property
    def how(self) -> str:
        """That the worker died and how, or which limit was exceeded."""
        return f"the worker process died ({self.words})" if self.kind == "death" else self.words


@contextmanager
def step(name: str, keys: tuple[Any, ...] = (), times: float = 1.0) -> Iterator[None]:
    """Mark a call of a method, for the limits. Outside of worker processes this has no effect."""
    for tell in _listeners:
        tell(Step(name, keys, times))
    try:
        yield
    finally:
        for tell in _listeners:
            tell(None)


_listeners: list[Callable[[Step | None], None]] = []


def tell_steps_to(tell: Callable[[Step | None], None]) -> None:
    """Call ``tell`` with each step that begins from now on, and with None when it ends."""
    _listeners[:] = [tell]


def parse_size(text: str | int | float) -> int:
    """The number of bytes in ``4GB``, ``512 MiB``, ``2.5G`` or a plain number. Raises ValueError."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([KMGT]?I?)B?\s*", str(text).upper())
    if found is None or found[2] not in _UNITS:
        raise ValueError("expected a size such as 4GB or 512MiB")
    return int(float(found[1]) * _UNITS[found[2]])


def size_text(size: int) -> str:
    """A number of bytes as people read it: ``4 GB``."""
    for name, unit in (("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if size >= unit:
            return f"{size / unit:.4g} {name}"
    return f"{size} bytes"
