"""The records of a retriever on one set: rankings, run record and scores.

For each task, ``RESULTS/SET@FINGERPRINT/METHOD/`` holds the retrieved images (``TASK.txt``: a line ``query db`` each,
best first, as hloc's pairs) and a table with the exact ranks of each query's positives (``TASK.csv``). ``run.yaml`` and
``scores.yaml`` describe the method; ``retrieval.yaml`` beside the methods describes the tasks.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.schema import Fingerprint, FolderName, JoinedName, Name, Strict
from relocbench.errors import PredictionError
from relocbench.evaluation.common.folders import SetFolder
from relocbench.evaluation.common.results import (
    Count,
    MethodResults,
    RunRecord,
    write_record,
)
from relocbench.evaluation.retrieval.blind_set import WITHHELD
from relocbench.files import MAX_FOLDER_BYTES, check_joined_name, load_yaml
from relocbench.metrics import chance_level
from relocbench.retrieval import RetrievalSet, RetrievalTask

SET_FILE = "retrieval.yaml"
METRICS = ("R@1", "R@5", "R@10", "R@20", "R@top1%", "AP", "MRR")
"""the metrics, in the order in which tables show them"""


class TaskRecord(Strict):
    """What a leaderboard must know about a task when the images are not available."""

    queries: Count
    gallery: Count
    """number of images, junk included"""
    junk: Count = 0
    without_positives: Count
    """number of queries without a right image in the gallery; they count as not found"""
    most_positives: Count
    """largest number of positives of a query"""
    view_query: str
    view_gallery: str
    condition_query: str = ""
    condition_gallery: str = ""
    grouped: bool = False
    """whether queries are resampled by groups rather than in blocks along the drive"""
    chance: dict[str, float] = Field(default_factory=dict)
    """the average score of a gallery in random order, by metric"""

    @property
    def single_positive(self) -> bool:
        """Whether each query has exactly one positive."""
        return self.most_positives == 1 and not self.without_positives

    @property
    def direction(self) -> str:
        """The views of queries and gallery, as ``drone → satellite``."""
        return f"{self.view_query} → {self.view_gallery}"

    @property
    def conditions(self) -> str:
        """The conditions of queries and gallery, as ``rain → clear``; empty where they are unknown."""
        known = self.condition_query or self.condition_gallery
        return f"{self.condition_query or '?'} → {self.condition_gallery or '?'}" if known else ""


class SetRecord(Strict):
    """``RESULTS/SET@FINGERPRINT/retrieval.yaml``: the tasks of one retrieval set."""

    name: FolderName
    fingerprint: Fingerprint
    question: str = ""
    """the content id, equal on all processors; empty in results of versions that did not record it"""
    positives: str = ""
    """which images are right, in words"""
    options: dict[str, float | str] = Field(default_factory=dict)
    """the options of ``relocbench evaluate`` that make this set of its dataset"""
    splits: dict[Name, tuple[JoinedName, ...]] = Field(default_factory=dict)
    """split -> tasks"""
    tasks: dict[JoinedName, TaskRecord]

    @property
    def is_withheld(self) -> bool:
        """Whether the set is a blind export, so that answers to it are not scored here."""
        return self.positives == WITHHELD

    @property
    def names(self) -> tuple[str, ...]:
        """Of the tasks."""
        return tuple(self.tasks)

    @property
    def compared_by(self) -> str:
        """The content id, or the fingerprint where none is recorded: results with the same value are compared."""
        return self.question or self.fingerprint


class TaskRun(Strict):
    """Facts about a run on one task, which tell a wrong network from a hard task."""

    dimensions: int | None = None
    """length of a descriptor"""
    descriptor_bytes: int | None = None
    """of the descriptor of one gallery image, in the number type that the method returned"""
    queries_described: int
    gallery_described: int
    descriptor_variance: float | None = None
    """of normalised descriptors about their mean, 0..1: near 0 all images look alike to the method"""
    rerank_top: int = 0
    gallery_seconds: float | None = None
    """for describing the gallery, without reading images; None where descriptors of an earlier task were used"""
    fit_seconds: float | None = None
    peak_memory_bytes: int | None = None
    """most resident memory of the method's process and its children until the task was done; None where none is told"""


class RetrievalRun(RunRecord):
    """``run.yaml`` of a retriever."""

    task: Literal["retrieval"] = "retrieval"
    keep: int | None = Field(None, ge=1)
    """number of retrieved images that are kept of each query; None for all"""
    info: dict[str, Any] = Field(default_factory=dict)
    """what the retriever reports in its ``info``, such as its training data"""
    tasks: dict[str, TaskRun] = Field(default_factory=dict)


class RetrieverScores(Strict):
    """``scores.yaml`` of a retriever."""

    relocbench: str
    run: str = ""
    """SHA-256 of ``run.yaml``; empty in results of versions that did not record it"""
    answers: dict[JoinedName, str]
    """task -> SHA-256 of its table"""
    lists: dict[JoinedName, str] = Field(default_factory=dict)
    """task -> SHA-256 of the retrieved images"""
    denominator: str
    tasks: dict[str, dict[str, float | int | None]]
    """task -> counts, metrics 0..1, and ``METRIC_low`` and ``METRIC_high`` of their 95 % intervals"""


@dataclass(frozen=True)
class RetrieverResults(MethodResults):
    """The folder of one retriever: ``TASK.txt`` and ``TASK.csv`` for each task."""

    def run_record(self) -> RetrievalRun:
        """Read ``run.yaml``. Raises PredictionError with file and line."""
        return load_yaml(self.run_yaml, RetrievalRun, "the record of a retrieval run", PredictionError)

    def retrieval_scores(self) -> RetrieverScores:
        """Read ``scores.yaml``. Raises PredictionError with file and line."""
        return load_yaml(self.scores_yaml, RetrieverScores, "the scores of a retriever", PredictionError)


@dataclass(frozen=True)
class SetResults(SetFolder[SetRecord, RetrieverResults]):
    """The folder of one retrieval set: ``NAME@FINGERPRINT``."""

    FILE = SET_FILE
    WHAT = "the record of a retrieval set"
    RECORD = SetRecord
    METHOD = RetrieverResults


def set_results(results: Path, retrieval_set: RetrievalSet) -> SetResults:
    """The folder for a set's results; nothing is created."""
    try:
        name = check_joined_name(retrieval_set.name, "name of a retrieval set", most_bytes=MAX_FOLDER_BYTES)
    except ValueError as bad:
        raise PredictionError(str(bad)) from None
    return SetResults(results / f"{name}@{retrieval_set.fingerprint[:SHORT]}")


def write_set_record(folder: SetResults, retrieval_set: RetrievalSet, tasks: Sequence[RetrievalTask]) -> None:
    """Write ``retrieval.yaml`` with these tasks, and those that it holds already."""
    path = folder.root / SET_FILE
    known: Mapping[str, TaskRecord] = folder.record.tasks if path.exists() else {}
    new = {task.name: task_record(task) for task in tasks}
    all_tasks = {**known, **new}
    record = SetRecord(
        name=retrieval_set.name,
        fingerprint=retrieval_set.fingerprint,
        question=getattr(retrieval_set, "content_id", ""),
        positives=getattr(retrieval_set, "positives", ""),
        options=dict(getattr(retrieval_set, "options", {})),
        splits=splits_of(retrieval_set, all_tasks),
        tasks=dict(sorted(all_tasks.items())),
    )
    write_record(path, record)


def splits_of(retrieval_set: RetrievalSet, tasks: Container[str]) -> dict[str, tuple[str, ...]]:
    """The splits of a set with those of these tasks that belong to them; a split without any is left out."""
    splits: Mapping[str, Sequence[str]] = getattr(retrieval_set, "splits", {})
    return {split: kept for split, of in splits.items() if (kept := tuple(name for name in of if name in tasks))}


def task_record(task: RetrievalTask) -> TaskRecord:
    """The record of a task; computing its chance level takes time proportional to the gallery's size."""
    positives = task.relevance.positives
    return TaskRecord(
        queries=len(task.queries),
        gallery=len(task.gallery),
        junk=int(task.relevance.junk.sum()),
        without_positives=int((positives == 0).sum()),
        most_positives=int(positives.max(initial=0)),
        view_query=_views(task.queries),
        view_gallery=_views(task.gallery),
        condition_query=task.condition_query,
        condition_gallery=task.condition_gallery,
        grouped=bool(task.groups),
        chance={name: round(value, 9) for name, value in chance_level(task.relevance, METRICS).items()},
    )


def _views(images: Sequence[Any]) -> str:
    return "+".join(sorted({image.view for image in images}))
