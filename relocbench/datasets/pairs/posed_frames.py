"""The posed frames of a camera, which pairs are made of."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.motion.judging import judge
from relocbench.geometry import invert


@dataclass(frozen=True, eq=False)
class PosedFrames:
    """The posed frames of one camera of one traversal, in time order."""

    timestamps: tuple[int, ...]
    """nanoseconds, increasing"""
    T_world_cam: Array
    """(N, 4, 4)"""
    keyframes: frozenset[int]
    """times of the frames with depth or points"""
    numbers: tuple[int, ...] = ()
    """the recording's frame numbers, which may have gaps; default: 0, 1, 2, ..."""
    pieces: tuple[int, ...] = ()
    """number of the piece of the drive that each frame belongs to: nobody knows the way from one piece to the next;
    default: one piece"""

    def __post_init__(self) -> None:
        if not self.numbers:
            object.__setattr__(self, "numbers", tuple(range(len(self.timestamps))))
        if not self.pieces:
            object.__setattr__(self, "pieces", (0,) * len(self.timestamps))
        if not len(self.timestamps) == len(self.numbers) == len(self.T_world_cam):
            raise ValueError(
                f"posed frames need as many times ({len(self.timestamps)}) as poses ({len(self.T_world_cam)}) "
                f"and numbers ({len(self.numbers)})"
            )

    @property
    def keyframe_rows(self) -> list[int]:
        """Positions of the keyframes in :attr:`timestamps`."""
        return [i for i, t in enumerate(self.timestamps) if t in self.keyframes]


def posed_frames(
    traversal: Traversal, camera: str, numbers: dict[int, int] | None = None, starts: Collection[int] = ()
) -> PosedFrames:
    """The frames of a traversal on disk that have an image and a pose.

    Where images have names, their times are mere numbers and are not judged.

    Args:
        numbers: timestamp_ns -> frame number, if the recording's frame numbers have gaps.
        starts: of images with names, timestamps of those before which nobody knows the way.
    """
    times = [t for t in traversal.timestamps(camera) if t in traversal.poses]
    poses = [traversal.T_world_cam(camera, t) for t in times]
    T_world_cam = np.array(poses, dtype=np.float64).reshape(-1, 4, 4)
    return PosedFrames(
        tuple(times),
        T_world_cam,
        frozenset(traversal.keyframe_timestamps(camera)),
        tuple(numbers[t] for t in times) if numbers is not None else (),
        tuple(np.searchsorted(sorted(starts), times, side="right").tolist())
        if traversal.names
        else pieces_of(times, T_world_cam),
    )


def pieces_of(timestamps: Sequence[int], T_world_cam: Array) -> tuple[int, ...]:
    """Number of the piece of the drive that each of N frames belongs to, by jumps, holes and outliers."""
    motion = judge(np.array(timestamps, dtype=np.int64), T_world_cam)
    starts = {*motion.breaks, *(row for one in motion.outliers for row in (one.first, one.last + 1) if row)}
    return tuple(np.searchsorted(sorted(starts), np.arange(len(timestamps)), side="right").tolist())


def pair_of(reference: PosedFrames, r: int, query: PosedFrames, q: int) -> Pair:
    """The pair of the frames in row ``r`` and row ``q``, of which nothing but its pose is known."""
    T_query_ref = relative_pose(query.T_world_cam[q], reference.T_world_cam[r])
    return Pair(reference.timestamps[r], query.timestamps[q], T_query_ref)


def relative_pose(T_world_query: Array, T_world_ref: Array) -> Array:
    """``T_query_ref = T_query_world @ T_world_ref``, (4, 4)."""
    return invert(T_world_query) @ T_world_ref
