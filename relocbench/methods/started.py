"""A tracker that starts from the pose of another tracker: what the second adds to the first.

``--set LABEL.start=METHOD`` makes one of any tracker that uses a prior. The other's parameters are set as
``--set LABEL.start.KEY=VALUE``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from relocbench.arrays import Array
from relocbench.errors import raised
from relocbench.tracking import Query, Reference, SupportsPrepare, TrackResult


@dataclass(frozen=True, eq=False)
class StartedReference:
    """A keyframe as both trackers have prepared it."""

    own: Any
    start: Any


class StartedTracker:
    """Calls ``start`` first, and ``tracker`` with the pose that it found as prior.

    Where ``start`` finds no pose, ``tracker`` gets the prior that was given, as if it were alone. ``info["start"]``
    says how the start came about. The seconds of an answer are those of both.
    """

    uses_prior = True

    def __init__(self, tracker: Any, start: Any) -> None:
        self._tracker, self._start = tracker, start
        self.neighbours = max(getattr(each, "neighbours", 0) for each in (tracker, start))
        for name in ("match", "match_levels"):
            if callable(getattr(tracker, name, None)):
                setattr(self, name, self._passing_on(name))
        if callable(getattr(tracker, "features", None)):
            self.features = tracker.features

    def prepare(self, reference: Reference) -> StartedReference:
        """Prepare the keyframe for both trackers."""
        return StartedReference(*(_prepared(each, reference) for each in (self._tracker, self._start)))

    def track(self, reference: StartedReference, query: Query, prior: Array | None = None) -> TrackResult:
        """The answer of the tracker from the start's pose."""
        started, how = self._started(reference.start, query, prior)
        result: TrackResult = self._tracker.track(reference.own, query, prior if started is None else started)
        return replace(result, info={**result.info, "start": how})

    def close(self) -> None:
        """End the trackers that are programs."""
        for each in (self._tracker, self._start):
            if callable(close := getattr(each, "close", None)):
                close()

    def _started(self, reference: Any, query: Query, prior: Array | None) -> tuple[Array | None, str]:
        try:
            started: TrackResult = self._start.track(reference, query, prior)
        except Exception as bad:  # noqa: BLE001  the boundary to code that is not ours
            return None, raised(bad)
        return started.T_query_ref, "found" if started.answered else f"none: {started.message}"

    def _passing_on(self, name: str) -> Any:
        def call(reference: StartedReference, query: Query, uv_ref: Array, uv_start: Array) -> Array | Sequence[Array]:
            ends: Array | Sequence[Array] = getattr(self._tracker, name)(reference.own, query, uv_ref, uv_start)
            return ends

        return call


def _prepared(tracker: Any, reference: Reference) -> Any:
    return tracker.prepare(reference) if isinstance(tracker, SupportsPrepare) else reference
