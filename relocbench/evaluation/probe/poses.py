"""Probing whole poses: whether the tracker returns to the truth from a prior with a known error (its basin).

The prior is the true pose with the camera's centre moved by a number of metres in a random direction, or with the
camera turned about its centre by a number of degrees about a random axis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.probe.tally import Tally, What
from relocbench.geometry import make_transform, so3_exp
from relocbench.metrics import PoseErrors, pose_array, pose_errors, within
from relocbench.tracking import Query

OFFSETS: dict[What, tuple[float, ...]] = {
    "translation": (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0),
    "rotation": (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
}
"""metres; degrees"""
CONVERGED = "recall@(0.25m,2deg)"
WITHIN = {CONVERGED: (0.25, 2.0), "recall@(0.25m,1deg)": (0.25, 1.0), "recall@(0.1m,0.5deg)": (0.1, 0.5)}
_SEED = 2


def draw_priors(T_query_ref: Array, what: What, key: PairKey, directions: int, seed: int) -> Array:
    """Draw M priors at each of K offsets, (K, M, 4, 4), exactly that far from the true pose; the same for every method.

    The M directions are the same at all offsets, so that a pair is followed outwards along M rays.
    """
    kind = list(OFFSETS).index(what)
    rng = np.random.default_rng([_SEED, kind, seed, *(time % 2**64 for time in key)])
    rays = rng.normal(size=(directions, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    out = np.empty((len(OFFSETS[what]), directions, 4, 4))
    for k, offset in enumerate(OFFSETS[what]):
        for m, ray in enumerate(rays):
            if what == "translation":
                # The centre is -R^T t, and R stays: t and the centre move by the same distance.
                out[k, m] = T_query_ref
                out[k, m, :3, 3] += offset * ray
            else:
                # Turned about the query camera's own centre, which stays where it is.
                out[k, m] = make_transform(so3_exp(np.radians(offset) * ray), np.zeros(3)) @ T_query_ref
    return out


def tracked_from(
    tracker: TrackerHandle | None, query: Query, T_query_ref: Array, starts: Array
) -> tuple[PoseErrors, str]:
    """The errors of the answers from starts (N, 4, 4), and how the method crashed, empty if it did not.

    Args:
        tracker: prepared for the keyframe; None if it crashed on it, in which case nothing is answered.
    """
    truth = np.broadcast_to(T_query_ref, starts.shape)
    if tracker is None:
        return pose_errors(pose_array([None] * len(starts)), truth), ""
    results, _ = tracker.ask([query] * len(starts), list(starts))
    crash = next((result.message for result in results if result.status == "error"), "")
    return pose_errors(pose_array(result.T_query_ref for result in results), truth), crash


def probe_poses(
    tracker: TrackerHandle | None, query: Query, T_query_ref: Array, key: PairKey, directions: int, seed: int
) -> tuple[list[Tally], str]:
    """Probe the whole pose of one pair.

    Args:
        tracker: prepared for the keyframe; None if it crashed on it, in which case it is not run.

    Returns:
        the tallies of translation and rotation; and how the method crashed, empty if it did not.
    """
    tallies, crash = [], ""
    for what, offsets in OFFSETS.items():
        priors = draw_priors(T_query_ref, what, key, directions, seed)
        ends, crash_too = tracked_from(tracker, query, T_query_ref, priors.reshape(-1, 4, 4))
        crash = crash or crash_too
        tallies.append(
            Tally(
                what,
                None,
                offsets,
                (directions,) * len(offsets),
                _by_offset(ends.answered, offsets),
                {name: _by_offset(within(ends, *limits), offsets) for name, limits in WITHIN.items()},
                {name: _starts_near(what, offsets, name, directions) for name in WITHIN},
            )
        )
    return tallies, crash


def _starts_near(what: What, offsets: Sequence[float], name: str, directions: int) -> tuple[int, ...]:
    """Judge starts by their nominal offsets: the rounding of a prior 0.25 m off must not decide."""
    limit = WITHIN[name][0 if what == "translation" else 1]
    return tuple(directions if offset <= limit else 0 for offset in offsets)


def _by_offset(chosen: Mask, offsets: Sequence[float]) -> tuple[int, ...]:
    return tuple(int(n) for n in chosen.reshape(len(offsets), -1).sum(axis=1))
