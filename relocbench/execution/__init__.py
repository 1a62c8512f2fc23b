"""Where work runs: this process, local worker processes, or a Dask cluster.

A unit of work is a call of one function with one picklable argument. Units are independent and idempotent, and write
their output whole. A bounded number of units is in progress at a time, so that memory does not grow with their number.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Literal, Self, TypeVar

from relocbench.errors import ConfigError
from relocbench.execution.calling import messages_to_stderr, on_one_core, pin_threads
from relocbench.execution.descendants import end_descendants
from relocbench.execution.limits import (
    IN_A_ROW,
    MANY_TIMES,
    TIME_LIMIT_S,
    Limits,
    Loss,
    Step,
    parse_size,
    step,
)
from relocbench.execution.memory import can_watch, peak_resident_bytes
from relocbench.execution.namespaces import SIGNALLED
from relocbench.execution.processes import kept_workers, run_on_processes, run_with_limits
from relocbench.execution.sandbox import NO_SANDBOX, NONE, Sandbox, working_sandbox
from relocbench.execution.scheduler import Scheduler
from relocbench.execution.scratch import ScratchFolder, shared_folders
from relocbench.execution.worker_process import end_workers

__all__ = [
    "IN_A_ROW",
    "MANY_TIMES",
    "SIGNALLED",
    "TIME_LIMIT_S",
    "Limits",
    "Loss",
    "Run",
    "Sandbox",
    "SandboxChoice",
    "Scheduler",
    "ScratchFolder",
    "Step",
    "chunks",
    "default_workers",
    "end_descendants",
    "end_workers",
    "kept_workers",
    "messages_to_stderr",
    "on_one_core",
    "parse_size",
    "peak_resident_bytes",
    "pin_threads",
    "run_limited",
    "run_units",
    "shared_folders",
    "step",
]

SandboxChoice = Literal["auto", "required", "none"]
Unit = TypeVar("Unit")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Run:
    """Where units of work run, and their limits."""

    workers: int = 1
    """number of local worker processes, each of which uses a single thread"""
    scheduler: Scheduler | None = None
    """a Dask scheduler, whose workers replace local ones"""
    limits: Limits = field(default_factory=Limits)
    """limits of each call of third-party code (:func:`run_limited`); a scheduler's workers have limits of their own"""
    sandbox: SandboxChoice = "auto"
    """whether processes of methods have a sandbox: where the system has one, always (or not at all), or never"""
    hidden: tuple[Path, ...] = ()
    """folders that processes of methods find empty in a sandbox"""
    one_core: bool = False
    """whether processes of methods are bound to one core, as by :func:`on_one_core`"""

    @property
    def in_subprocess(self) -> bool:
        """Whether the work runs in other processes than this one."""
        return self.scheduler is not None or self.workers > 0

    def hiding(self, *folders: Path) -> Self:
        """The same, with more folders that processes of methods find empty."""
        return replace(self, hidden=tuple(dict.fromkeys((*self.hidden, *(folder.resolve() for folder in folders)))))

    def sandbox_of_methods(self) -> Sandbox:
        """The sandbox that a method's processes are started in.

        Raises:
            ConfigError: there must be one, and this system has none.
        """
        required = self.sandbox == "required"
        if required and not self.in_subprocess:
            raise ConfigError("--sandbox required: --workers 0 runs methods in this process, which has no sandbox")
        if self.sandbox == "none" or not self.in_subprocess:
            return Sandbox(NONE)
        if self.scheduler is not None:
            return Sandbox("", self.hidden, required)  # what each worker's system has
        kind = working_sandbox()
        if required and kind == NONE:
            raise ConfigError(NO_SANDBOX)
        return Sandbox(kind, self.hidden)

    def single_process(self) -> Self:
        """The same without worker processes, for work that is shorter than their start."""
        return replace(self, workers=1)

    def with_shared_folders(self, writes: Path, *reads: Path | None) -> Self:
        """The same for work that writes to one folder and reads others, all of which a cluster's workers must see."""
        if self.scheduler is None:
            return self
        return replace(self, scheduler=self.scheduler.with_shared_folders(writes, *reads))


def default_workers() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_units(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    run: Run = Run(),
) -> Iterator[tuple[int, Result]]:
    """Run ``function`` on every unit and yield (index, result) as they finish.

    Args:
        function: can be imported by name (worker processes import it) and pickled, as can its arguments and results.
        run: with at most one worker, this process does the work. Limits are not enforced here.

    Raises:
        RelocbenchError: a worker died twice on the same unit, or no scheduler or worker is left.
        Exception: whatever ``function`` raises, immediately; units that have finished have written their output.
    """
    if run.scheduler is not None:
        from relocbench.execution.cluster import run_on_cluster

        yield from run_on_cluster(function, units, run.scheduler)
    elif run.workers <= 1 or len(units) <= 1:
        yield from _run_here(function, units)
    else:
        yield from run_on_processes(function, units, run.workers)


def run_limited(
    function: Callable[[Unit], Result],
    series: Sequence[Iterable[Unit]],
    run: Run,
    *,
    on_loss: Callable[[Unit, Loss], Result],
) -> Iterator[tuple[int, Result]]:
    """Run units that call third-party code as :func:`run_units` does, but always in another process, within limits.

    ``function`` marks such calls with :func:`step`.

    Args:
        series: units, consumed one by one as workers become free. A worker stays with a series while there are units
            in it, and begins another one before it helps: what the first unit has started may serve the next.
        run: with no worker, this process does the work, without limits, for use with a debugger.
        on_loss: returns the result of a unit whose worker died or was ended.

    Raises:
        ConfigError: a memory limit on a system that does not report the memory of processes.
        RelocbenchError: worker processes cannot start, or no scheduler answers.
        Exception: whatever ``function`` raises, immediately.
    """
    if run.scheduler is not None:
        from relocbench.execution.cluster import run_on_cluster

        died = Loss(None, "death", "lost by two workers of the cluster", workers=2)
        units = list(chain.from_iterable(series))
        yield from run_on_cluster(function, units, run.scheduler, lambda unit: on_loss(unit, died))
    elif run.workers <= 0:
        yield from _run_here(function, chain.from_iterable(series))
    elif run.limits.memory_bytes is not None and not can_watch():
        raise ConfigError("--memory-limit needs /proc, which reports the memory of processes; this system has none")
    else:
        yield from run_with_limits(function, series, run.workers, run.limits, on_loss)


def _run_here(function: Callable[[Unit], Result], units: Iterable[Unit]) -> Iterator[tuple[int, Result]]:
    for index, unit in enumerate(units):
        with messages_to_stderr():
            result = function(unit)
        yield index, result


def chunks(items: Iterable[Unit], size: int) -> Iterator[list[Unit]]:
    """Yield lists of at most ``size`` items, in order."""
    chunk: list[Unit] = []
    for item in items:
        chunk.append(item)
        if len(chunk) == size:
            yield chunk
            chunk = []
    if chunk:
        yield chunk
