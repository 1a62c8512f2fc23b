"""The registration of query drives as units of work, each with a journal, so that a killed one continues where it was.

Each line of a journal is a JSON list of a key and a result. When the registration runs again it makes the same requests
in the same order; as long as the keys agree with those of the journal, their results are taken from it.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

import numpy as np

from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.registration.along_drive import Remember
from relocbench.datasets.groundtruth.registration.files import write_registrations
from relocbench.datasets.groundtruth.registration.hypotheses import SearchResult
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.execution import Run, run_units
from relocbench.files import parse_json, read_bytes
from relocbench.progress import Advance, Reporter

_POLL_S = 0.5


class Journal:
    """The results of one drive's registration so far; numbers are read back bit for bit."""

    def __init__(self, path: Path) -> None:
        self._path = path
        lines = _whole_lines(path)
        self._known: deque[tuple[str, bytes, SearchResult]] = deque()
        for line in lines:
            try:
                key, stored = parse_json(line)
                self._known.append((key, line, _restored(stored)))
            except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
                break
        path.parent.mkdir(parents=True, exist_ok=True)
        self._used = 0
        """bytes of the lines that were used again"""
        self._stream = path.open("wb")
        self._stream.writelines(line for _, line, _ in self._known)
        self._stream.flush()

    def remember(self, key: str, work: Callable[[], SearchResult]) -> SearchResult:
        """The result of ``work``, from the journal if it was done before."""
        if self._known:
            known, line, result = self._known.popleft()
            if known == key:
                self._used += len(line)
                return result
            # The journal is of other work, so that nothing from here on can be used.
            self._known.clear()
            self._stream.seek(self._used)
            self._stream.truncate()
        result = work()
        try:
            self._stream.write((json.dumps([key, _stored(result)], default=_plain) + "\n").encode())
            self._stream.flush()
        except OSError as bad:
            bad.filename = bad.filename or str(self._path)  # the error of a full disk names no file
            raise
        return result

    def close(self) -> None:
        """Close the file, which stays; removing it is up to the caller."""
        self._stream.close()


@dataclass(frozen=True, eq=False)
class JournaledUnit:
    """The registrations of one query drive: a unit of work that is continued from its journal if it was killed."""

    title: str
    work: Callable[[Callable[[str], None], Remember], list[Registration]]
    """(say, remember) -> the registrations; see :func:`.along_drive.register_along`"""
    steps: int
    """number of registrations"""
    table: Path
    """of the registrations, once they are complete; the journal is beside it"""
    nodes: tuple[Nodes, Nodes]
    """of the reference and the query, which the table numbers"""
    messages_of: str
    """what its messages are about"""

    def __str__(self) -> str:
        return self.title

    @property
    def journal(self) -> Path:
        return self.table.with_suffix(".journal")


def register_missing(stage: str, units: Sequence[JournaledUnit], reporter: Reporter, run: Run) -> None:
    """Do the units that have no table yet, by worker processes."""
    missing = [unit for unit in units if not unit.table.exists()]
    steps = [unit.steps for unit in missing]
    with (
        reporter.stage(stage, sum(steps)) as advance,
        journal_progress([unit.journal for unit in missing], steps, advance) as complete,
    ):
        for index, (registrations, messages) in run_units(_work, missing, run):
            unit = missing[index]
            for message in messages:
                reporter.note(f"{unit.messages_of}: {message}")
            write_registrations(unit.table, registrations, *unit.nodes)
            complete(index)
            unit.journal.unlink(missing_ok=True)


def _work(unit: JournaledUnit) -> tuple[list[Registration], list[str]]:
    messages: list[str] = []
    journal = Journal(unit.journal)
    try:
        return unit.work(messages.append, journal.remember), messages
    finally:
        journal.close()


@contextmanager
def journal_progress(
    journals: Sequence[Path], totals: Sequence[int], advance: Advance
) -> Iterator[Callable[[int], None]]:
    """Report progress by the lines that other processes write to journals, up to each journal's total.

    Yields a function to call with the index of a journal that is complete.
    """
    done, lock, stop = [0] * len(journals), Lock(), Event()

    def reach(index: int, count: int) -> None:
        with lock:
            count = min(count, totals[index])
            if count > done[index]:
                advance(count - done[index])
                done[index] = count

    def watch() -> None:
        while not stop.wait(_POLL_S):
            for index, path in enumerate(journals):
                reach(index, len(_whole_lines(path)))

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield lambda index: reach(index, totals[index])
    finally:
        stop.set()
        watcher.join()


def _whole_lines(path: Path) -> list[bytes]:
    """The complete lines of a file, without a last one that was cut off by a kill."""
    if not path.exists():
        return []
    return [line + b"\n" for line in read_bytes(path, "a journal").split(b"\n")[:-1]]


def _stored(result: SearchResult) -> dict[str, Any]:
    return {"reason": result.reason} if result.best is None else {"reason": result.reason, "best": asdict(result.best)}


def _plain(value: Any) -> Any:
    """Arrays and numbers of numpy as JSON has them."""
    return value.tolist() if isinstance(value, np.ndarray) else float(value)


def _restored(stored: Any) -> SearchResult:
    """The result of a line. Raises ValueError, TypeError, KeyError or AttributeError if it is not one."""
    best = stored.get("best")
    if best is None:
        return SearchResult(None, stored["reason"])
    evidence = dict(best["evidence"])
    evidence["weakest_direction"] = tuple(evidence["weakest_direction"])
    registration = Registration(
        int(best["ref"]),
        int(best["query"]),
        np.array(best["T_ref_query"], dtype=np.float64).reshape(4, 4),
        np.array(best["information"], dtype=np.float64).reshape(6, 6),
        Evidence(**evidence),
        str(best["reason"]),
    )
    return SearchResult(registration, stored["reason"])
