"""The queries of a task of pipelines: the answers, and each retrieved keyframe with what the tracker made of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.pairs.street_places import street_view, time_of_key
from relocbench.evaluation.relocalization.answers import OUTCOMES, PipelineAnswer
from relocbench.evaluation.relocalization.basin import Basin
from relocbench.evaluation.relocalization.pipeline import RIGHT, Retrieved, Tracked, errors_where_known
from relocbench.evaluation.relocalization.rescoring import PipelineTruth
from relocbench.evaluation.relocalization.truth import MapTruth, distance_and_angle, inside
from relocbench.evaluation.retrieval.answers import ANSWERS
from relocbench.evaluation.retrieval.records import RetrieverResults
from relocbench.evaluation.tables.schema import STATUSES
from relocbench.leaderboard.html.data import bytes_of, floats, integers
from relocbench.leaderboard.html.thumbnails import thumbnail_name
from relocbench.leaderboard.relocalization.board import Pipeline, PipelineSetBoard
from relocbench.retrieval import ImageView

_NONE = -1
"""in place of the timestamp of a keyframe that there is none of"""


@dataclass(frozen=True, eq=False)
class _Halves:
    """What the halves of a pipeline said on a task."""

    found: Sequence[Retrieved]
    tracked: Tracked
    basin: Basin
    top: int

    def keyframes(self, query: int) -> list[int]:
        """The indices of the keyframes that the tracker was asked against."""
        return list(self.found[query].keyframes[: self.top])


class LocatedQueries:
    """The queries of a task that at least one pipeline has answered, in the order of time."""

    def __init__(self, of: PipelineSetBoard, name: str) -> None:
        """Read the rankings and trackers' answers that lie beside the results and were confirmed by the dataset.

        Raises:
            PredictionError: rankings or trackers' answers are bad.
        """
        self._name = name
        self._pipelines = {pipeline.label: pipeline for pipeline in of.methods if name in pipeline.answers}
        first = next(iter(self._pipelines.values())).answers[name]
        self._times = [answer.query_timestamp_ns for answer in first]
        self._truth: PipelineTruth | None = of.truth
        self._halves: dict[str, _Halves] = {}
        for label, pipeline in self._pipelines.items():
            both = of.truth.asked(pipeline.run, name) if of.truth is not None and name in pipeline.rescored else None
            if both is not None:
                self._halves[label] = _Halves(*both, pipeline.basins[name], pipeline.run.top)

    def answers(self) -> dict[str, Any]:
        """The answers of all pipelines."""
        return {
            "units": {"query": integers(self._times)},
            "methods": {label: _answers(pipeline, self._name) for label, pipeline in self._pipelines.items()},
        }

    def how_bad(self) -> list[list[float]]:
        """The larger error in units of what counts as right."""
        competing = [p.answers[self._name] for p in self._pipelines.values() if not p.is_baseline]
        return [
            [max(a.translation_error_m / RIGHT[0], a.rotation_error_deg / RIGHT[1]) for a in answers]
            for answers in competing
        ]

    def details(self, kept: Sequence[int], chosen: Sequence[int]) -> dict[str, Any] | None:
        """The keyframes of the queries that are kept; None where the dataset is not available."""
        if self._truth is None:
            return None
        truth, views = self._truth.truth(self._name), self._views(chosen)
        place = {time: index for index, time in enumerate(truth.query_times)}
        nearest: list[Any] = []
        of_pipelines: dict[str, list[Any]] = {label: [] for label in self._halves}
        for row in kept:
            query = place[self._times[row]]
            T_query_ref = truth.relative(query)
            metres, degrees = distance_and_angle(T_query_ref)
            best = truth.oracle(query, 1)
            nearest.append(_keyframe(truth, best[0], metres, degrees) if best else None)
            for label, halves in self._halves.items():
                of_pipelines[label].append(_tried(truth, halves, query, T_query_ref, metres, degrees))
        return {
            "rows": None if len(kept) == len(self._times) else list(kept),
            "nearest": nearest,
            "pipelines": of_pipelines,
            "queries": {row: thumbnail_name(of[0].key) for row, of in views.items()},
            "keyframes": {Path(view.key).stem: thumbnail_name(view.key) for of in views.values() for view in of[1:]},
        }

    def views(self, chosen: Sequence[int]) -> Iterator[ImageView]:
        """The images of the chosen queries, each followed by those of its keyframes."""
        return (view for of in self._views(chosen).values() for view in of)

    def _views(self, chosen: Sequence[int]) -> dict[int, list[ImageView]]:
        """The query, and then the nearest keyframe and those that any pipeline retrieved, by time."""
        if self._truth is None:
            return {}
        known, dataset = self._truth.truth(self._name), self._truth.dataset
        drives = [dataset.traversal(n) for n in (known.pair_set.reference, known.pair_set.query)]
        of_keyframes, of_queries = known.pair_set.cameras
        out = {}
        for row in chosen:
            query = known.query_times.index(self._times[row])
            indices = {*known.oracle(query, 1), *(k for of in self._halves.values() for k in of.keyframes(query))}
            keyframes = [street_view(drives[0], of_keyframes, known.keyframe_times[k]) for k in sorted(indices)]
            out[row] = [street_view(drives[1], of_queries, self._times[row]), *keyframes]
        return out


def _keyframe(truth: MapTruth, index: int, metres: Array, degrees: Array) -> list[str | float | None]:
    """Timestamp of a keyframe, and metres and degrees between its camera and the query's."""
    return [str(truth.keyframe_times[index]), _rounded(metres[index]), _rounded(degrees[index])]


def _tried(
    truth: MapTruth, halves: _Halves, query: int, T_query_ref: Array, metres: Array, degrees: Array
) -> list[list[Any]]:
    """For each keyframe that the tracker was asked against: where it was, and the answer.

    Timestamp, metres, degrees, whether it is in the basin, status, confidence, translation and rotation error.
    """
    keyframes = halves.keyframes(query)
    if not keyframes:
        return []
    time = truth.query_times[query]
    keys = [(truth.keyframe_times[k], time) for k in keyframes]
    near = inside(metres[keyframes], degrees[keyframes], halves.basin.limits)
    errors = errors_where_known([halves.tracked.poses.get(key) for key in keys], T_query_ref[keyframes])
    out = []
    for row, (index, key) in enumerate(zip(keyframes, keys, strict=True)):
        answer = halves.tracked.answers[key]
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


def _answers(pipeline: Pipeline, task: str) -> dict[str, Any]:
    rows = pipeline.answers[task]
    retrieval = retrieval_seconds(pipeline, task)
    return {
        "translation_error_m": floats([a.translation_error_m for a in rows]),
        "rotation_error_deg": floats([a.rotation_error_deg for a in rows]),
        "confidence": floats(_numbers([a.confidence for a in rows])),
        "seconds": floats(_numbers([a.seconds for a in rows])),
        "retrieval_seconds": None if retrieval is None else floats(retrieval),
        "status": bytes_of([STATUSES.index(a.status) for a in rows]),
        "outcome": bytes_of([OUTCOMES.index(a.outcome) for a in rows]),
        "keyframe": integers([_NONE if a.ref_timestamp_ns is None else a.ref_timestamp_ns for a in rows]),
        "asked": floats([a.asked for a in rows]),
        **{name: floats([_or_none(a, name) for a in rows]) for name in ("rank", "hit_rank", "right_rank")},
        "messages": {row: answer.message for row, answer in enumerate(rows) if answer.message},
    }


def _or_none(answer: PipelineAnswer, name: str) -> float:
    """A rank; infinite where there is none."""
    value: int | None = getattr(answer, name)
    return np.inf if value is None else value


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values])


def _rounded(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None


def retrieval_seconds(pipeline: Pipeline, task: str) -> Array | None:
    """(Q,) seconds of the pipeline's retriever for each query, NaN where they are not known.

    Returns:
        None where nothing took seconds (the oracle), or where the rankings do not lie in the results folder, or are
        others than those that the pipeline started from.
    """
    ran = pipeline.run.retriever_run
    if ran is None:
        return None
    of_set = pipeline.folder.root.parents[1] / f"{ran.dataset}@{ran.fingerprint[:SHORT]}"
    results = RetrieverResults(of_set / pipeline.run.retriever)
    if not results.run_yaml.exists() or not results.complete(task):
        return None
    now = results.run_record()
    if (now.target, now.parameters, now.files, now.seed) != (ran.target, ran.parameters, ran.files, ran.seed):
        return None
    seconds = {time_of_key(answer.query): answer.seconds for answer in ANSWERS.read(results.answers(task))}
    out = np.full(len(pipeline.answers[task]), np.nan)
    for row, answer in enumerate(pipeline.answers[task]):
        known = seconds.get(answer.query_timestamp_ns)
        if known is not None and answer.seconds is not None and known <= answer.seconds + 1e-6:
            out[row] = known
    return out
