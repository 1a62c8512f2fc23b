"""What is odd about submitted answers: named, for a person to judge, and never a reason to refuse them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.tables.answers import Answer
from relocbench.metrics import pose_errors

_SAME = 1e-6
"""metres and radians by which answers differ that are the same"""
_FEW = 5
"""answers of which nothing can be said"""
_CLOSE_M, _CLOSE_DEG = 0.01, 0.1
_FAR_M = 1000.0
_OF_SIGMA = 0.5
_SHORTEST_S = 1e-5
"""in which nothing looks at an image"""


def odd_answers(
    pair_set: PairSet, poses_of: Mapping[PairKey, Array], answers: Mapping[PairKey, Answer]
) -> Iterator[str]:
    """What is odd about the answers to a pair set, one sentence each.

    Args:
        poses_of: (4, 4) ``T_query_ref`` of answered pairs.
        answers: rows of the table beside them; empty where there is none.
    """
    given = [a for a in answers.values() if a.status == "ok"]
    if poses_of and not any(a.seconds is not None for a in given):
        yield "no answer has seconds"
    seconds = [a.seconds for a in given if a.seconds is not None]
    if len(seconds) >= _FEW and max(seconds) < _SHORTEST_S:
        yield f"no answer took longer than {max(seconds):.3g} s"
    confidences = [a.confidence for a in given if a.confidence is not None]
    if poses_of and not confidences:
        yield "no answer has a confidence"
    elif len(confidences) >= _FEW and len(set(confidences)) == 1:
        yield f"all confidences are {confidences[0]:g}"
    if len(poses_of) < _FEW:
        return
    poses = np.array(list(poses_of.values()))
    if _same(poses, np.eye(4)).all():
        yield "all answers are the identity, which is also the prior: the keyframe's own pose"
    elif _same(poses, poses[0]).all():
        yield "all answers are one pose"
    far = int((np.linalg.norm(poses[:, :3, 3], axis=1) > _FAR_M).sum())
    if far:
        yield f"{far} answers are farther than {_FAR_M:g} m from the keyframe"
    yield from _near_truth(pair_set, poses_of)


def _near_truth(pair_set: PairSet, poses_of: Mapping[PairKey, Array]) -> Iterator[str]:
    """Answers that are the truth, or nearer to it than it is known or than methods come."""
    asked = [p for p in pair_set.pairs if p.key in poses_of and p.T_query_ref is not None]
    if len(asked) < _FEW:
        return
    truth = np.array([p.T_query_ref for p in asked])
    poses = np.array([poses_of[p.key] for p in asked])
    copied = int(_same(poses, truth).sum())
    if copied and not _same(truth, np.eye(4)).all():
        yield f"{copied} of {len(asked)} answers are the truth to {_SAME:g}"
    errors = pose_errors(poses, truth)
    farthest_m, farthest_deg = float(errors.translation_error_m.max()), float(errors.rotation_error_deg.max())
    if len(asked) == len(pair_set.pairs) and farthest_m < _CLOSE_M and farthest_deg < _CLOSE_DEG:
        message = f"all {len(asked)} answers are within {1000 * farthest_m:.3g} mm and {farthest_deg:.3g}° of the truth"
        yield f"{message}, as copies of it with noise are"
    sigmas = [sigma for p in asked if (sigma := p.calibrated_sigmas[0])]
    median = float(np.median(errors.translation_error_m))
    if len(sigmas) == len(asked) and median < _OF_SIGMA * float(np.median(sigmas)):
        yield (
            f"the median answer is {1000 * median:.3g} mm from a truth whose own sigma is "
            f"{1000 * float(np.median(sigmas)):.3g} mm"
        )


def _same(poses: Array, others: Array) -> Array:
    """(N,) whether poses (N, 4, 4) are others, to :data:`_SAME`."""
    return np.asarray(np.abs(poses - others).max(axis=(1, 2)) <= _SAME)


def same_answers(ours: Mapping[PairKey, Array], theirs: Mapping[PairKey, Array]) -> int:
    """How many answers to a pair set are those of another row, digit by digit."""
    return sum(key in theirs and bool(_same(pose[None], theirs[key])[0]) for key, pose in ours.items())
