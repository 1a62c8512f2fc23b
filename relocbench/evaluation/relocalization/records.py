"""The records of pipelines on one dataset.

``RESULTS/DATASET.relocalization@FINGERPRINT/`` holds ``relocalization.yaml`` (which describes the tasks),
``answers/TRACKER/`` (every answer of a tracker, as in its own results, whichever retriever proposed the keyframe) and,
for each pipeline, ``RETRIEVER+TRACKER.topK/``: the poses that were kept (``TASK.txt``), one row for each query
(``TASK.csv``), ``run.yaml`` and ``scores.yaml``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.schema import Fingerprint, FolderName, JoinedName, Name, Strict
from relocbench.errors import PredictionError
from relocbench.evaluation.common.folders import AnswerFolder, SetFolder
from relocbench.evaluation.common.results import (
    DatasetResults,
    RunRecord,
    write_record,
)
from relocbench.evaluation.relocalization.basin import Basin
from relocbench.evaluation.retrieval.records import RetrievalRun
from relocbench.files import load_yaml

SET_FILE = "relocalization.yaml"
ANSWERS = "answers"
ORACLE = "oracle"
"""the retriever that ranks keyframes by the true poses"""
KEYFRAME = "keyframe-pose"
"""the tracker that always answers the pose of the first keyframe"""


class PipelineTask(Strict):
    """What a leaderboard must know about a task when the dataset is not available."""

    queries: int
    gallery: int
    """number of keyframes"""
    pairs: int
    rejected: int
    """number of pairs whose ground truth was rejected"""
    images_without_pair: int
    """images of the query traversal that are in no pair: their true pose is unknown, and they are not queries"""
    condition_query: str = ""
    condition_gallery: str = ""
    reach_m: float
    """largest distance of a pair"""
    reach_deg: float
    """largest angle of a pair"""
    unposed_keyframes: int = 0
    """number of keyframes without a pose in their own traversal"""
    truth_spread_m: float | None = None
    """median over queries of how much their pairs disagree about their position; None where no query has two pairs"""
    median_sigma_translation_m: float | None = None
    median_sigma_rotation_deg: float | None = None


class PipelineSet(Strict):
    """``relocalization.yaml``: the tasks of one dataset."""

    name: FolderName
    dataset: FolderName
    dataset_fingerprint: Fingerprint
    fingerprint: Fingerprint
    splits: dict[Name, tuple[JoinedName, ...]] = Field(default_factory=dict)
    tasks: dict[JoinedName, PipelineTask]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the tasks."""
        return tuple(self.tasks)

    @property
    def compared_by(self) -> str:
        """Results with the same value are compared."""
        return self.fingerprint


class PipelineRun(Strict):
    """``run.yaml`` of a pipeline: how both halves were made."""

    task: Literal["relocalization"] = "relocalization"
    retriever: Name
    tracker: Name
    top: int
    dataset: FolderName
    fingerprint: Fingerprint
    """fingerprint of the set"""
    retriever_run: RetrievalRun | None = None
    """None for the oracle"""
    tracker_run: RunRecord | None = None
    """None where no tracker ran"""


class PipelineScores(Strict):
    """``scores.yaml`` of a pipeline."""

    relocbench: str
    run: str = ""
    """SHA-256 of ``run.yaml``; empty in results of versions that did not record it"""
    answers: dict[JoinedName, str]
    """task -> SHA-256 of its table"""
    basins: dict[str, Basin]
    tasks: dict[str, dict[str, float | int | None]]
    """task -> counts, metrics, and ``METRIC_low`` and ``METRIC_high`` of their 95 % intervals"""


@dataclass(frozen=True)
class PipelineResults(AnswerFolder):
    """The folder of one pipeline."""

    def run_record(self) -> PipelineRun:
        """Read ``run.yaml``. Raises PredictionError with file and line."""
        return load_yaml(self.run_yaml, PipelineRun, "the record of a pipeline", PredictionError)

    def scores(self) -> PipelineScores:
        """Read ``scores.yaml``. Raises PredictionError with file and line."""
        return load_yaml(self.scores_yaml, PipelineScores, "the scores of a pipeline", PredictionError)


@dataclass(frozen=True)
class PipelineSetResults(SetFolder[PipelineSet, PipelineResults]):
    """The folder of one dataset's pipelines."""

    FILE = SET_FILE
    WHAT = "the record of pipelines"
    RECORD = PipelineSet
    METHOD = PipelineResults

    @property
    def trackers(self) -> DatasetResults:
        """The answers of trackers, which pipelines share."""
        return DatasetResults(self.root / ANSWERS)

    def pipeline(self, retriever: str, tracker: str, top: int) -> PipelineResults:
        return self.method(f"{retriever}+{tracker}.top{top}")


def pipeline_results(results: Path, name: str, fingerprint: str) -> PipelineSetResults:
    """The folder for a set's pipelines; nothing is created."""
    return PipelineSetResults(results / f"{name}@{fingerprint[:SHORT]}")


def write_set(folder: PipelineSetResults, new: PipelineSet) -> None:
    """Write ``relocalization.yaml`` with these tasks, and those that it holds already."""
    path = folder.root / SET_FILE
    known = PipelineSetResults(folder.root).record.tasks if path.exists() else {}
    tasks = dict(sorted({**known, **new.tasks}.items()))
    write_record(path, new.model_copy(update={"tasks": tasks}))
