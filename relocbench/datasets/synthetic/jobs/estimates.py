"""Estimates of how long a job takes, extrapolated from its first units of work."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.execution import Run, run_units
from relocbench.progress import Advance

Unit = TypeVar("Unit")
Scene = tuple[object, Factors]
"""a district and the condition that it is rendered in"""


@dataclass(frozen=True)
class Spent:
    """Time and disk space that a unit of work took."""

    files: int
    """images or scans"""
    setup_s: float
    """time up to the first file, mostly for preparing the district and its renderer"""
    seconds: float
    """time for the other files"""
    bytes: int = 0

    @classmethod
    def on(cls, sizes: Iterable[int]) -> Spent:
        """The time to go through an iterator that writes a file at each step and yields its size in bytes."""
        begin = ready = time.perf_counter()
        files = total = 0
        for size in sizes:
            files, total = files + 1, total + size
            ready = time.perf_counter() if files == 1 else ready
        return cls(files, ready - begin, time.perf_counter() - ready, total)


@dataclass(frozen=True)
class Remaining:
    """What the rest of a job is expected to take."""

    per_file_s: float
    seconds: float
    gigabytes: float
    measured: int
    """number of files that the estimate is based on"""


def carried_out(work: Callable[[Unit], Spent], units: Sequence[Unit], advance: Advance, run: Run) -> list[Spent]:
    """What each unit took, in the order in which they were finished."""
    spent = []
    for _, done in run_units(work, units, run):
        spent.append(done)
        advance(done.files)
    return spent


def split_pilots(units: Sequence[Unit], scene_of: Callable[[Unit], Scene]) -> tuple[list[Unit], list[Unit]]:
    """The first unit of each condition in one district, and all others."""
    pilots: list[Unit] = []
    rest: list[Unit] = []
    conditions: set[Factors] = set()
    for unit in units:
        district, factors = scene_of(unit)
        new = district == scene_of(units[0])[0] and factors not in conditions
        conditions.add(factors)
        (pilots if new else rest).append(unit)
    return pilots, rest


def remaining(spent: Sequence[Spent], files: int, scenes: int, workers: int) -> Remaining:
    """Extrapolate to the rest of a job.

    The first units ran in parallel, as the rest will. Every worker prepares every scene. A unit's first file is not
    representative and does not count.

    Args:
        files: number of files that are left.
        scenes: number of districts in conditions that are left.
    """
    measured = sum(s.files - 1 for s in spent)
    per_file = sum(s.seconds for s in spent) / measured if measured else float("nan")
    seconds = files * per_file / workers + scenes * float(np.median([s.setup_s for s in spent]))
    size = sum(s.bytes for s in spent) / sum(s.files for s in spent) * files
    return Remaining(per_file, seconds, size / 1e9, measured)


def workers_text(workers: int) -> str:
    """A number of workers in words."""
    return f"{workers} worker{'s' if workers != 1 else ''}"


def rate(workers: int, per_image_s: float) -> str:
    """Images per second as text; unknown if no time was measured."""
    return f"{workers / per_image_s:.1f} images/s" if per_image_s > 0 else "an unknown rate"


def duration(seconds: float) -> str:
    """A duration as text in seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
