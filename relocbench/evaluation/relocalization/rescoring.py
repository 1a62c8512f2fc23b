"""Computing the rows of pipelines anew from rankings, trackers' answers and the dataset's truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import PredictionError
from relocbench.evaluation.relocalization.answers import PipelineAnswer
from relocbench.evaluation.relocalization.basin import Basin
from relocbench.evaluation.relocalization.candidates import read_tracked
from relocbench.evaluation.relocalization.pipeline import Retrieved, Tracked, keyframe_poses, pipeline_answers
from relocbench.evaluation.relocalization.rankings import Oracle, StoredRankings
from relocbench.evaluation.relocalization.records import (
    KEYFRAME,
    ORACLE,
    PipelineRun,
    PipelineSetResults,
)
from relocbench.evaluation.relocalization.tasks import PipelineTasks, pipeline_tasks
from relocbench.evaluation.relocalization.truth import MapTruth
from relocbench.evaluation.retrieval.opening import SetOptions, open_set
from relocbench.evaluation.retrieval.records import set_results
from relocbench.progress import Silent

AGAIN = "run `relocbench evaluate-relocalization` again to score"


class PipelineTruth:
    """The truth of a dataset's pipelines, with the rankings and answers that their results folder holds."""

    def __init__(self, dataset: Dataset, folder: PipelineSetResults) -> None:
        """Open the tasks of the dataset.

        Raises:
            PredictionError: the results folder says otherwise of a task than the dataset does.
            RelocbenchError: the dataset has no task with truth, or lies around the results.
        """
        results = folder.root.parent
        opened = open_set(dataset.root, results, SetOptions(positives="pairs"), Silent())
        self._dataset, self._folder = dataset, folder
        self._tasks: PipelineTasks = pipeline_tasks(dataset, opened, Silent())
        self._rankings = set_results(results, self._tasks.asked)
        self._check_record()

    @property
    def dataset(self) -> Dataset:
        """The dataset of the pipelines."""
        return self._dataset

    def truth(self, name: str) -> MapTruth:
        """The true poses of a task's queries against its keyframes."""
        return self._tasks.truth[name]

    def asked(self, run: PipelineRun, name: str) -> tuple[list[Retrieved], Tracked] | None:
        """What a pipeline's halves said on a task: the keyframes of each query, and the tracker's answers.

        Returns:
            None where the ranking or the tracker's answers are not in the results folder.
        """
        retrieved = self._retrieved(run, name)
        tracked = None if retrieved is None else self._tracked(run, name, retrieved)
        return None if retrieved is None or tracked is None else (retrieved, tracked)

    def rescored(
        self, run: PipelineRun, name: str, basin: Basin, claimed: Sequence[PipelineAnswer], path: Path
    ) -> bool:
        """Whether the rows of a pipeline on a task follow from rankings, answers and truth.

        Args:
            basin: the basin that the rows were judged by; where it is given or measured it is believed.
            claimed: the rows.
            path: their file, for messages.

        Returns:
            False where the ranking or the tracker's answers are not in the results folder.

        Raises:
            PredictionError: the rows are others.
        """
        truth = self._tasks.truth[name]
        if basin.source == "pairs" and not _close(basin.limits, truth.reach):
            raise PredictionError(f"the basin on '{name}' is not the reach of the dataset's pairs; {AGAIN}", path)
        both = self.asked(run, name)
        if both is None:
            return False
        found, tracked = both
        try:
            rows, _ = pipeline_answers(truth, found, tracked, run.top, basin)
        except KeyError:
            raise PredictionError(f"the tracker has no answers to what '{name}' ranks; {AGAIN}", path) from None
        by_query = {row.query_timestamp_ns: row for row in rows}
        for row in claimed:
            expected = by_query.get(row.query_timestamp_ns)
            if expected is None or not _same(row, expected):
                message = f"query {row.query_timestamp_ns} is not what rankings, answers and truth give"
                raise PredictionError(f"{message}; {AGAIN}", path)
        return True

    def _retrieved(self, run: PipelineRun, name: str) -> list[Retrieved] | None:
        task = next(task for task in self._tasks.asked.chosen if task.name == name)
        truth = self._tasks.truth[name]
        if run.retriever == ORACLE:
            return Oracle().of(task, truth, run.top)
        folder = self._rankings.method(run.retriever)
        return StoredRankings(folder).of(task, truth, run.top) if folder.complete(name) else None

    def _tracked(self, run: PipelineRun, name: str, retrieved: Sequence[Retrieved]) -> Tracked | None:
        if run.tracker == KEYFRAME:
            return keyframe_poses(self._tasks.truth[name], retrieved)
        folder = self._folder.trackers.method(run.tracker)
        return read_tracked(self._dataset, folder, name) if folder.complete(name) else None

    def _check_record(self) -> None:
        record, expected = self._folder.record, self._tasks.record
        for name, task in record.tasks.items():
            if task != expected.tasks.get(name) or record.fingerprint != expected.fingerprint:
                raise PredictionError(
                    f"the entry of the task '{name}' is not that of the dataset; {AGAIN}",
                    self._folder.root / "relocalization.yaml",
                )


def _same(claimed: PipelineAnswer, expected: PipelineAnswer) -> bool:
    """Whether two rows agree, their errors to the last digits that another processor explains."""
    errors = [(r.rotation_error_deg, r.translation_error_m, r.mlad_translation_error_m) for r in (claimed, expected)]
    rotation, translation, mlad = errors[0]
    others = replace(
        expected, rotation_error_deg=rotation, translation_error_m=translation, mlad_translation_error_m=mlad
    )
    return _close(*errors) and claimed == others


def _close(a: Sequence[float], b: Sequence[float]) -> bool:
    return all(math.isclose(x, y, rel_tol=1e-9, abs_tol=1e-6) for x, y in zip(a, b, strict=True))
