"""Calling a tracker in this process: one keyframe after another, each with its queries, and only checked answers.

:class:`TrackerHandle` is what evaluations call. :class:`LocalTracker` calls a tracker in this process;
:class:`~relocbench.evaluation.isolation.tracker.IsolatedTracker` asks a process that holds nothing but the tracker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Protocol

from relocbench.arrays import Array
from relocbench.evaluation.isolation.answers import CheckedAnswer, ask, checked_levels, checked_pixels
from relocbench.evaluation.isolation.guard import batch_of, capabilities, guarded, implements, neighbours_of
from relocbench.evaluation.isolation.views import read_only
from relocbench.tracking import Query, Reference, SupportsLevelMatching, SupportsPrepare

_MOST_LEVELS = 32


@dataclass(frozen=True)
class Declared:
    """What a tracker object declares of itself."""

    batch: int = 1
    """queries of a keyframe that it answers in one call"""
    levels: bool = False
    """it finds pixels on each level of its pyramid"""
    neighbours: int = 0
    """frames that it requests on each side of a keyframe"""
    fault: str = ""
    """what is wrong with these numbers; empty if nothing is"""
    match: bool = False
    """it finds single pixels"""
    prior: bool = False
    """it starts from a pose that it is given"""


class TrackerHandle(Protocol):
    """A tracker that can be called. The queries of all calls belong to the keyframe that was prepared last."""

    @property
    def declared(self) -> Declared:
        """What it declares; the batch of a program may change when it starts or breaks."""
        ...

    def prepare(self, keyframe: Reference) -> str | None:
        """Show the tracker a keyframe; returns how it crashed on it, if it did."""
        ...

    def ask(
        self, views: Sequence[Query], priors: Sequence[Array | None] | None = None
    ) -> tuple[list[CheckedAnswer], float]:
        """The answers to queries, and the seconds that the tracker took for them together."""
        ...

    @property
    def peak_memory_bytes(self) -> int | None:
        """The most resident memory of its process so far; None where it has none of its own, or none is told."""
        ...

    def match(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[Array | None, str | None]:
        """Where pixels of the keyframe are in the query (N, 2); or None, and how the tracker broke."""
        ...

    def match_levels(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[list[Array], str | None]:
        """The same on each level of the tracker's pyramid, finest first; none if one level's answer is invalid."""
        ...


class LocalTracker:
    """A tracker in this process."""

    peak_memory_bytes: int | None = None

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        self._reference: Any = None
        self._neighbours, self._neighbours_fault = neighbours_of(tracker)
        self._levels = implements(tracker, SupportsLevelMatching)

    @property
    def declared(self) -> Declared:
        batch, batch_fault = batch_of(self._tracker)
        match, prior = capabilities(self._tracker)
        return Declared(
            batch, self._levels, self._neighbours, self._neighbours_fault or batch_fault or "", match, prior
        )

    def prepare(self, keyframe: Reference) -> str | None:
        self._reference = keyframe
        if not implements(self._tracker, SupportsPrepare):
            return None
        self._reference, crash = guarded(lambda: self._tracker.prepare(keyframe))
        return crash

    def ask(
        self, views: Sequence[Query], priors: Sequence[Array | None] | None = None
    ) -> tuple[list[CheckedAnswer], float]:
        return ask(self._tracker, self._reference, views, priors)

    def match(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[Array | None, str | None]:
        given = read_only(uv_ref), read_only(uv_start)
        ends, crash = guarded(lambda: self._tracker.match(self._reference, query, *given))
        return checked_pixels(ends, crash, len(uv_ref))

    def match_levels(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[list[Array], str | None]:
        given = read_only(uv_ref), read_only(uv_start)
        levels, crash = guarded(  # the levels may come from a generator
            lambda: list(islice(self._tracker.match_levels(self._reference, query, *given), _MOST_LEVELS + 1))
        )
        if crash is None and len(levels) > _MOST_LEVELS:
            crash = f"match_levels returned more than {_MOST_LEVELS} levels"
        return checked_levels(levels or (), crash, len(uv_ref))
