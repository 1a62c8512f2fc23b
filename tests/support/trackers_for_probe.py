"""Trackers whose basin is known, named by dotted path in tests of the probe."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from relocbench.tracking import Query, Reference, TrackResult


@dataclass
class Basin:
    """Stays where it is put within a range of the prior's translation, or breaks as told; logs each question."""

    uses_times = True  # it knows the pairs by them

    log: str = ""
    raises_at: int = -1
    dies_at: int = -1
    features: int = 3
    """a parameter with the name of an optional part of the contract"""

    uses_prior = True

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        self._note("track", query)
        assert prior is not None
        return TrackResult(prior.copy())

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        self._note("match", query)
        return uv_start.copy()

    def _note(self, what: str, query: Query) -> None:
        if self.log:
            with Path(self.log).open("a") as stream:
                stream.write(f"{what} {query.timestamp_ns}\n")
        if query.timestamp_ns == self.raises_at:
            raise ZeroDivisionError("on purpose")
        if query.timestamp_ns == self.dies_at:
            os.kill(os.getpid(), signal.SIGKILL)


class BadLevels(Basin):
    """Answers pixels, and breaks the contract on each level alone for one query."""

    def match_levels(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        return [uv_start[1:]] if query.timestamp_ns == self.raises_at else [uv_start, uv_start]

    def _note(self, what: str, query: Query) -> None:
        pass


class NoFinestLevel(Basin):
    """Has no map of the image's own resolution."""

    def match_levels(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        return [np.full(np.shape(uv_start), np.nan), uv_start]

    def _note(self, what: str, query: Query) -> None:
        pass


class Shows:
    """Features: the grey levels and their place, on two levels."""

    def track(self, reference: Any, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4))

    def features(self, image: Any, camera: Any) -> Any:
        v, u = np.mgrid[: camera.height, : camera.width]
        maps = np.stack([image if image.ndim == 2 else image[..., 0], u, v, u + v], axis=-1).astype(np.float32)
        return SimpleNamespace(levels=[SimpleNamespace(map=maps), SimpleNamespace(map=maps[::2, ::2])])


class ShowsNonsense(Shows):
    def features(self, image: Any, camera: Any) -> Any:
        return SimpleNamespace(levels=[SimpleNamespace(map=np.zeros((2, 2)))])
