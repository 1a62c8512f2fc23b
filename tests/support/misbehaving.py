"""Trackers and retrievers that misbehave on one pair, named by dotted path in tests of limits."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.execution import step
from relocbench.retrieval import Descriptors, ImageView
from relocbench.tracking import Query, Reference, TrackResult

FOREVER_S = 1000.0


def allow_few_times(times: float) -> None:
    """In the worker that does this, what is done once may take so many times the time limit, and not ten times."""
    for name in [name for name in sys.modules if name.startswith("relocbench.")]:
        if hasattr(sys.modules[name], "MANY_TIMES"):
            sys.modules[name].MANY_TIMES = times  # type: ignore[attr-defined]


def hang() -> None:
    time.sleep(FOREVER_S)


def hang_in_native_code() -> None:
    """With the interpreter locked: no thread of this process can do anything about it."""
    ctypes.PyDLL(None).usleep(ctypes.c_uint(2**31))


def leave() -> None:
    os._exit(3)


def crash() -> None:
    ctypes.string_at(0)


def kill_itself() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def take_memory() -> None:
    """Far more than the limit of the test, kept until the process is ended."""
    taken = [np.ones(2**23) for _ in range(160)]
    time.sleep(FOREVER_S)
    del taken


def raise_memory_error() -> None:
    np.ones(2**50)


def fork_sleepers() -> None:
    """Children that hold every pipe of their parent open, and the parent dies."""
    for _ in range(3):
        if os.fork() == 0:
            time.sleep(FOREVER_S)
            os._exit(0)
    os._exit(4)


def start_and_leave_behind() -> None:
    """A program and a thread that go on."""
    threading.Thread(target=time.sleep, args=(FOREVER_S,)).start()
    sleeper = [sys.executable, "-c", f"import time; time.sleep({FOREVER_S})", os.environ["LEFT_BEHIND"]]
    subprocess.Popen(sleeper)
    subprocess.Popen(sleeper, start_new_session=True)
    Path(os.environ["LEFT_BEHIND"]).touch()


def leave_behind_and_hang() -> None:
    start_and_leave_behind()
    hang()


DEEDS: dict[str, Callable[[], None]] = {
    deed.__name__: deed
    for deed in (
        hang,
        hang_in_native_code,
        leave,
        crash,
        kill_itself,
        take_memory,
        raise_memory_error,
        fork_sleepers,
        start_and_leave_behind,
        leave_behind_and_hang,
    )
}


class Misbehaves:
    """Does ``deed`` when it is asked about the pair ``at``, and answers the identity else.

    Args:
        at: times of keyframe and query.
        mark: a file that says that the deed has begun.
    """

    uses_times = True  # it knows the pairs by them

    def __init__(self, deed: str = "", at: str = "", mark: str = "") -> None:
        self.deed, self.at, self.mark = deed, at, mark

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        if f"{reference.timestamp_ns} {query.timestamp_ns}" == self.at:
            if self.mark:
                Path(self.mark).touch()
            DEEDS[self.deed]()
        return TrackResult(np.eye(4))


class InBatches(Misbehaves):
    """The same, several queries at once."""

    def track_batch(self, reference: Reference, queries: Sequence[Query], priors: Sequence[Any]) -> list[TrackResult]:
        return [self.track(reference, query) for query in queries]


class AlwaysMisbehaves(Misbehaves):
    """Does it on every pair; a line in ``mark`` for each time."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        with Path(self.mark).open("a") as stream:
            stream.write(f"{reference.timestamp_ns} {query.timestamp_ns}\n")
        DEEDS[self.deed]()
        return TrackResult(np.eye(4))


class AlwaysInBatches(AlwaysMisbehaves):
    """The same, several queries at once."""

    def track_batch(self, reference: Reference, queries: Sequence[Query], priors: Sequence[Any]) -> list[TrackResult]:
        return [self.track(reference, query) for query in queries]


class InConstructor(Misbehaves):
    """Does it when it is made; a line in ``mark`` for each time."""

    def __init__(self, deed: str = "", mark: str = "") -> None:
        super().__init__()
        with Path(mark).open("a") as stream:
            stream.write("made\n")
        DEEDS[deed]()


class InPrepare(Misbehaves):
    """Does it for every keyframe, or for those of ``at`` (parted by commas); a line in ``mark`` for each time."""

    def prepare(self, reference: Reference) -> Reference:
        if self.at == "" or f"keyframe {reference.timestamp_ns}" in self.at.split(","):
            with Path(self.mark).open("a") as stream:
                stream.write(f"{reference.timestamp_ns}\n")
            DEEDS[self.deed]()
        return reference


class Writes:
    """Writes into one of the arrays that it is given, on the pair ``at``."""

    uses_times = True  # it knows the pairs by them

    def __init__(self, what: str = "query", at: str = "") -> None:
        self.what, self.at = what, at

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        if f"{reference.timestamp_ns} {query.timestamp_ns}" == self.at:
            arrays: dict[str, Any] = {
                "query": query.image,
                "reference": reference.image,
                "depth": reference.depth,
                "uv": reference.points.uv,
                "inverse depth": reference.points.inverse_depth,
                "map": reference.inverse_depth_map,
            }
            arrays[self.what][...] = 0
        return TrackResult(np.eye(4), info={"sum": int(query.image.sum())})


class TellsModules(Misbehaves):
    """Tells of modules that only the process of the test has."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        names = sorted(name for name in sys.modules if name.startswith("tests_of_limits"))
        return TrackResult(np.eye(4), info={"modules": names})


class Describes:
    """Mean colours; does ``deed`` when it is asked about the image of key ``at``, alone or among others."""

    def __init__(self, deed: str = "", at: str = "", mark: str = "") -> None:
        self.deed, self.at, self.mark = deed, at, mark

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        if any(image.key == self.at for image in images):
            if self.mark:
                Path(self.mark).touch()
            DEEDS[self.deed]()
        return np.stack([image.image.mean(axis=(0, 1)) for image in images]).astype(np.float64)


class DescribesNever(Describes):
    """Does it when it is made."""

    def __init__(self, deed: str = "") -> None:
        super().__init__()
        DEEDS[deed]()


def do(deed: str) -> str:
    """A unit of work that calls a method which does ``deed``; nothing for an empty name."""
    with step("", (deed,)):
        if deed:
            DEEDS[deed]()
    return "done"


class ManyQueriesAtOnce:
    """It tells that it answers infinitely many queries at once, which JSON can say."""

    def __init__(self) -> None:
        from relocbench.evaluation.isolation import isolated_process

        answer = isolated_process.Connection.answer

        def tell(connection: Any, words: Any, arrays: Any = ()) -> None:
            if "batch" in words.get("declared", {}):
                words["declared"]["batch"] = float("inf")
            answer(connection, words, arrays)

        isolated_process.Connection.answer = tell  # type: ignore[method-assign, assignment]

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4))
