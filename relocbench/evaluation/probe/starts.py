"""Probing the start that a tracker has in practice: the keyframe's own pose, beside other starts equally far away.

A network can learn where queries usually lie relative to keyframes. Such a network converges more often from the
keyframe's pose than from a random direction at the same distance, and less often from the mirrored offset, on the
other side of the truth. A network that has learnt to align images converges from all three alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.probe.poses import CONVERGED, WITHIN, tracked_from
from relocbench.evaluation.probe.tally import Tally
from relocbench.geometry import invert, make_transform, rotation_angle, so3_exp
from relocbench.metrics import Difference, paired_difference, pose_errors, within
from relocbench.tracking import Query

Kind = Literal["keyframe", "mirrored", "random"]

KINDS: tuple[Kind, ...] = ("keyframe", "mirrored", "random")
"""the keyframe's pose; the offset of the keyframe's pose, mirrored at the truth; random directions of its length"""
_SEED = 4


@dataclass(frozen=True, eq=False)
class StartLine:
    """How often a method converges from each kind of start, on the pairs of one group."""

    method: str
    conditions: str
    criterion: str
    pairs: int
    shares: Mapping[Kind, float]
    """mean over pair sets of the mean over their pairs"""
    ahead: Difference
    """the share from the keyframe's pose less that from random directions"""


def draw_starts(T_query_ref: Array, key: PairKey, directions: int, seed: int) -> Array:
    """The start poses of a pair, (2 + directions, 4, 4): the keyframe's pose, its mirror image, and random ones.

    With ``D = T_start inv(T_query_ref)``, the offset of a start in the query camera's frame, the keyframe's pose (the
    identity) has ``D = inv(T_query_ref)``, and the mirrored start its inverse. Random starts have rotations by the same
    angle and translations of the same length, about random axes and in random directions.
    """
    rng = np.random.default_rng([_SEED, seed, *(time % 2**64 for time in key)])
    angle, length = float(rotation_angle(T_query_ref[:3, :3])), float(np.linalg.norm(invert(T_query_ref)[:3, 3]))
    offsets = [invert(T_query_ref), T_query_ref]
    for axis, ray in rng.normal(size=(directions, 2, 3)):
        turn = so3_exp(angle * axis / np.linalg.norm(axis))
        offsets.append(make_transform(turn, length * ray / np.linalg.norm(ray)))
    return np.array([offset @ T_query_ref for offset in offsets])


def probe_starts(
    tracker: TrackerHandle | None, query: Query, T_query_ref: Array, key: PairKey, directions: int, seed: int
) -> tuple[Tally, str]:
    """Probe the starts of one pair.

    Args:
        tracker: prepared for the keyframe; None if it crashed on it, in which case it is not run.

    Returns:
        the tally, whose offsets are the indices of :data:`KINDS`; and how the method crashed, empty if it did not.
    """
    starts = draw_starts(T_query_ref, key, directions, seed)
    kind = np.minimum(np.arange(len(starts)), KINDS.index("random"))
    ends, crash = tracked_from(tracker, query, T_query_ref, starts)
    begins = pose_errors(starts, np.broadcast_to(T_query_ref, starts.shape))

    def by_kind(chosen: Mask) -> tuple[int, ...]:
        return tuple(int(np.sum(chosen[kind == k])) for k in range(len(KINDS)))

    tally = Tally(
        "start",
        None,
        tuple(map(float, range(len(KINDS)))),
        by_kind(np.ones(len(starts), dtype=np.bool_)),
        by_kind(ends.answered),
        {name: by_kind(within(ends, *limits)) for name, limits in WITHIN.items()},
        {name: by_kind(within(begins, *limits)) for name, limits in WITHIN.items()},
    )
    return tally, crash


def start_line(
    method: str, conditions: str, tallies: Sequence[Sequence[Tally]], criterion: str = CONVERGED
) -> StartLine:
    """The results of a method on the pairs of one group; one sequence for each pair set, in the order of the drive."""
    shares = [np.array([t.hits[criterion] for t in some]) / np.array([t.count for t in some]) for some in tallies]
    keyframe, random = KINDS.index("keyframe"), KINDS.index("random")
    ahead = paired_difference([s[:, keyframe] for s in shares], [s[:, random] for s in shares])
    means = np.mean([s.mean(axis=0) for s in shares], axis=0)
    return StartLine(
        method, conditions, criterion, sum(map(len, tallies)), dict(zip(KINDS, map(float, means), strict=True)), ahead
    )
