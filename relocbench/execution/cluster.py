"""Running units on a Dask cluster: each is sent to a chosen worker, so that it is known which unit a worker died on.

Left to itself, Dask would send a unit that kills its worker to four workers, and would give up other units that wait on
those workers. Here every unit is bound to a worker; a worker that vanishes costs each of its units one try.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeVar

from relocbench.errors import ConfigError, RelocbenchError
from relocbench.execution.calling import call
from relocbench.execution.handshake import check_worker, differences, report, shared_paths, versions_here
from relocbench.execution.scheduler import Scheduler, connected, scheduler_is_gone

Unit = TypeVar("Unit")
Result = TypeVar("Result")

WORKER_TIMEOUT_S = 30.0
"""how long a run waits while there is no worker"""
ANSWER_TIMEOUT_S = 30.0
"""how long a scheduler that has answered before may be silent"""
IN_FLIGHT_PER_WORKER = 2
_TRIES = 2
_POLL_S = 0.5


def run_on_cluster(
    function: Callable[[Unit], Result],
    units: Sequence[Unit],
    scheduler: Scheduler,
    on_lost: Callable[[Unit], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """Run ``function`` on every unit and yield (index, result) as they finish.

    Args:
        on_lost: returns, in this process, the result of a unit on which two workers died.

    Raises:
        ConfigError: no scheduler answers, or a worker has other versions, several threads, or does not see the folders.
        RelocbenchError: the scheduler is gone, or there was no worker for :data:`WORKER_TIMEOUT_S`.
        Exception: whatever ``function`` raises.
    """
    if not units:
        return
    with connected(scheduler) as client, shared_paths(scheduler) as paths:
        yield from _Dispatch(client, scheduler, function, units, on_lost, paths).results()


@dataclass(eq=False)
class _Dispatch(Generic[Unit, Result]):
    """Assigns units to workers and keeps track of both."""

    client: Any
    scheduler: Scheduler
    function: Callable[[Unit], Result]
    units: Sequence[Unit]
    on_lost: Callable[[Unit], Result] | None
    paths: list[Path]

    def __post_init__(self) -> None:
        self.waiting = deque(range(len(self.units)))
        self.suspects: deque[int] = deque()
        """units whose worker died: each is tried again alone on a worker, so that no other unit can be blamed"""
        self.lost: list[int] = []
        self.deaths: Counter[int] = Counter()
        self.done = 0
        self.assigned: dict[str, dict[str, int]] = {}
        """worker -> key -> unit"""
        self.testing_suspect: set[str] = set()
        """workers that try a suspect"""
        self.joining: dict[str, tuple[str, int]] = {}
        """key -> worker that has not reported yet, and its threads"""
        self.futures: dict[str, Any] = {}
        self.ended: SimpleQueue[str] = SimpleQueue()
        self.refreshed = -_POLL_S
        self.worker_seen = time.monotonic()

    def results(self) -> Iterator[tuple[int, Result]]:
        self._compare_scheduler()
        while self.done < len(self.units):
            self._refresh_workers()
            self._assign_units()
            ended = list(dict.fromkeys(self._wait()))
            for key in ended:
                if key in self.joining:
                    self._admit(key)
            yield from self._collect_results([key for key in ended if self._is_finished(key)])
            while self.lost and self.assigned:
                yield self._give_up_unit(self.lost.pop())

    @property
    def progress(self) -> str:
        return f"{self.done} of {len(self.units)} units are done; the same command resumes the work"

    def _compare_scheduler(self) -> None:
        remote = self._ask(lambda: self.client.scheduler.versions)
        local = {name: version for name, version in versions_here().items() if name in ("dask", "distributed")}
        different = differences(local, remote.get("packages", {}))
        if different:
            raise ConfigError(f"the scheduler at {self.scheduler} runs other versions: {different}")

    def _refresh_workers(self) -> None:
        """Find out which workers have joined and which have left."""
        now = time.monotonic()
        if now - self.refreshed < _POLL_S:
            return
        self.refreshed = now
        threads = self._workers()
        known = {*self.assigned, *(worker for worker, _ in self.joining.values())}
        for worker in known - threads.keys():
            self._drop_worker(worker)
        for worker in threads.keys() - known:
            future = self.client.submit(report, self.paths, workers=[worker], pure=False, retries=0)
            self.joining[future.key] = worker, threads[worker]
            self._watch_future(future)
        if threads:
            self.worker_seen = now
        elif now - self.worker_seen > WORKER_TIMEOUT_S:
            what = "is left" if self.done or self.deaths else "has joined"
            raise RelocbenchError(
                f"no worker of {self.scheduler} {what} within {WORKER_TIMEOUT_S:g} s; {self.progress}"
            )

    def _workers(self) -> dict[str, int]:
        """The number of threads of each worker that the scheduler knows."""
        threads: dict[str, int] = self._ask(lambda: self.client.scheduler.ncores)
        return threads

    def _ask(self, question: Callable[[], Callable[[], Any]]) -> dict[str, Any]:
        """Ask the scheduler. Raises RelocbenchError if it is gone."""
        try:
            if self.client.status == "running":
                answer: dict[str, Any] = self.client.sync(question(), callback_timeout=ANSWER_TIMEOUT_S)
                return answer
        except (OSError, RuntimeError, AttributeError):  # the latter two if the client closed itself meanwhile
            pass
        raise scheduler_is_gone(self.scheduler, self.progress)

    def _watch_future(self, future: Any) -> None:
        self.futures[future.key] = future
        future.add_done_callback(lambda ended: self.ended.put(ended.key))

    def _assign_units(self) -> None:
        for worker, held in self.assigned.items():
            while self.waiting and len(held) < IN_FLIGHT_PER_WORKER and worker not in self.testing_suspect:
                self._send(self.waiting.popleft(), worker)
            if self.suspects and not held:
                self.testing_suspect.add(worker)
                self._send(self.suspects.popleft(), worker)

    def _send(self, index: int, worker: str) -> None:
        future = self.client.submit(call, self.function, self.units[index], workers=[worker], pure=False, retries=0)
        self.assigned[worker][future.key] = index
        self._watch_future(future)

    def _wait(self) -> list[str]:
        """Wait for at most one polling interval; returns the keys that ended."""
        keys = []
        with suppress(Empty):
            keys.append(self.ended.get(timeout=_POLL_S))
            while True:
                keys.append(self.ended.get_nowait())
        return keys

    def _admit(self, key: str) -> None:
        worker, threads = self.joining[key]
        future = self.futures[key]
        if future.status == "cancelled":
            raise self._cancelled()
        if future.status == "error":
            reason = " ".join(str(future.exception()).split())[:200]
            raise ConfigError(f"worker {worker} of {self.scheduler} cannot run relocbench ({reason})")
        try:
            worker_report = future.result(timeout=ANSWER_TIMEOUT_S)
        except OSError:
            self._ask_again(key)
            return
        except CancelledError:
            raise self._cancelled() from None
        del self.joining[key], self.futures[key]
        check_worker(worker, threads, worker_report, self.scheduler)
        self.assigned[worker] = {}

    def _is_finished(self, key: str) -> bool:
        """Whether a unit ended with a result. Raises whatever it raised."""
        from distributed.scheduler import KilledWorker

        if key not in self.futures or key in self.joining:
            return False
        future = self.futures[key]
        if future.status == "cancelled":
            raise self._cancelled()
        if future.status != "error":
            return True
        if not isinstance(future.exception(), KilledWorker):
            future.result()  # raises what the unit raised
        self._count_death(self._release(key))  # a worker came back under the same address before it was missed
        return False

    def _collect_results(self, keys: list[str]) -> Iterator[tuple[int, Result]]:
        """Fetch the results of finished units in one message: one message for each would cost a round trip each."""
        if not keys:
            return
        futures = [self.futures[key] for key in keys]
        try:
            results: list[Result] = self.client.sync(self._gather, futures, callback_timeout=ANSWER_TIMEOUT_S)
        except OSError:  # a worker died before its result was fetched, or the scheduler is gone
            self._ask_again(*keys)
            return
        except CancelledError:
            raise self._cancelled() from None
        indices = [self._release(key) for key in keys]
        self._assign_units()
        for index, result in zip(indices, results, strict=True):
            self.done += 1
            yield index, result

    async def _gather(self, futures: list[Any]) -> list[Result]:
        """Gather results. Raises TimeoutError if one is lost with its worker, which Dask would wait for."""
        fetching = asyncio.ensure_future(self.client.gather(futures, asynchronous=True))
        try:
            while not (await asyncio.wait([fetching], timeout=_POLL_S))[0]:
                if any(future.status not in ("finished", "cancelled") for future in futures):
                    raise TimeoutError("a result is lost")
            out: list[Result] = await fetching
            return out
        finally:
            fetching.cancel()

    def _ask_again(self, *keys: str) -> None:
        """Look at keys again later: the next refresh tells whether workers and scheduler still exist."""
        time.sleep(_POLL_S / 10)
        for key in keys:
            self.ended.put(key)

    def _release(self, key: str) -> int:
        worker = next(name for name, held in self.assigned.items() if key in held)
        self.futures.pop(key).release()
        index = self.assigned[worker].pop(key)
        if not self.assigned[worker]:
            self.testing_suspect.discard(worker)
        return index

    def _drop_worker(self, worker: str) -> None:
        """Take back the units of a worker that is gone."""
        for key in [key for key, (name, _) in self.joining.items() if name == worker]:
            del self.joining[key]
            self.futures.pop(key).release()
        for key in list(self.assigned.get(worker, {})):
            self._count_death(self._release(key))
        self.assigned.pop(worker, None)

    def _count_death(self, index: int) -> None:
        self.deaths[index] += 1
        (self.suspects if self.deaths[index] < _TRIES else self.lost).append(index)

    def _give_up_unit(self, index: int) -> tuple[int, Result]:
        """Give a unit up. Only called while a worker lives: when a cluster is shut down, no unit is to blame."""
        unit = self.units[index]
        if self.on_lost is None:
            raise RelocbenchError(
                f"a worker process died {_TRIES} times on unit {index} ({str(unit)[:200]}); "
                "out of memory, or a crash in native code"
            )
        self.done += 1
        return index, self.on_lost(unit)

    def _cancelled(self) -> RelocbenchError:
        self._workers()  # raises where the scheduler is gone
        return RelocbenchError(f"the work was cancelled at {self.scheduler}, by a restart perhaps; {self.progress}")
