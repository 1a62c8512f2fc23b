"""A tracker that is a program, in any language and under any licence.

The program reads one JSON object a line on standard input and answers each with one on standard output:

========================================================================= =======================================
relocbench writes                                                          the program answers
========================================================================= =======================================
``{"type": "start", "id", "protocol": 2}``                                 ``{"type": "ready", "id", "batch"}``
``{"type": "reference", "id", "key", "image", "camera", "depth", ...}``    ``{"type": "ready", "id"}``
``{"type": "query", "id", "key", "image", "camera", "prior"}``             ``{"type": "result", "id", "pose", ...}``
``{"type": "queries", "id", "queries": [...]}``                            ``{"type": "results", "id", "results"}``
``{"type": "stop"}``                                                       (ends)
========================================================================= =======================================

An answer carries the ``id`` of its question, so that a late one is never taken for the answer to another question.
Only a program that has declared a ``batch`` above 1 gets several queries at once. ``docs/add-a-method.md``
describes the fields. Images and depth are files in a scratch folder that holds nothing else: the program sees no
ground truth.
"""

from __future__ import annotations

import json
import shlex
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from relocbench.arrays import Array
from relocbench.datasets.core.images import write_depth, write_image, write_points
from relocbench.datasets.core.pairfile import QUATERNION_TOLERANCE
from relocbench.errors import MethodError, one_line
from relocbench.execution import IN_A_ROW, ScratchFolder
from relocbench.geometry import transform_from_tq, transform_to_tq
from relocbench.methods.program import Program, ProgramFault
from relocbench.tracking import MOST_QUERIES, Query, Reference, TrackResult

PROTOCOL = 2


@dataclass(frozen=True)
class _Sent:
    """A reference as it was sent to the program."""

    message: dict[str, Any]
    scratch: tempfile.TemporaryDirectory[str]


class SubprocessTracker:
    """Speaks the line protocol with a program, which is started again after it crashed.

    Args:
        command: the program and its arguments.
        time_limit_s: time for one answer, after which the program is killed and the pair has failed.
        start_limit_s: time for the program to become ready.
        uses_times: whether the program gets the times of images; it is then not ranked with the others.

    Raises:
        MethodError: the program does not exist.
    """

    def __init__(
        self, command: str, time_limit_s: float = 60.0, start_limit_s: float = 120.0, uses_times: bool = False
    ) -> None:
        self.words = shlex.split(command)
        if not self.words or shutil.which(self.words[0]) is None:
            raise MethodError(f"no program '{self.words[0] if self.words else ''}' to run as subprocess:{command}")
        self.time_limit_s = time_limit_s
        self.start_limit_s = start_limit_s
        self.uses_times = uses_times
        self._home = ScratchFolder()
        self._program: Program | None = None
        self._sent: _Sent | None = None
        self._lost_in_a_row = 0
        self._last_fault = ""
        self._declared_batch = 1
        self._most_at_once = MOST_QUERIES

    @property
    def batch_size(self) -> int:
        """The number of queries that the program takes at once: 1 until it has started and declared another."""
        return min(self._declared_batch, self._most_at_once)

    def prepare(self, reference: Reference) -> _Sent:
        """Write the keyframe to files that the program can read."""
        scratch = tempfile.TemporaryDirectory(prefix="keyframe-", dir=self._home.path)
        folder = Path(scratch.name)
        write_image(folder / "reference.png", reference.image)
        message: dict[str, Any] = {
            "type": "reference",
            "key": reference.key,
            **_time(reference.timestamp_ns),
            "image": str(folder / "reference.png"),
            "camera": reference.camera.to_dict(),
            "depth": None,
            "points": None,
        }
        if reference.depth is not None:
            write_depth(folder / "depth.png", reference.depth)
            message["depth"] = str(folder / "depth.png")
            message["depth_sigma"] = list(reference.depth_sigma)
        if reference.sparse_points is not None:
            write_points(folder / "points.csv", reference.sparse_points)
            message["points"] = str(folder / "points.csv")
        return _Sent(message, scratch)

    def track(self, reference: _Sent, query: Query, prior: Array | None = None) -> TrackResult:
        """Ask the program about one query; if it breaks, only this pair is lost.

        Where it gave no answer to so many queries in a row that it is given up, it is not asked.
        """
        if self._given_up:
            return TrackResult.failure(
                f"not run: the program was given up when {IN_A_ROW} queries in a row had no answer "
                f"({self._last_fault}); mend it or raise time_limit_s, and run it again with --overwrite always",
                status="error",
            )
        message = {"type": "query", **_question(reference, query, prior, "query")}
        try:
            answer = self._ready_program(reference).ask(message, "result", self.time_limit_s)
        except ProgramFault as bad:
            self._lost_in_a_row, self._last_fault = self._lost_in_a_row + 1, str(bad)
            return self._failure(bad)
        self._lost_in_a_row = 0
        try:
            return _result(answer)
        except ProgramFault as bad:
            return self._failure(bad)

    def track_batch(
        self, reference: _Sent, queries: Sequence[Query], priors: Sequence[Array | None]
    ) -> list[TrackResult]:
        """Ask the program about several queries of one keyframe, as many at once as it takes.

        Where it crashes on several at once, it gets these one by one, so that only the query that breaks it is
        lost; and it is given half as many from then on, since their number may have been what broke it.
        """
        results: list[TrackResult] = []
        while len(results) < len(queries):
            some = slice(len(results), len(results) + self.batch_size)
            results += self._track_together(reference, queries[some], priors[some])
        return results

    def _track_together(
        self, reference: _Sent, queries: Sequence[Query], priors: Sequence[Array | None]
    ) -> list[TrackResult]:
        if len(queries) > 1 and not self._given_up:
            asked = [
                _question(reference, query, prior, f"query-{place}")
                for place, (query, prior) in enumerate(zip(queries, priors, strict=True))
            ]
            try:
                answer = self._ready_program(reference).ask(
                    {"type": "queries", "queries": asked}, "results", len(asked) * self.time_limit_s
                )
                results = _results(answer, len(asked))
            except ProgramFault:
                self._drop_program()
                self._most_at_once = max(1, len(asked) // 2)
            else:
                self._lost_in_a_row = 0
                return results
        return [self.track(reference, query, prior) for query, prior in zip(queries, priors, strict=True)]

    @property
    def _given_up(self) -> bool:
        return self._lost_in_a_row >= IN_A_ROW

    def _failure(self, bad: ProgramFault) -> TrackResult:
        self._drop_program()
        return TrackResult.failure(str(bad), status="error")

    def close(self) -> None:
        """End the program."""
        if self._program is not None:
            self._program.stop()
        self._drop_program()
        self._home.remove()

    def _ready_program(self, reference: _Sent) -> Program:
        if self._program is None:
            try:
                self._program = Program(self.words, self._home.environment())
            except OSError as bad:
                raise ProgramFault(f"cannot start '{self.words[0]}' ({bad.strerror})") from None
            ready = self._program.ask({"type": "start", "protocol": PROTOCOL}, "ready", self.start_limit_s)
            self._declared_batch = _batch(ready)
        if self._sent is not reference:
            self._program.ask(reference.message, "ready", self.time_limit_s)
            self._sent = reference
        return self._program

    def _drop_program(self) -> None:
        if self._program is not None:
            self._program.kill()
        self._program, self._sent = None, None


def subprocess_tracker(command: str) -> Callable[..., SubprocessTracker]:
    """A factory of trackers that run a command line; its keyword arguments are the method's parameters."""

    def create(
        time_limit_s: Annotated[float, Field(gt=0)] = 60.0,
        start_limit_s: Annotated[float, Field(gt=0)] = 120.0,
        uses_times: bool = False,
    ) -> SubprocessTracker:
        return SubprocessTracker(command, time_limit_s, start_limit_s, uses_times)

    return create


def _time(timestamp_ns: int | None) -> dict[str, int]:
    """The field of a time, which a message has only where the program gets times."""
    return {} if timestamp_ns is None else {"timestamp_ns": timestamp_ns}


def _question(reference: _Sent, query: Query, prior: Array | None, name: str) -> dict[str, Any]:
    """The fields of a query, whose image is written beside its keyframe."""
    image = Path(reference.scratch.name) / f"{name}.png"
    write_image(image, query.image)
    return {
        "key": query.key,
        **_time(query.timestamp_ns),
        "image": str(image),
        "camera": query.camera.to_dict(),
        "prior": None if prior is None else np.concatenate(transform_to_tq(prior)).tolist(),
    }


def _batch(ready: dict[str, Any]) -> int:
    """The number of queries that a program takes at once, of its first ``ready``. Raises ProgramFault."""
    batch = ready.get("batch")
    if batch is None:
        return 1
    if type(batch) is not int or batch < 1:
        raise ProgramFault(
            f"answered 'start' with the batch {one_line(json.dumps(batch), 40)}, expected an integer from 1"
        )
    return batch


def _results(answer: dict[str, Any], count: int) -> list[TrackResult]:
    """The content of a ``results`` line for so many queries. Raises ProgramFault if it is not valid."""
    results = answer.get("results")
    if not isinstance(results, list) or len(results) != count or not all(isinstance(each, dict) for each in results):
        raise ProgramFault(f"'results' must be a list of {count} objects")
    return [_result(each) for each in results]


def _result(answer: dict[str, Any]) -> TrackResult:
    """The content of a ``result`` line. Raises ProgramFault if it is not valid."""
    pose, confidence = answer.get("pose"), answer.get("confidence")
    info = answer.get("info") or {}
    if not isinstance(info, dict) or not (confidence is None or _is_number(confidence)):
        raise ProgramFault("'info' must be an object and 'confidence' a number or null")
    said = answer.get("message")
    message = "" if said is None else one_line(said)
    if pose is None:
        return TrackResult(None, confidence, message or "the program reports a failure", info)
    values = np.array(pose, dtype=np.float64) if _is_numbers(pose) else np.zeros(0)
    if values.shape != (7,) or not np.all(np.isfinite(values)):
        raise ProgramFault(
            f"'pose' is {one_line(pose, 80)}, expected seven finite numbers tx ty tz qx qy qz qw, or null"
        )
    if abs(np.linalg.norm(values[3:]) - 1.0) > QUATERNION_TOLERANCE:
        raise ProgramFault(f"quaternion qx qy qz qw has norm {np.linalg.norm(values[3:]):.6g}, expected 1")
    return TrackResult(transform_from_tq(values[:3], values[3:]), confidence, message, info)


def _is_numbers(values: Any) -> bool:
    return isinstance(values, list) and all(map(_is_number, values))


def _is_number(value: Any) -> bool:
    """Whether a JSON value is a number; true and false are not, though Python's ``bool`` is an ``int``."""
    return isinstance(value, int | float) and not isinstance(value, bool)
