"""Where work runs: this process, local worker processes, or a Dask cluster.

A unit of work is a call of one function on one picklable argument: independent, idempotent, its output written
whole. Only a bounded number of units is in flight, so that memory does not grow with their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

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


def default_workers() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_units(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    *,
    workers: int = 1,
    scheduler: Scheduler | None = None,
    on_lost: Callable[[Unit], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run ``function`` on every unit and yield (index, result) as they finish.

    Args:
        function: importable by name (a worker process imports it) and picklable, as are its arguments and results.
        workers: local worker processes; 0 or 1 runs in this process. Each worker computes with one thread.
        scheduler: a Dask scheduler; takes the place of local workers.
        on_lost: makes the result of a unit on which a worker died twice; without it that is an error.

    Raises:
        RelocbenchError: a worker died twice on the same unit, or no scheduler or worker is left.
        Exception: what ``function`` raises, at once; units already finished have written their output.
    """
    if scheduler is not None:
        yield from run_on_cluster(function, units, scheduler, on_lost)
    elif workers <= 1 or len(units) <= 1:
        for index, unit in enumerate(units):
            with messages_to_stderr():
                result = function(unit)
            yield index, result
    else:
        yield from run_on_processes(function, units, workers, on_lost)


def run_limited(
    function: Callable[[Unit], Result],
    units: Iterable[Unit],
    *,
    workers: int,
    scheduler: Scheduler | None = None,
    limits: Limits,
    on_loss: Callable[[Unit, Loss], Result],
) -> Iterator[tuple[int, Result]]:
    """As :func:`run_units`, for units that call code which is not ours: always in another process, within limits.

    ``function`` says by :func:`step` when it calls such code.

    Args:
        units: taken when a worker is free for them.
        workers: at least one process; 0 runs in this process, without limits, for a debugger.
        scheduler: a Dask scheduler; limits are its workers' own.
        on_loss: makes the result of a unit whose worker died or was ended.

    Raises:
        ConfigError: a limit of memory on a system that does not tell what processes hold.
        RelocbenchError: worker processes cannot start, or no scheduler answers.
        Exception: what ``function`` raises, at once.
    """
    if scheduler is not None:
        died = Loss(None, "death", "lost by two workers of the cluster", workers=2)
        yield from run_on_cluster(function, list(units), scheduler, lambda unit: on_loss(unit, died))
    elif workers <= 0:
        for index, unit in enumerate(units):
            with messages_to_stderr():
                result = function(unit)
            yield index, result
    elif limits.memory_bytes is not None and not can_watch():
        raise ConfigError("--memory-limit needs /proc, which tells what processes hold; this system has none")
    else:
        yield from run_with_limits(function, units, workers, limits, on_loss)


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
