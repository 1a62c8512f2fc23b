"""Combining retrieved keyframes and a tracker's answers to one answer for each query, and locating failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.pairfile import PairKey, PoseLine
from relocbench.evaluation.relocalization.answers import Outcome, PipelineAnswer
from relocbench.evaluation.relocalization.basin import Basin
from relocbench.evaluation.relocalization.truth import MapTruth, distance_and_angle, inside
from relocbench.evaluation.tables.answers import Answer
from relocbench.metrics import PoseErrors, pose_array, pose_errors, within
from relocbench.metrics.pose.scores import CORRECT

RIGHT = CORRECT
"""(metres, degrees) within which an answer is right when failures are attributed to retrieval or tracking"""


@dataclass(frozen=True)
class Retrieved:
    """The keyframes that a retriever found for one query."""

    keyframes: Sequence[int]
    """their indices, best first"""
    status: str = "ok"
    seconds: float | None = None
    message: str = ""


@dataclass(frozen=True)
class Tracked:
    """A tracker's answers, by (keyframe, query) timestamps."""

    answers: Mapping[PairKey, Answer] = field(default_factory=dict)
    poses: Mapping[PairKey, Array] = field(default_factory=dict)


def keyframe_poses(truth: MapTruth, retrieved: Sequence[Retrieved]) -> Tracked:
    """The trivial baseline of a retriever: the query gets the pose of its first keyframe, and no tracker runs."""
    keys = [
        (truth.keyframe_times[one.keyframes[0]], time)
        for time, one in zip(truth.query_times, retrieved, strict=True)
        if one.keyframes
    ]
    return Tracked({key: Answer(*key, "ok") for key in keys}, {key: np.eye(4) for key in keys})


def pipeline_answers(
    truth: MapTruth, retrieved: Sequence[Retrieved], tracked: Tracked, top: int, basin: Basin
) -> tuple[list[PipelineAnswer], list[PoseLine]]:
    """Compute a row for each query, and the poses that were kept.

    The most confident of the answers against the first ``top`` keyframes is kept. Of equally confident ones, and where
    the tracker reports no confidence, it is the answer against the keyframe that was ranked first.
    """
    rows, lines = [], []
    for query, found in enumerate(retrieved):
        row = _answer(truth, query, found, tracked, top, basin)
        rows.append(row)
        if row.ref_timestamp_ns is not None:
            key = row.ref_timestamp_ns, row.query_timestamp_ns
            lines.append(PoseLine(*key, tracked.poses[key]))
    return rows, lines


def _answer(
    truth: MapTruth, query: int, retrieved: Retrieved, tracked: Tracked, top: int, basin: Basin
) -> PipelineAnswer:
    time = truth.query_times[query]
    keyframes = list(retrieved.keyframes[:top])
    keys = [(truth.keyframe_times[k], time) for k in keyframes]
    T_query_ref = truth.relative(query)[keyframes]
    hits = np.flatnonzero(inside(*distance_and_angle(T_query_ref), basin.limits))
    hit_rank = int(hits[0]) + 1 if hits.size else None
    answers = [tracked.answers[key] for key in keys]
    seconds = _together([retrieved.seconds, *(a.seconds for a in answers)])
    kept = most_confident(
        [a.confidence if key in tracked.poses else None for a, key in zip(answers, keys, strict=True)],
        [key in tracked.poses for key in keys],
    )
    errors = errors_where_known([tracked.poses.get(key) for key in keys], T_query_ref)
    right = np.flatnonzero(np.asarray(within(errors, *RIGHT)))
    right_rank = int(right[0]) + 1 if right.size else None
    if kept is None:
        status, message = _why_not(retrieved, answers)
        return PipelineAnswer(
            time,
            status,
            "retrieval" if hit_rank is None else "tracking",
            hit_rank=hit_rank,
            asked=len(keys),
            seconds=seconds,
            message=message,
        )
    outcome: Outcome
    if kept in right:
        outcome = "right"
    elif right_rank is not None:
        outcome = "choice"
    elif not np.isfinite(T_query_ref[kept]).all():
        outcome = "unreachable"
    else:
        outcome = "retrieval" if hit_rank is None else "tracking"
    return PipelineAnswer(
        query_timestamp_ns=time,
        status="ok",
        outcome=outcome,
        ref_timestamp_ns=keys[kept][0],
        rank=kept + 1,
        hit_rank=hit_rank,
        right_rank=right_rank,
        asked=len(keys),
        rotation_error_deg=float(errors.rotation_error_deg[kept]),
        translation_error_m=float(errors.translation_error_m[kept]),
        mlad_translation_error_m=float(errors.mlad_translation_error_m[kept]),
        confidence=answers[kept].confidence,
        seconds=seconds,
        message=answers[kept].message,
    )


def most_confident(confidence: Sequence[float | None], answered: Sequence[bool]) -> int | None:
    """The index of the answer to keep: the most confident, and of equals the first; None where there is no answer.

    An answer without a confidence is kept only where no answer has one.
    """
    known = [index for index, given in enumerate(answered) if given]
    if not known:
        return None
    return max(known, key=lambda i: (-np.inf if (c := confidence[i]) is None else c, -i))


def errors_where_known(poses: Sequence[Array | None], T_query_ref: Array) -> PoseErrors:
    """The errors of answers to (N, 4, 4) true poses; infinite where there is no answer, or no truth to judge it by."""
    known: Mask = np.all(np.isfinite(T_query_ref), axis=(1, 2))
    return pose_errors(pose_array(poses), np.where(known[:, None, None], T_query_ref, np.eye(4)), answered=known)


def _together(seconds: Sequence[float | None]) -> float | None:
    known = [s for s in seconds if s is not None]
    return round(sum(known), 6) if known else None


def _why_not(retrieved: Retrieved, answers: Sequence[Answer]) -> tuple[str, str]:
    """The status and message of a query without an answer."""
    if not answers:
        status = "error" if retrieved.status == "error" else "failed"
        return status, f"retrieval: {retrieved.message or 'nothing was retrieved'}"
    crashed = [a for a in answers if a.status == "error"]
    return ("error", crashed[0].message) if crashed else ("failed", answers[0].message)
