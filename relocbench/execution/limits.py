"""Limits of time and memory on code that is not ours, and what a worker process tells of what it is doing.

Code in a worker says by :func:`step` when a method is called and when it has returned. The process that waits for the
worker ends it when a step takes too long or too much memory: code that hangs cannot be asked to stop.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

TIME_LIMIT_S = 300.0
"""of one pair or image, unless the user says otherwise"""
MANY_TIMES = 10.0
"""as long as one pair may what is done once take: constructing, preparing, a first call that compiles"""
_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12, "KI": 2**10, "MI": 2**20, "GI": 2**30, "TI": 2**40}


@dataclass(frozen=True)
class Limits:
    """What one step of a method may take."""

    time_s: float = TIME_LIMIT_S
    memory_bytes: int | None = None
    """resident, of the worker process with its children; None for no limit"""


@dataclass(frozen=True)
class Step:
    """What a worker has in hand: a call of a method."""

    name: str
    """in words, empty where the keys say it"""
    keys: tuple[Any, ...] = ()
    """what the call is about"""
    times: float = 1.0
    """so many times the time limit are allowed"""


@dataclass(frozen=True)
class Loss:
    """How a worker ended before its unit was done."""

    step: Step | None
    """the call in hand; None between calls"""
    kind: Literal["time", "memory", "death"]
    words: str
    """which limit was passed, or for a death the exit status or signal"""
    workers: int = 1
    """so many ended on it, one after the other"""


@contextmanager
def step(name: str, keys: tuple[Any, ...] = (), times: float = 1.0) -> Iterator[None]:
    """Within it a method is called. Outside of a worker process nobody listens, and there are no limits."""
    for tell in _listeners:
        tell(Step(name, keys, times))
    try:
        yield
    finally:
        for tell in _listeners:
            tell(None)


_listeners: list[Callable[[Step | None], None]] = []


def tell_steps_to(tell: Callable[[Step | None], None]) -> None:
    """From now on ``tell`` hears of each step that begins, and None when it ends."""
    _listeners[:] = [tell]


def parse_size(text: str | int | float) -> int:
    """Bytes of ``4GB``, ``512 MiB``, ``2.5G`` or a plain number. Raises ValueError."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([KMGT]?I?)B?\s*", str(text).upper())
    if found is None or found[2] not in _UNITS:
        raise ValueError(f"'{str(text)[:40]}' is not a size, expected one such as 4GB or 512MiB")
    return int(float(found[1]) * _UNITS[found[2]])


def size_text(size: int) -> str:
    """``4 GB``: bytes as people say them."""
    for name, unit in (("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if size >= unit:
            return f"{size / unit:.4g} {name}"
    return f"{size} bytes"
