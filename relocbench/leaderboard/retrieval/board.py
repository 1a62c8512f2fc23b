"""Comparing retrievers: their scores on each task, by views and by conditions, and with shared ranks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import SetFolder
from relocbench.evaluation.common.results import PREDICTIONS, RunRecord
from relocbench.evaluation.retrieval.answers import ANSWERS, QueryAnswer
from relocbench.evaluation.retrieval.records import (
    METRICS,
    RetrievalRun,
    RetrieverResults,
    RetrieverScores,
    SetRecord,
    SetResults,
    TaskRecord,
)
from relocbench.evaluation.retrieval.rescoring import Confirmed, RetrievalTruth, belongs, truth_of
from relocbench.evaluation.retrieval.score import checked_answers, resampled, scores_of
from relocbench.evaluation.submission.kept import KeptCard, kept_card
from relocbench.files import sha256_file
from relocbench.leaderboard.common.by_query import Board, QueryTask, SetBoard, Table
from relocbench.leaderboard.common.loading import Plan
from relocbench.leaderboard.common.model import Row
from relocbench.leaderboard.common.untrusted_results import check_lies_with
from relocbench.metrics import by_place, single_positive_fault
from relocbench.metrics.retrieval.measures import RetrievalScores

RANDOM_TARGETS = ("random", "baselines.floors:RandomOrder")
"""the targets of the retriever that ranks at random"""
_AGAIN = "run `relocbench evaluate-retrieval` again to score"


@dataclass(frozen=True, eq=False)
class Retriever:
    """The results of one method on one set."""

    label: str
    run: RetrievalRun
    answers: Mapping[str, Sequence[QueryAnswer]]
    """by task; tasks without results are absent"""
    confirmed: Mapping[str, Confirmed]
    """how far the ranks follow from the images that were kept, by task; empty where the truth is not available"""
    ran_as: str
    """the label in the run's record, which the name of the folder replaces"""
    card: KeptCard | None
    """of lists that were submitted"""
    folder: RetrieverResults
    """where its lists are kept"""
    records: Mapping[str, TaskRecord]
    """of the tasks"""
    _scores: dict[str, RetrievalScores] = field(default_factory=dict, repr=False)

    @property
    def is_baseline(self) -> bool:
        """Whether the method is the trivial baseline, which ranks at random, whatever its label."""
        return self.run.target.removeprefix(PREDICTIONS) in RANDOM_TARGETS

    def per_query(self, task: str, metric: str) -> Array:
        """(Q,) the values of a metric on a task."""
        if task not in self._scores:
            self._scores[task] = scores_of(self.answers[task], self.records[task])
        return self._scores[task].per_query(metric)


RetrievalRow = Row[Retriever]
RetrievalTable = Table[Retriever, TaskRecord]
RetrievalSetBoard = SetBoard[SetRecord, TaskRecord, Retriever, RetrievalTruth]
RetrievalBoard = Board[SetRecord, TaskRecord, Retriever, RetrievalTruth]


class RetrievalBoards(QueryTask[RetrieverResults, SetRecord, TaskRecord, Retriever, RetrievalTruth]):
    """The task of retrievers. Queries of places are drawn by place, those along a drive in blocks."""

    what = "retrievers"
    kind = SetResults
    schema = ANSWERS
    rankable = METRICS
    with_interval = ("R@1", "AP")
    ranking = "R@1"
    shows_unanswered = True

    def is_scored(self, record: SetRecord) -> bool:
        return not record.is_withheld

    def is_of(self, dataset: Dataset | CrossViewSet, record: SetRecord) -> bool:
        return belongs(dataset, record)

    def truth(
        self, folder: SetFolder[SetRecord, RetrieverResults], record: SetRecord, lookup: DatasetLookup
    ) -> RetrievalTruth | None:
        return truth_of(SetResults(folder.root), lookup)

    def read(
        self, folder: RetrieverResults, record: SetRecord, tasks: Mapping[str, TaskRecord], truth: RetrievalTruth | None
    ) -> Retriever:
        run = folder.run_record()
        check_lies_with(run.dataset, run.fingerprint, record, folder.run_yaml)
        for name in tasks:
            if folder.answers(name).exists() and not folder.predictions(name).exists():
                raise PredictionError("missing, although its ranks are there", folder.predictions(name))
        done = {name: of for name, of in tasks.items() if folder.complete(name)}
        if done and not folder.scores_yaml.exists():
            raise PredictionError(f"missing: the answers are not scored; {_AGAIN}", folder.scores_yaml)
        scores = folder.retrieval_scores() if done else None
        if scores is not None:
            _check_digests(folder, done, scores)
        answers = {name: checked_answers(name, of, folder) for name, of in done.items()}
        if scores is not None:
            for name, rows in answers.items():
                _check_summary(folder, name, done[name], rows, scores)
        kept = {} if truth is None else {n: truth.confirmed(folder, n, run.keep, rows) for n, rows in answers.items()}
        return Retriever(folder.label, run, answers, kept, run.method, kept_card(folder.root, run), folder, tasks)

    def renamed(self, method: Retriever, label: str) -> Retriever:
        return replace(method, label=label, run=method.run.model_copy(update={"method": label}))

    def question(self, method: Retriever, task: str) -> Sequence[object]:
        return [(answer.query, answer.positives, answer.group) for answer in method.answers[task]]

    def merged(self, record: SetRecord, other: SetRecord, first: Path, path: Path) -> SetRecord:
        different = [name for name in other.tasks if other.tasks[name] != record.tasks.get(name, other.tasks[name])]
        difference = f"task '{different[0]}' has other queries or another gallery" if different else ""
        if difference := difference or _rule_differs(record, other):
            raise PredictionError(
                f"{difference} than in {first.name}, although both folders are marked as results of the same dataset; "
                "evaluate one of them again",
                path,
            )
        return record.model_copy(update={"tasks": {**other.tasks, **record.tasks}})

    def title(self, record: SetRecord) -> str:
        return f"{record.name}@{record.fingerprint[:SHORT]}"

    def tables(self, tasks: Mapping[str, TaskRecord]) -> dict[str, tuple[str, ...]]:
        return {**{name: (name,) for name in tasks}, **mean_tables(tasks)}

    def values(self, method: Retriever, plan: Plan, metric: str) -> list[Array]:
        values = [resampled(method.per_query(task, metric), method.answers[task]) for task in plan.units]
        if not self.independent(method, plan):
            return values
        return [by_place(values, [sorted({answer.group for answer in method.answers[task]}) for task in plan.units])]

    def alike(self, method: Retriever, plan: Plan) -> list[Array]:
        values = [self.values(method, plan, metric) for metric in METRICS]
        return [np.stack(of_task) for of_task in zip(*values, strict=True)]

    def answers(self, method: Retriever, plan: Plan) -> list[Array]:
        return [np.stack([_places(answer) for answer in method.answers[task]], axis=1) for task in plan.units]

    def runs(self, method: Retriever) -> Sequence[RunRecord]:
        return [method.run]

    def is_ranked(self, method: Retriever) -> bool:
        return not method.is_baseline

    def independent(self, method: Retriever, plan: Plan) -> bool:
        return all(method.records[task].grouped for task in plan.units)  # one value for each place

    def check(self, table: RetrievalTable) -> None:
        check_plausible(table)


RETRIEVAL = RetrievalBoards()


def _places(answer: QueryAnswer) -> tuple[float, float]:
    """The rank of the first right image, and how far all of them are from the first places.

    Infinite where all right images come first: so do those of any good retriever.
    """
    found = len(answer.ranks)
    late = sum(answer.ranks) - found * (found + 1) // 2
    told = found > 0 and (late > 0 or found < answer.positives)
    return (float(answer.ranks[0]), float(late)) if told else (math.inf, math.inf)


def chance_of(table: RetrievalTable) -> dict[str, float]:
    """What a gallery in random order scores, by metric: the mean over the tasks."""
    return {m: float(np.mean([record.chance.get(m, 0.0) for record in table.records])) for m in METRICS}


def has_single_positives(table: RetrievalTable) -> bool:
    """Whether each query has exactly one positive, so that R@1 bounds AP."""
    return all(record.single_positive for record in table.records)


def confirmed_of(row: RetrievalRow, table: RetrievalTable) -> Confirmed | None:
    """What was computed anew of all tasks of a table; None where one was not looked at."""
    known = row.method.confirmed
    if row.missing or not known.keys() >= set(table.tasks):
        return None
    of_tasks = [known[task] for task in table.tasks]
    depths = [each.depth for each in of_tasks if each.depth is not None]
    believed = {metric: float(np.mean([each.believed[metric] for each in of_tasks])) for metric in METRICS}
    return Confirmed(min(depths, default=None), believed)


def rescored_text(row: RetrievalRow, table: RetrievalTable) -> str:
    """``yes``, ``no``, or ``first K`` where ranks behind the first K are those that the results claim."""
    confirmed = confirmed_of(row, table)
    if confirmed is None:
        return "no"
    return "yes" if confirmed.depth is None else f"first {confirmed.depth}"


def mean_tables(tasks: Mapping[str, TaskRecord]) -> dict[str, tuple[str, ...]]:
    """The tables of means: over all tasks, each direction of views, and each pair of conditions.

    A task with part of another one's queries (``drone-satellite__Rain``) counts only among its conditions.
    """
    whole = [name for name in tasks if not is_part(name, tasks)]
    out = {"mean over all tasks": tuple(whole)}
    tables: tuple[tuple[str, Callable[[TaskRecord], str], list[str]], ...] = (
        ("direction", lambda r: r.direction, whole),
        ("conditions", lambda r: r.conditions, list(tasks)),
    )
    for kind, key, names in tables:
        groups: dict[str, list[str]] = {}
        for name in names:
            groups.setdefault(key(tasks[name]), []).append(name)
        if len(groups) > 1:
            out |= {f"{kind} {label}": tuple(of) for label, of in groups.items() if label}
    return {name: of for name, of in out.items() if len(of) > 1}


def check_plausible(table: RetrievalTable) -> None:
    """Raise PredictionError where a row's AP is impossible for its R@1 with one positive for each query."""
    if not has_single_positives(table):
        return
    for row in table.rows:
        recall, ap = row.values["R@1"], row.values["AP"]
        if recall is not None and ap is not None:
            fault = single_positive_fault(f"{100 * recall:.4f}", f"{100 * ap:.4f}")
            if fault:
                raise PredictionError(f"{row.method.label} on {table.name}: {fault}")


def is_part(name: str, tasks: Mapping[str, TaskRecord]) -> bool:
    """Whether a task asks part of another one's queries; names of pair sets, of one view, may begin alike."""
    return name.rpartition("__")[0] in tasks and tasks[name].view_query != tasks[name].view_gallery


def _rule_differs(record: SetRecord, other: SetRecord) -> str:
    """What two records of one question say differently about it, in words; empty if nothing."""
    if (record.positives, record.options) != (other.positives, other.options):
        return "says otherwise which images are right"
    both = record.tasks.keys() & other.tasks.keys()
    for split in sorted(record.splits.keys() | other.splits.keys()):
        if both.intersection(record.splits.get(split, ())) != both.intersection(other.splits.get(split, ())):
            return f"the split '{split}' has other tasks"
    return ""


def _check_digests(folder: RetrieverResults, tasks: Collection[str], scored: RetrieverScores) -> None:
    """Raise PredictionError unless ``scores.yaml`` was computed from the files beside it."""
    if scored.run != sha256_file(folder.run_yaml):
        raise PredictionError(f"is not the record that was scored; {_AGAIN}", folder.run_yaml)
    for task in tasks:
        if task not in scored.answers or task not in scored.lists:
            raise PredictionError(f"holds no scores of '{task}', which was answered; {_AGAIN}", folder.scores_yaml)
        for digests, path in ((scored.answers, folder.answers(task)), (scored.lists, folder.predictions(task))):
            if digests[task] != sha256_file(path):
                raise PredictionError(f"changed since it was scored; {_AGAIN}", path)


def _check_summary(
    folder: RetrieverResults, task: str, record: TaskRecord, answers: Sequence[QueryAnswer], scored: RetrieverScores
) -> None:
    """Raise PredictionError unless the means in ``scores.yaml`` are those of a task's table.

    Metrics that are not recorded are younger than the file: they follow from the table.
    """
    summary = scored.tasks.get(task)
    if summary is None:
        raise PredictionError(f"holds no scores of '{task}', which was answered; {_AGAIN}", folder.scores_yaml)
    scores = scores_of(answers, record)
    for metric in (each for each in METRICS if each in summary):
        mean, claimed = float(np.mean(scores.per_query(metric))), summary[metric]
        if claimed is None or not math.isclose(mean, claimed, rel_tol=1e-9, abs_tol=1e-12):
            raise PredictionError(
                f"{metric} of '{task}' is {claimed}, its table gives {mean}; {_AGAIN}", folder.scores_yaml
            )
