"""Where work runs: this process, local worker processes, or a Dask cluster.

A unit of work is a call of one function on one picklable argument: independent, idempotent, its output written
whole. Only a bounded number of units is in flight, so that memory does not grow with their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self, TypeVar

from relocbench.errors import ConfigError
from relocbench.execution.cluster import run_on_cluster
from relocbench.execution.limits import (
    MANY_TIMES,
    TIME_LIMIT_S,
    Limits,
    Loss,
    Step,
    parse_size,
    step,
)
from relocbench.execution.memory import can_watch
from relocbench.execution.output import messages_to_stderr
from relocbench.execution.processes import kept_workers, run_on_processes, run_with_limits
from relocbench.execution.scheduler import Scheduler
from relocbench.execution.worker_process import end_workers

__all__ = [
    "MANY_TIMES",
    "TIME_LIMIT_S",
    "Limits",
    "Loss",
    "Run",
    "Scheduler",
    "Step",
    "chunks",
    "default_workers",
    "end_workers",
    "kept_workers",
    "messages_to_stderr",
    "parse_size",
    "run_limited",
    "run_units",
    "step",
]

Unit = TypeVar("Unit")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Run:
    """Where units of work run, and what one may take."""

    workers: int = 1
    """local worker processes, each of which computes with one thread"""
    scheduler: Scheduler | None = None
    """a Dask scheduler, whose workers take the place of local ones"""
    limits: Limits = field(default_factory=Limits)
    """of each call of code that is not ours (:func:`run_limited`); a scheduler's workers have limits of their own"""

    def alone(self) -> Self:
        """The same without worker processes, for work that ends before they have started."""
        return replace(self, workers=1)

    def sharing(self, writes: Path, *reads: Path | None) -> Self:
        """The same for work that writes to one folder and reads others: a cluster's workers must see them."""
        return self if self.scheduler is None else replace(self, scheduler=self.scheduler.sharing(writes, *reads))


def default_workers() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_units(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    run: Run = Run(),
    *,
    on_lost: Callable[[Unit], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run ``function`` on every unit and yield (index, result) as they finish.

    Args:
        function: importable by name (a worker process imports it) and picklable, as are its arguments and results.
        run: with no worker or one, this process does the work. Limits mean nothing here.
        on_lost: makes the result of a unit on which a worker died twice; without it that is an error.

    Raises:
        RelocbenchError: a worker died twice on the same unit, or no scheduler or worker is left.
        Exception: what ``function`` raises, at once; units already finished have written their output.
    """
    if run.scheduler is not None:
        yield from run_on_cluster(function, units, run.scheduler, on_lost)
    elif run.workers <= 1 or len(units) <= 1:
        for index, unit in enumerate(units):
            with messages_to_stderr():
                result = function(unit)
            yield index, result
    else:
        yield from run_on_processes(function, units, run.workers, on_lost)


def run_limited(
    function: Callable[[Unit], Result],
    units: Iterable[Unit],
    run: Run,
    *,
    on_loss: Callable[[Unit, Loss], Result],
) -> Iterator[tuple[int, Result]]:
    """As :func:`run_units`, for units that call code which is not ours: always in another process, within limits.

    ``function`` says by :func:`step` when it calls such code.

    Args:
        units: taken when a worker is free for them.
        run: with no worker this process does the work, without limits, for a debugger.
        on_loss: makes the result of a unit whose worker died or was ended.

    Raises:
        ConfigError: a limit of memory on a system that does not tell what processes hold.
        RelocbenchError: worker processes cannot start, or no scheduler answers.
        Exception: what ``function`` raises, at once.
    """
    if run.scheduler is not None:
        died = Loss(None, "death", "lost by two workers of the cluster", workers=2)
        yield from run_on_cluster(function, list(units), run.scheduler, lambda unit: on_loss(unit, died))
    elif run.workers <= 0:
        for index, unit in enumerate(units):
            with messages_to_stderr():
                result = function(unit)
            yield index, result
    elif run.limits.memory_bytes is not None and not can_watch():
        raise ConfigError("--memory-limit needs /proc, which tells what processes hold; this system has none")
    else:
        yield from run_with_limits(function, units, run.workers, run.limits, on_loss)


def chunks(items: Iterable[Unit], size: int) -> Iterator[list[Unit]]:
    """Lists of at most ``size`` items, in order."""
    chunk: list[Unit] = []
    for item in items:
        chunk.append(item)
        if len(chunk) == size:
            yield chunk
            chunk = []
    if chunk:
        yield chunk
