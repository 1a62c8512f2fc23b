"""What a long registration has found so far, on disk, so that a killed one goes on where it was.

Each line is a JSON list: what was asked for, and the outcome. The registration asks the same questions in the same
order when it runs again; as long as they are the journal's, it is answered from there.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

import numpy as np

from relocbench.datasets.groundtruth.registration.hypotheses import SearchResult
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.files import parse_json, read_bytes
from relocbench.progress import Advance

_POLL_S = 0.5


class Journal:
    """Outcomes of one registration; numbers are read back bit for bit."""

    def __init__(self, path: Path) -> None:
        self._path = path
        lines = _whole_lines(path)
        self._known: deque[tuple[str, bytes, SearchResult]] = deque()
        for line in lines:
            try:
                asked, outcome = parse_json(line)
                self._known.append((asked, line, _outcome(outcome)))
            except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
                break
        path.parent.mkdir(parents=True, exist_ok=True)
        self._used = 0
        """bytes that were asked for again"""
        self._stream = path.open("wb")
        self._stream.writelines(line for _, line, _ in self._known)
        self._stream.flush()

    def remember(self, asked: str, work: Callable[[], SearchResult]) -> SearchResult:
        """The outcome of ``work``, which is done only if it was not before."""
        if self._known:
            known, line, outcome = self._known.popleft()
            if known == asked:
                self._used += len(line)
                return outcome
            # Of another registration: nothing from here on can be trusted.
            self._known.clear()
            self._stream.seek(self._used)
            self._stream.truncate()
        outcome = work()
        try:
            self._stream.write((json.dumps([asked, _plain(outcome)], default=float) + "\n").encode())
            self._stream.flush()
        except OSError as bad:
            bad.filename = bad.filename or str(self._path)  # a full disk does not say which file did not fit
            raise
        return outcome

    def close(self) -> None:
        """What follows is up to the owner of the file."""
        self._stream.close()


@contextmanager
def journal_progress(
    journals: Sequence[Path], totals: Sequence[int], advance: Advance
) -> Iterator[Callable[[int], None]]:
    """Advance by the lines that other processes write to journals, at most to each one's total.

    The value of the context is called with the index of a journal that is complete.
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
    """Lines that end; one that a kill tore is none."""
    if not path.exists():
        return []
    return [line + b"\n" for line in read_bytes(path, "a journal").split(b"\n")[:-1]]


def _plain(outcome: SearchResult) -> dict[str, Any]:
    found = outcome.best
    if found is None:
        return {"reason": outcome.reason}
    return {
        "reason": outcome.reason,
        "best": {
            "ref": found.ref,
            "query": found.query,
            "T_ref_query": found.T_ref_query.tolist(),
            "information": found.information.tolist(),
            "evidence": asdict(found.evidence),
            "reason": found.reason,
        },
    }


def _outcome(plain: dict[str, Any]) -> SearchResult:
    """Raises ValueError, TypeError or KeyError where it is none."""
    best = plain.get("best")
    if best is None:
        return SearchResult(None, plain["reason"])
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
    return SearchResult(registration, plain["reason"])
