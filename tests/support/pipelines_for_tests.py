"""A tracker that knows the small dataset's poses, and lists as a retriever would make them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from small_dataset import ACROSS, CAMERA, START_NS, STEP_NS, small_pose, time_of

from relocbench.datasets.core.dataset import Dataset
from relocbench.geometry import invert
from relocbench.tracking import Query, Reference, TrackResult

FAR_M = 0.5
"""what the tracker is off by, where it does not find the pose"""


def frame_of(timestamp_ns: int) -> int:
    return (timestamp_ns - START_NS) % 10**15 // STEP_NS


def truth(ref: int, query: int) -> np.ndarray:
    """(4, 4) ``T_query_ref`` of frames of summer and winter."""
    return invert(small_pose(query, lateral_m=0.12, yaw_deg=2.0)) @ small_pose(ref)


class Knows:
    """Right within so many frames, beyond that half a metre off, or without an answer.

    Args:
        reach: frames.
        beyond: what it does farther away.
        sure: of what it is surer; ``never``: it tells no confidence.
        log: gets a line for each question.
    """

    uses_times = True  # it knows the pairs by them

    def __init__(
        self,
        reach: int = 1,
        beyond: Literal["off", "fail", "raise"] = "off",
        sure: Literal["near", "far", "never"] = "near",
        log: str = "",
    ) -> None:
        self.reach, self.beyond, self.sure, self.log = reach, beyond, sure, log

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        if self.log:
            with Path(self.log).open("a") as stream:
                stream.write(f"{time_of(reference)} {time_of(query)}\n")
        ref, asked = frame_of(time_of(reference)), frame_of(time_of(query))
        gap = abs(ref - asked)
        T_query_ref = truth(ref, asked)
        if gap > self.reach:
            if self.beyond == "raise":
                raise ZeroDivisionError("on purpose")
            if self.beyond == "fail":
                return TrackResult.failure("too far")
            T_query_ref[0, 3] += FAR_M
        sure = {"near": -float(gap), "far": float(gap), "never": None}[self.sure]
        return TrackResult(T_query_ref, confidence=sure)


def lists(dataset: Dataset, path: Path, frames: Sequence[Sequence[int]]) -> Path:
    """A file of ``query db`` lines: for each query frame the keyframes' frames, best first."""
    ref, query = (sorted(dataset.traversal(name).timestamps(CAMERA)) for name in ("summer", "winter"))
    lines = [
        f"traversals/winter/images/{CAMERA}/{query[q]}.png traversals/summer/images/{CAMERA}/{ref[k]}.png\n"
        for q, of in enumerate(frames)
        for k in of
    ]
    path.mkdir(parents=True, exist_ok=True)
    (path / f"{ACROSS}.txt").write_text("".join(lines))
    return path
