"""Trackers with known behaviour, named by dotted path in tests of the contract."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from relocbench.tracking import Query, Reference, TrackResult


@dataclass
class Shift:
    """Answers a fixed shift; takes parameters of several kinds."""

    uses_times = True  # it knows the pairs by them

    metres: Annotated[float, Field(ge=0)] = 0.1
    steps: int = 3
    loud: bool = False
    seed: int = 0

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        pose = np.eye(4)
        pose[0, 3] = self.metres
        return TrackResult(pose, confidence=float((query.timestamp_ns or 0) % 7), info={"steps": np.int64(self.steps)})


class Certain:
    """Is certain of the identity, whatever it is shown."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4), confidence=1.0)


@dataclass
class Costly(Shift):
    """Takes memory for each answer, and says on how many cores it may run."""

    takes_mib: int = 0

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        taken = np.ones(self.takes_mib * 2**17)
        return TrackResult(np.eye(4), info={"cores": len(os.sched_getaffinity(0)), "sum": float(taken.sum())})


@dataclass
class Logging(Shift):
    """A line in ``log`` for each question; sleeps, kills its process, fails or raises where it is told to."""

    log: str = ""
    sleep_s: float = 0.0
    dies_at: int = -1
    dies_once: bool = False
    fails_at: int = -1
    raises_at: int = -1

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        with Path(self.log).open("a") as stream:
            stream.write(f"{reference.timestamp_ns} {query.timestamp_ns}\n")
        time.sleep(self.sleep_s)
        if query.timestamp_ns == self.dies_at:
            mark = Path(self.log + ".died")
            if not (self.dies_once and mark.exists()):
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
        if query.timestamp_ns == self.fails_at and not Path(self.log + ".healed").exists():
            return TrackResult.failure("nothing\nfound", tried=1)
        if query.timestamp_ns == self.raises_at:
            raise ZeroDivisionError("on purpose")
        return super().track(reference, query, prior)


class FromPrior:
    """Answers the prior, so that it shows where it started."""

    uses_prior = True

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult.failure("no prior") if prior is None else TrackResult(prior, info={"own": 1})

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        assert isinstance(reference, str)
        return uv_start


class Required:
    """A parameter without default."""

    def __init__(self, weights: str) -> None:
        self.weights = weights

    def track(self, reference: Any, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult.failure("no weights")


class Unmade:
    """Cannot be made.

    Args:
        interrupts: it raises KeyboardInterrupt.
        removes: an empty folder that it removes first.
    """

    uses_prior = True

    def __init__(self, interrupts: bool = False, removes: Path | None = None) -> None:
        if removes is not None:
            removes.rmdir()
        raise KeyboardInterrupt if interrupts else RuntimeError("no luck")

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        raise AssertionError("it was not made")


class NotATracker:
    pass


class WrongAnswers:
    """Breaks the contract in a way that the query's time chooses."""

    uses_times = True  # it knows the pairs by them

    ANSWERS = (
        np.eye(4),
        None,
        TrackResult(np.full((4, 4), np.nan)),
        TrackResult(np.diag([2.0, 1.0, 1.0, 1.0])),
        TrackResult(np.eye(3)),
        TrackResult(np.eye(4), confidence=float("nan")),
        TrackResult(np.diag([-1.0, 1.0, 1.0, 1.0])),
    )

    def __init__(self, answer: int = 0) -> None:
        self.answer = answer

    def track(self, reference: Any, query: Query, prior: Any = None) -> Any:
        return self.ANSWERS[self.answer]


class Forgetful:
    """Answers something else each time, and draws on the image it is given."""

    def __init__(self) -> None:
        self.calls = 0

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        self.calls += 1
        query.image[0, 0] += 1
        pose = np.eye(4)
        pose[0, 3] = self.calls
        return TrackResult(pose)


class Batched:
    """Prepares, and answers several queries together."""

    uses_times = True  # it knows the pairs by them

    def prepare(self, reference: Reference) -> str:
        return reference.key

    def track(self, reference: str, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4), message=reference)

    def track_batch(self, reference: str, queries: list[Query], priors: list[Any]) -> list[TrackResult]:
        return [self.track(reference, query) for query in queries]


@dataclass
class Matching(Shift):
    """Says of every pixel that it is where it was asked to start, moved by ``moves_px``; logs, breaks and dies as told.

    Pixels of the left half of the reference it does not answer.
    """

    moves_px: float = 0.0
    log: str = ""
    raises_at: int = -1
    dies_at: int = -1
    answer: str = "pixels"

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        if self.log:
            with Path(self.log).open("a") as stream:
                stream.write(f"{reference.timestamp_ns} {query.timestamp_ns} {len(uv_start)}\n")
        if query.timestamp_ns == self.raises_at:
            raise ZeroDivisionError("on purpose")
        if query.timestamp_ns == self.dies_at:
            os.kill(os.getpid(), signal.SIGKILL)
        ends = uv_start + np.array([self.moves_px, 0.0])
        ends[uv_ref[:, 0] < reference.camera.width / 2] = np.nan
        return {"pixels": ends, "few": ends[1:], "words": "nowhere", "infinite": np.full_like(ends, np.inf)}[
            self.answer
        ]


class MatchesTogether:
    """Lets the pixels of one question influence each other."""

    def track(self, reference: Any, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4))

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        return uv_start - uv_start.mean(axis=0) if len(uv_start) else uv_start


class Weighted:
    """Shifts by the number in a file, as a method with weights."""

    def __init__(self, weights: Path | None = None) -> None:
        self.metres = float((weights or self.files()["weights"]).read_text())

    @classmethod
    def files(cls, weights: Path | None = None) -> dict[str, Path]:
        return {"weights": weights or Path(os.environ["WEIGHTS_OF_TESTS"])}

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        pose = np.eye(4)
        pose[0, 3] = self.metres
        return TrackResult(pose)
