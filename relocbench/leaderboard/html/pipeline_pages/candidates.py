"""What the page of a query shows of pipelines: each retrieved keyframe, where it was, and what the tracker answered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.pairs.street_places import street_view
from relocbench.evaluation.relocalization.pipeline import RIGHT, Retrieved, Tracked
from relocbench.evaluation.relocalization.records import PipelineBasin
from relocbench.evaluation.relocalization.rescoring import PipelineTruth
from relocbench.evaluation.relocalization.truth import MapTruth, distance_and_angle, inside
from relocbench.leaderboard.html.chosen import worst_and_drawn
from relocbench.leaderboard.html.pipeline_pages.payloads import is_keyframe_pose
from relocbench.leaderboard.html.thumbnails import Thumbnail, thumbnail_name
from relocbench.leaderboard.relocalization.board import Pipeline
from relocbench.metrics import pose_errors
from relocbench.retrieval import ImageView


@dataclass(frozen=True, eq=False)
class AskedPipeline:
    """What the halves of a pipeline said on a task."""

    pipeline: Pipeline
    found: Sequence[Retrieved]
    tracked: Tracked
    basin: PipelineBasin


def asked_pipelines(truth: PipelineTruth, pipelines: Sequence[Pipeline], task: str) -> list[AskedPipeline]:
    """The pipelines whose rankings and trackers' answers lie beside the results, and were confirmed by the dataset."""
    out = []
    for pipeline in pipelines:
        both = truth.asked(pipeline.run, task) if task in pipeline.rescored else None
        if both is not None:
            out.append(AskedPipeline(pipeline, *both, pipeline.basins[task]))
    return out


def chosen_queries(pipelines: Sequence[Pipeline], task: str, count: int) -> list[int]:
    """The indices of the queries that are shown with pictures, in ascending order.

    They are the ``count`` worst of each pipeline that is no baseline, by the larger error in units of what counts as
    right, and ``count`` drawn at random.
    """
    own = [pipeline for pipeline in pipelines if task in pipeline.answers]
    competing = [pipeline.answers[task] for pipeline in own if not is_keyframe_pose(pipeline)]
    both = [
        [max(a.translation_error_m / RIGHT[0], a.rotation_error_deg / RIGHT[1]) for a in answers]
        for answers in competing
    ]
    return worst_and_drawn(both, len(own[0].answers[task]), count)


def candidates_payload(
    truth: MapTruth,
    asked: Sequence[AskedPipeline],
    times: Sequence[int],
    kept: Sequence[int],
    views: Mapping[int, tuple[ImageView, ...]],
) -> dict[str, Any]:
    """The keyframes of the queries that are kept.

    Args:
        times: timestamps of all queries, nanoseconds, in the order of the rows of tables.
        kept: rows of queries, ascending.
        views: of the queries with pictures, the image of the query and then those of its keyframes.
    """
    place = {time: index for index, time in enumerate(truth.query_times)}
    nearest: list[Any] = []
    told: dict[str, list[Any]] = {one.pipeline.label: [] for one in asked}
    for row in kept:
        query = place[times[row]]
        T_query_ref = truth.relative(query)
        metres, degrees = distance_and_angle(T_query_ref)
        best = truth.oracle(query, 1)
        nearest.append(_keyframe(truth, best[0], metres, degrees) if best else None)
        for one in asked:
            told[one.pipeline.label].append(_told(truth, one, query, T_query_ref, metres, degrees))
    return {
        "rows": None if len(kept) == len(times) else list(kept),
        "nearest": nearest,
        "pipelines": told,
        "queries": {row: thumbnail_name(of[0].key) for row, of in views.items()},
        "keyframes": {_time(view): thumbnail_name(view.key) for of in views.values() for view in of[1:]},
    }


def views_of(
    truth: PipelineTruth, task: str, asked: Sequence[AskedPipeline], times: Sequence[int], chosen: Sequence[int]
) -> dict[int, tuple[ImageView, ...]]:
    """The images of chosen queries: the query, the nearest keyframe, and the keyframes that any pipeline retrieved."""
    known, dataset = truth.truth(task), truth.dataset
    place = {time: index for index, time in enumerate(known.query_times)}
    reference, query_drive = (dataset.traversal(n) for n in (known.pair_set.reference, known.pair_set.query))
    camera = known.pair_set.camera
    out = {}
    for row in chosen:
        query = place[times[row]]
        indices = {*known.oracle(query, 1), *(k for one in asked for k in one.found[query].keyframes[: _top(one)])}
        keyframes = [known.keyframe_times[k] for k in sorted(indices)]
        out[row] = (
            street_view(query_drive, camera, times[row]),
            *(street_view(reference, camera, time) for time in keyframes),
        )
    return out


def thumbnails_of(views: Mapping[int, tuple[ImageView, ...]], site: Path, of_set: str) -> Iterator[Thumbnail]:
    """The pictures of the images of queries."""
    return (Thumbnail(site, of_set, view) for of in views.values() for view in of)


def _top(one: AskedPipeline) -> int:
    return one.pipeline.run.top


def _time(view: ImageView) -> str:
    return Path(view.key).stem


def _keyframe(truth: MapTruth, index: int, metres: Array, degrees: Array) -> list[str | float | None]:
    """Timestamp of a keyframe, and metres and degrees between its camera and the query's."""
    return [str(truth.keyframe_times[index]), _rounded(metres[index]), _rounded(degrees[index])]


def _told(
    truth: MapTruth, one: AskedPipeline, query: int, T_query_ref: Array, metres: Array, degrees: Array
) -> list[list[Any]]:
    """For each keyframe that the tracker was asked against: where it was, and the answer.

    Timestamp, metres, degrees, whether it is in the basin, status, confidence, translation and rotation error.
    """
    keyframes = list(one.found[query].keyframes[: _top(one)])
    if not keyframes:
        return []
    time = truth.query_times[query]
    keys = [(truth.keyframe_times[k], time) for k in keyframes]
    near = inside(metres[keyframes], degrees[keyframes], (one.basin.metres, one.basin.degrees))
    poses = np.array([one.tracked.poses.get(key, np.full((4, 4), np.nan)) for key in keys])
    known = np.asarray(np.isfinite(T_query_ref[keyframes]).all(axis=(1, 2)))
    errors = pose_errors(poses, np.where(known[:, None, None], T_query_ref[keyframes], np.eye(4)), answered=known)
    out = []
    for row, (index, key) in enumerate(zip(keyframes, keys, strict=True)):
        answer = one.tracked.answers[key]
        out.append(
            [
                *_keyframe(truth, index, metres, degrees),
                bool(near[row]),
                answer.status,
                answer.confidence,
                float(errors.translation_error_m[row]),
                float(errors.rotation_error_deg[row]),
            ]
        )
    return out


def _rounded(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
