"""Local worker processes, and a pool that gives them units of work."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import count
from multiprocessing.connection import wait as wait_for
from typing import Any, TypeVar

from relocbench.errors import RelocbenchError
from relocbench.execution.limits import Limits, Loss
from relocbench.execution.memory import memory_watched
from relocbench.execution.scratch import sweep
from relocbench.execution.serving import Raised, RemoteTraceback
from relocbench.execution.worker_process import WorkerProcess

Unit = TypeVar("Unit")
Result = TypeVar("Result")

_TRIES = 2
_LOOK_S = 0.25
"""interval at which silent workers are checked"""
_GRACE_S = 1.0
"""time for workers to end by themselves"""


@contextmanager
def kept_workers() -> Iterator[None]:
    """Keep worker processes from one call of :func:`run_units` to the next, unless one died.

    A process that has imported its libraries and constructed its method continues at once; a fresh one takes seconds.
    """
    with _pool_to_use() as pool:
        token = _kept.set(pool)
        try:
            yield
        finally:
            _kept.reset(token)


_kept: ContextVar[Pool | None] = ContextVar("_kept", default=None)


def run_on_processes(
    function: Callable[[Unit], Result], units: Iterable[Unit], workers: int
) -> Iterator[tuple[int, Result]]:
    """Run units without limits; a worker that dies (killed, or crashed) costs its unit one of two tries."""
    tries: dict[int, int] = {}

    def again(index: int, unit: Unit, loss: Loss) -> Iterator[Result]:
        tries[index] = tries.get(index, 0) + 1
        if tries[index] >= _TRIES:
            raise RelocbenchError(
                f"a worker process died {_TRIES} times on unit {index} ({str(unit)[:200]}): {loss.words}; "
                "out of memory, or a crash in native code"
            )
        return iter(())

    with _pool_to_use() as pool:
        yield from pool.run(function, [units], workers, again, None)


def run_with_limits(
    function: Callable[[Unit], Result],
    series: Sequence[Iterable[Unit]],
    workers: int,
    limits: Limits,
    on_loss: Callable[[Unit, Loss], Result],
) -> Iterator[tuple[int, Result]]:
    """Run units within limits; if a worker dies or is ended, ``on_loss`` returns the result of its unit."""

    def lost(index: int, unit: Unit, loss: Loss) -> Iterator[Result]:
        yield on_loss(unit, loss)

    with _pool_to_use() as pool:
        yield from pool.run(function, series, workers, lost, limits)


class Pool:
    """Worker processes; each has one unit at a time, so that it is known what a death costs."""

    def __init__(self) -> None:
        self.workers: list[WorkerProcess] = []

    def run(
        self,
        function: Callable[[Any], Any],
        series: Sequence[Iterable[Any]],
        workers: int,
        on_loss: Callable[[int, Any, Loss], Iterator[Any]],
        limits: Limits | None,
    ) -> Iterator[tuple[int, Any]]:
        """Yield (index, result) as units are done.

        Units are consumed as workers become free, and counted in that order; a worker stays with a series while it has
        units. A unit for which ``on_loss`` yields no result is tried again.
        """
        self._drain_abandoned_units()
        left = [iter(units) for units in series]
        numbers = count()
        again: deque[tuple[int, Any]] = deque()
        failed_starts = 0
        with memory_watched(lambda: list(self.workers), None if limits is None else limits.memory_bytes):
            while busy := self._assign_units(function, left, numbers, again, workers):
                for worker, index, unit, report in self._poll_workers(busy, limits):
                    if isinstance(report, Raised):
                        raise report.exception from RemoteTraceback(report.traceback)
                    if not isinstance(report, Loss):
                        yield index, report.result
                        continue
                    self.workers.remove(worker)
                    if not worker.ready:
                        failed_starts += 1
                        if failed_starts >= _TRIES:
                            raise _none_starts(report)
                        again.append((index, unit))
                        continue
                    results = list(on_loss(index, unit, report))
                    if not results:
                        again.append((index, unit))
                    for result in results:
                        yield index, result

    def close(self) -> None:
        """End all workers: idle ones by themselves, and the others at once, with the loss of their work."""
        for worker in self.workers:
            if worker.work is None:
                worker.release()
        until = time.monotonic() + _GRACE_S
        while self.workers:
            worker = self.workers.pop()
            worker.end(until - time.monotonic() if worker.work is None else 0.0)
        sweep()  # what methods' processes of workers that were killed have left behind

    def _assign_units(
        self,
        function: Any,
        left: list[Iterator[Any]],
        numbers: Iterator[int],
        again: deque[tuple[int, Any]],
        workers: int,
    ) -> list[WorkerProcess]:
        """Give every free worker a unit, while there are any; returns the workers that have one."""
        for slot in range(workers):
            worker = self.workers[slot] if slot < len(self.workers) else None
            if worker is not None and worker.work is not None:
                continue
            series = None if worker is None else worker.series
            if again:
                work = again.popleft()
            elif (found := self._next_unit(left, series)) is not None:
                series, unit = found
                work = next(numbers), unit
            else:
                break
            if worker is None:
                worker = WorkerProcess()
                self.workers.append(worker)
            worker.series = series
            worker.give(function, *work)
        return [worker for worker in self.workers if worker.work is not None]

    def _next_unit(self, left: list[Iterator[Any]], last: Iterator[Any] | None) -> tuple[Iterator[Any], Any] | None:
        """The next unit of the series that a worker was given last, or else of one on which the fewest others work."""

        def others(series: Iterator[Any]) -> int:
            return -1 if series is last else sum(worker.series is series for worker in self.workers)

        for series in sorted(left, key=others):
            for unit in series:
                return series, unit
            left.remove(series)
        return None

    def _poll_workers(
        self, busy: list[WorkerProcess], limits: Limits | None
    ) -> Iterator[tuple[WorkerProcess, int, Any, Any]]:
        """Yield what the busy workers have reported about their units."""
        patience = max(0.0, min([_LOOK_S, *(worker.seconds_left() for worker in busy)]))
        wait_for([worker.connection for worker in busy], patience)
        for worker in busy:
            assert worker.work is not None
            index, unit = worker.work
            if (report := worker.listen(limits)) is not None:
                yield worker, index, unit, report

    def _drain_abandoned_units(self) -> None:
        """Free workers of units that an earlier run, which ended early, has left: nobody waits for their results."""
        until = time.monotonic() + _GRACE_S
        for worker in list(self.workers):
            while worker.work is not None:
                wait_for([worker.connection], max(0.0, until - time.monotonic()))
                if isinstance(worker.listen(None), Loss) or (worker.work is not None and time.monotonic() > until):
                    worker.end()
                    self.workers.remove(worker)
                    break


def _none_starts(loss: Loss) -> RelocbenchError:
    return RelocbenchError(
        f"{_TRIES} worker processes ended while they started ({loss.words}); what they printed is on standard error, "
        "above this line. Killed ones mean too little memory: close other programs or use fewer workers (--workers 1). "
        'A script that calls relocbench must do so below `if __name__ == "__main__":`'
    )


@contextmanager
def _pool_to_use() -> Iterator[Pool]:
    """The pool that is being kept, or one for this call alone."""
    kept = _kept.get()
    if kept is not None:
        yield kept
        return
    pool = Pool()
    try:
        yield pool
    finally:
        pool.close()
