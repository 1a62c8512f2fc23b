"""Where work runs: this process, local worker processes, or a Dask cluster.

A unit of work is a call of one function on one picklable argument: independent, idempotent, its output written
whole. Only a bounded number of units is in flight, so that memory does not grow with their number.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for
from typing import Any, TypeVar

from relocbench.errors import ConfigError, RelocbenchError

Unit = TypeVar("Unit")
Result = TypeVar("Result")

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
SCHEDULER_TIMEOUT = "10s"
"""how long a Dask scheduler may take to answer"""
_IN_FLIGHT_PER_WORKER = 2
_TRIES = 2


def default_workers() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_units(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    *,
    workers: int = 1,
    scheduler: str | None = None,
    on_lost: Callable[[Unit], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run ``function`` on every unit and yield (index, result) as they finish.

    Args:
        function: importable by name (a worker process imports it) and picklable, as are its arguments and results.
        workers: local worker processes; 0 or 1 runs in this process. Each worker computes with one thread.
        scheduler: address of a Dask scheduler; takes the place of local workers.
        on_lost: makes the result of a unit on which a local worker died twice; without it that is an error.

    Raises:
        RelocbenchError: a worker died twice on the same unit, or no scheduler answers.
        Exception: what ``function`` raises, at once; units already finished have written their output.
    """
    if scheduler is not None:
        yield from _run_on_cluster(function, units, scheduler)
    elif workers <= 1 or len(units) <= 1:
        for index, unit in enumerate(units):
            with messages_to_stderr():
                result = function(unit)
            yield index, result
    else:
        yield from _run_on_processes(function, units, workers, on_lost)


@contextmanager
def kept_workers() -> Iterator[None]:
    """Within it, worker processes are kept from one call of :func:`run_units` to the next, unless one died.

    A process that has imported what it works with and built its method goes on at once; a fresh one takes seconds.
    """
    if _kept.get() is not None:
        yield
        return
    kept: dict[int, ProcessPoolExecutor] = {}
    token = _kept.set(kept)
    try:
        yield
    finally:
        _kept.reset(token)
        for pool in kept.values():
            pool.shutdown(wait=True, cancel_futures=True)


_kept: ContextVar[dict[int, ProcessPoolExecutor] | None] = ContextVar("_kept", default=None)
"""pools by their number of workers"""


@contextmanager
def messages_to_stderr() -> Iterator[None]:
    """What code that is not ours prints is a message; standard output holds a command's result alone (``--json``).

    The descriptor itself is turned round, so that libraries and child processes obey too.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def pin_threads() -> None:
    """One thread for each library that would start its own, so that N workers use N cores."""
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@contextmanager
def _single_threaded_children() -> Iterator[None]:
    """Thread counts are read from the environment when a library is loaded: set it before a child starts."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _call(function: Callable[[Unit], Result], unit: Unit) -> Result:
    with messages_to_stderr():
        result = function(unit)
    pin_threads()
    return result


def _run_on_processes(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    workers: int,
    on_lost: Callable[[Unit], Result] | None,
) -> Iterator[tuple[int, Result]]:
    """A pool that breaks (a worker was killed or crashed) costs the units in hand one try each.

    Which of them broke it is not known, so that they are tried again one at a time, each in a pool of its own.
    """
    suspects: list[int] = []
    remaining = iter(range(len(units)))
    with _single_threaded_children():
        while True:
            with _pool_to_use(workers, len(units)) as pool:
                broken = yield from _drain(pool, function, units, remaining, workers * _IN_FLIGHT_PER_WORKER)
                if broken and (kept := _kept.get()) is not None:
                    kept.pop(workers).shutdown(wait=False)
            suspects.extend(broken)
            if not broken:
                break
        for index in suspects:
            with _pool(1) as pool:
                try:
                    result = pool.submit(_call, function, units[index]).result()
                except BrokenProcessPool:
                    if on_lost is None:
                        raise RelocbenchError(
                            f"a worker process died {_TRIES} times on unit {index} ({str(units[index])[:200]}); "
                            "out of memory, or a crash in native code"
                        ) from None
                    result = on_lost(units[index])
            yield index, result


def _drain(
    pool: Executor,
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    remaining: Iterator[int],
    window: int,
) -> Generator[tuple[int, Result], None, list[int]]:
    """Yield results until all units are done or the pool breaks; returns the indices that broke with it."""
    flying: dict[Future[Result], int] = {}
    broken: list[int] = []
    try:
        while not broken:
            while len(flying) < window and (index := next(remaining, None)) is not None:
                try:
                    flying[pool.submit(_call, function, units[index])] = index
                except BrokenProcessPool:
                    broken.append(index)
                    break
            if not flying:
                break
            done, _ = wait(flying, return_when=FIRST_COMPLETED)
            for future in done:
                index = flying.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    broken.append(index)
                else:
                    yield index, result
    finally:
        for future in flying:
            future.cancel()
    for future, index in flying.items():
        if future.done() and not future.cancelled() and future.exception() is None:
            yield index, future.result()
        else:
            broken.append(index)
    return broken


def _pool(workers: int) -> ProcessPoolExecutor:
    # A fresh interpreter: forking one that holds threads (OpenMP, Open3D, torch) can hang.
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_start_worker)


@contextmanager
def _pool_to_use(workers: int, units: int) -> Iterator[ProcessPoolExecutor]:
    """The one that is kept, or one for this call alone."""
    kept = _kept.get()
    if kept is None:
        with _pool(min(workers, units)) as pool:
            yield pool
        return
    if workers not in kept:
        kept[workers] = _pool(workers)
    yield kept[workers]


def _start_worker() -> None:
    pin_threads()
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """A job that is killed takes its workers along: they would go on with what is queued, beside the job run again."""
    wait_for([sentinel])
    os._exit(1)


def _run_on_cluster(
    function: Callable[[Unit], Result], units: Sequence[Unit], scheduler: str
) -> Iterator[tuple[int, Result]]:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise ConfigError("--scheduler needs the optional extra: pip install 'relocbench[cluster]'") from None
    try:
        client = Client(scheduler, timeout=SCHEDULER_TIMEOUT)
    except (OSError, TimeoutError, ValueError) as bad:
        raise ConfigError(f"no Dask scheduler answers at {scheduler} ({bad})") from None
    with client:
        threads_of = client.nthreads()
        if any(threads > 1 for threads in threads_of.values()):
            # Workers keep trackers, and a tracker need not be safe to call from two threads at once.
            raise ConfigError(f"workers of {scheduler} run several threads each; start them with --nthreads 1")
        threads = len(threads_of) or 1
        waiting = deque(range(len(units)))

        def submit(index: int) -> Any:
            future = client.submit(_call, function, units[index], pure=False, retries=0)
            indices[future.key] = index
            return future

        indices: dict[Any, int] = {}
        first = [submit(waiting.popleft()) for _ in range(min(len(waiting), threads * _IN_FLIGHT_PER_WORKER))]
        queue = as_completed(first)
        for future in queue:
            result = future.result()
            yield indices.pop(future.key), result
            if waiting:
                queue.add(submit(waiting.popleft()))


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
