"""Comparing pipelines of a retriever and a tracker: on each task, by conditions, and with shared ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import SetFolder
from relocbench.evaluation.common.results import RunRecord
from relocbench.evaluation.relocalization.answers import PIPELINE, PipelineAnswer, errors_of
from relocbench.evaluation.relocalization.basin import Basin
from relocbench.evaluation.relocalization.records import (
    KEYFRAME,
    ORACLE,
    PipelineResults,
    PipelineRun,
    PipelineSet,
    PipelineSetResults,
    PipelineTask,
)
from relocbench.evaluation.relocalization.rescoring import AGAIN, PipelineTruth
from relocbench.evaluation.relocalization.score import (
    FAILURES,
    HIT,
    POSE_METRICS,
    RANKING,
    basin_recall,
    per_query,
    pose_errors_of,
)
from relocbench.files import sha256_file
from relocbench.leaderboard.common.by_query import Board, QueryTask, SetBoard, Table
from relocbench.leaderboard.common.loading import Plan
from relocbench.leaderboard.common.model import Row
from relocbench.leaderboard.common.untrusted_results import check_lies_with

SHARES = (basin_recall(1), HIT, "right_and_hit", "right_without_hit", "right_among_K", *FAILURES)


@dataclass(frozen=True, eq=False)
class Pipeline:
    """The results of one pipeline on one set."""

    label: str
    run: PipelineRun
    basins: Mapping[str, Basin]
    answers: Mapping[str, Sequence[PipelineAnswer]]
    """by task; tasks without results are absent"""
    rescored: frozenset[str]
    """the tasks whose rows were computed anew from rankings, trackers' answers and truth"""
    folder: PipelineResults
    card: None = None
    """nobody submits pipelines"""

    @property
    def knows_truth(self) -> bool:
        return self.run.retriever == ORACLE

    @property
    def uses_times(self) -> bool:
        """Whether the tracker was shown times."""
        return self.run.tracker_run is not None and self.run.tracker_run.uses_times

    @property
    def assumes(self) -> str:
        """What the tracker says that it assumes of how cameras move."""
        return "" if self.run.tracker_run is None else self.run.tracker_run.assumes

    @property
    def is_baseline(self) -> bool:
        """Whether the pipeline is a trivial baseline, which answers the pose of the first keyframe."""
        return self.run.tracker == KEYFRAME

    @property
    def is_ranked(self) -> bool:
        """Whether the pipeline is ranked: trivial baselines are not, nor what knows the truth or sees times."""
        return not (self.is_baseline or self.knows_truth or self.uses_times)


PipelineRow = Row[Pipeline]
PipelineTable = Table[Pipeline, PipelineTask]
PipelineSetBoard = SetBoard[PipelineSet, PipelineTask, Pipeline, PipelineTruth]
PipelineBoard = Board[PipelineSet, PipelineTask, Pipeline, PipelineTruth]


class RelocalizationBoards(QueryTask[PipelineResults, PipelineSet, PipelineTask, Pipeline, PipelineTruth]):
    """The task of pipelines. Trivial baselines are not ranked, nor what knows the truth or sees times."""

    what = "pipelines"
    kind = PipelineSetResults
    schema = PIPELINE
    rankable = (*POSE_METRICS, *SHARES)
    with_interval = (RANKING, "recall@(1m,5deg)", HIT)
    ranking = RANKING

    def is_of(self, dataset: Dataset | CrossViewSet, record: PipelineSet) -> bool:
        return (dataset.name, dataset.fingerprint) == (record.dataset, record.dataset_fingerprint)

    def truth(
        self, folder: SetFolder[PipelineSet, PipelineResults], record: PipelineSet, lookup: DatasetLookup
    ) -> PipelineTruth | None:
        dataset = lookup.find(lambda one: self.is_of(one, record))
        return None if dataset is None else PipelineTruth(dataset, PipelineSetResults(folder.root))

    def read(
        self,
        folder: PipelineResults,
        record: PipelineSet,
        tasks: Mapping[str, PipelineTask],
        truth: PipelineTruth | None,
    ) -> Pipeline:
        run = folder.run_record()
        check_lies_with(run.dataset, run.fingerprint, record, folder.run_yaml)
        answers: dict[str, Sequence[PipelineAnswer]] = {}
        rescored: set[str] = set()
        scores = folder.scores() if folder.scores_yaml.exists() else None
        if scores is not None and scores.run != sha256_file(folder.run_yaml):
            raise PredictionError(f"is not the record that was scored; {AGAIN}", folder.run_yaml)
        for name, task in tasks.items():
            path = folder.answers(name)
            if not path.exists():
                continue
            if scores is None or name not in scores.answers or name not in scores.basins:
                raise PredictionError(f"is not scored; {AGAIN}", path)
            if scores.answers[name] != sha256_file(path):
                raise PredictionError(f"changed since it was scored; {AGAIN}", path)
            answers[name] = PIPELINE.read(path)
            if len(answers[name]) != task.queries:
                why = f"{len(answers[name])} rows, expected one for each of {task.queries} queries"
                raise PredictionError(why, path)
            if truth is not None and truth.rescored(run, name, scores.basins[name], answers[name], path):
                rescored.add(name)
        return Pipeline(folder.label, run, scores.basins if scores else {}, answers, frozenset(rescored), folder)

    def renamed(self, method: Pipeline, label: str) -> Pipeline:
        return replace(method, label=label)

    def question(self, method: Pipeline, task: str) -> Sequence[object]:
        return [answer.query_timestamp_ns for answer in method.answers[task]]

    def title(self, record: PipelineSet) -> str:
        return f"{record.dataset}@{record.dataset_fingerprint[:SHORT]}"

    def tables(self, tasks: Mapping[str, PipelineTask]) -> dict[str, tuple[str, ...]]:
        return {**_means(tasks), **{name: (name,) for name in tasks}}

    def values(self, method: Pipeline, plan: Plan, metric: str) -> list[Array]:
        return [per_query(method.answers[task], metric) for task in plan.units]

    def alike(self, method: Pipeline, plan: Plan) -> list[Array]:
        return [pose_errors_of(method.answers[task]) for task in plan.units]

    def further(self, method: Pipeline, plan: Plan, means: Mapping[str, float]) -> Mapping[str, float | None]:
        errors = errors_of([answer for task in plan.units for answer in method.answers[task]])
        return {
            "right_given_hit": means["right_and_hit"] / means[HIT] if means[HIT] else None,
            "median_translation_error_m": float(np.median(errors.translation_error_m)),
            "median_rotation_error_deg": float(np.median(errors.rotation_error_deg)),
        }

    def runs(self, method: Pipeline) -> Sequence[RunRecord]:
        halves = (method.run.retriever_run, method.run.tracker_run)
        top = {"top": method.run.top}
        return [h.model_copy(update={"parameters": {**h.parameters, **top}}) for h in halves if h is not None]

    def is_ranked(self, method: Pipeline) -> bool:
        return method.is_ranked

    def higher_is_better(self, metric: str) -> bool:
        return not metric.startswith("failed_")


RELOCALIZATION = RelocalizationBoards()


def is_rescored(row: PipelineRow, table: PipelineTable) -> bool:
    """Whether all rows of a pipeline's tasks were computed anew."""
    return not row.missing and row.method.rescored.issuperset(table.tasks)


def _means(tasks: Mapping[str, PipelineTask]) -> dict[str, tuple[str, ...]]:
    """The tables of means: over all tasks, across conditions, within conditions, and for each pair of conditions."""
    out = {"mean over all tasks": list(tasks), "mean across conditions": [], "mean within a condition": []}
    for name, record in tasks.items():
        same = record.condition_gallery == record.condition_query
        out["mean within a condition" if same else "mean across conditions"].append(name)
        out.setdefault(f"conditions {record.condition_gallery} → {record.condition_query}", []).append(name)
    kept = {name: tuple(of) for name, of in out.items() if len(of) > 1}
    whole = kept.get("mean over all tasks")
    return {name: of for name, of in kept.items() if name == "mean over all tasks" or of != whole}
