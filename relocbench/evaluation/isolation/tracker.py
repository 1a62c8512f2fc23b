"""A tracker in a process of its own, which is handed images, cameras and depth and nothing else."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from relocbench.arrays import Array
from relocbench.errors import MethodError, one_line
from relocbench.evaluation.isolation.answers import (
    CheckedAnswer,
    checked_answer,
    checked_levels,
    checked_pixels,
    error_answer,
)
from relocbench.evaluation.isolation.handles import Declared
from relocbench.evaluation.isolation.method_process import FORGED, MethodProcess, crash_of
from relocbench.execution import Sandbox
from relocbench.methods import MethodSpec
from relocbench.tracking import MOST_QUERIES, Query, Reference, TrackResult

_MODULE = "relocbench.evaluation.isolation.isolated_process"


class IsolatedTracker:
    """A :class:`~relocbench.evaluation.isolation.handles.TrackerHandle` whose tracker runs in a child process.

    Raises:
        MethodError: the tracker cannot be made.
    """

    def __init__(self, spec: MethodSpec, sandbox: Sandbox) -> None:
        self._process = MethodProcess(spec, _MODULE, sandbox)
        self.declared = _declared(self._process.declared, spec)

    def prepare(self, keyframe: Reference) -> str | None:
        answer, _ = self._process.ask(("prepare", (keyframe,)))
        self._note_batch(answer)
        return crash_of(answer)

    def ask(
        self, views: Sequence[Query], priors: Sequence[Array | None] | None = None
    ) -> tuple[list[CheckedAnswer], float]:
        different = list({id(view): view for view in views}.values())
        places = {id(view): place for place, view in enumerate(different)}
        order = [places[id(view)] for view in views]
        request = ("ask", (different, order, None if priors is None else list(priors)))
        start = time.perf_counter()  # before the method's process gets the images, where it might begin to work
        answer, poses = self._process.ask(request)
        seconds = time.perf_counter() - start
        self._note_batch(answer)
        answers = answer.get("answers") if isinstance(answer, dict) else None
        return _answers(answers, poses, len(views)), seconds

    @property
    def peak_memory_bytes(self) -> int | None:
        return self._process.peak_memory_bytes

    def match(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[Array | None, str | None]:
        answer, ends = self._process.ask(("match", (query, uv_ref, uv_start)))
        return checked_pixels(ends[0] if ends else None, crash_of(answer), len(uv_ref))

    def match_levels(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[list[Array], str | None]:
        answer, levels = self._process.ask(("match_levels", (query, uv_ref, uv_start)))
        return checked_levels(levels, crash_of(answer), len(uv_ref))

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _note_batch(self, answer: Any) -> None:
        """Keep the number of queries that it answers at once, which a program tells only when it has started."""
        batch = answer.get("batch") if isinstance(answer, dict) else None
        if type(batch) is int:
            self.declared = replace(self.declared, batch=min(max(1, batch), MOST_QUERIES))


def _answers(answers: Any, poses: Sequence[Any], count: int) -> list[CheckedAnswer]:
    """The answers after the same checks as in the method's process, where a method may have undone them."""
    if not isinstance(answers, list) or len(answers) != count:
        return [error_answer(f"{FORGED}: not {count} answers")] * count
    left = iter(poses)
    return [checked_answer(_result(each, left)) for each in answers]


def _result(answer: Any, poses: Any) -> object:
    try:
        pose = next(poses) if answer["posed"] else None
        return TrackResult(pose, answer["confidence"], answer["message"], json.loads(answer["info"]))
    except (KeyError, TypeError, ValueError, StopIteration, RecursionError):
        return TrackResult.failure(FORGED, status="error")


def _declared(values: dict[str, Any], spec: MethodSpec) -> Declared:
    try:
        declared = Declared(**values)
        batch, neighbours = max(1, int(declared.batch)), max(0, int(declared.neighbours))
    except (TypeError, ValueError, OverflowError):
        raise MethodError(f"{spec.kind.noun} '{spec.label}': {FORGED} when it started") from None
    fault, match, prior = one_line(declared.fault), bool(declared.match), bool(declared.prior)
    return Declared(min(batch, MOST_QUERIES), bool(declared.levels), neighbours, fault, match, prior)
