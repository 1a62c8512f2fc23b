"""Comparing retrievers: their scores on each task, by views and by conditions, and with shared ranks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import folders_with
from relocbench.evaluation.retrieval.answers import QueryAnswer
from relocbench.evaluation.retrieval.records import (
    METRICS,
    SET_FILE,
    RetrievalRun,
    RetrieverResults,
    RetrieverScores,
    SetRecord,
    SetResults,
    TaskRecord,
    all_sets,
)
from relocbench.evaluation.retrieval.rescoring import Confirmed, RetrievalTruth, belongs, truth_of
from relocbench.evaluation.retrieval.score import checked_answers, resampled, scores_of
from relocbench.evaluation.submission.kept import KeptCard, kept_card
from relocbench.files import sha256_file
from relocbench.leaderboard.common.copies import distinct_label
from relocbench.leaderboard.common.untrusted_results import check_file_names, check_folder, check_same_queries
from relocbench.metrics import Interval, by_place, generator, mean_interval, rank_with_ties, single_positive_fault

Array = NDArray[np.float64]
RANKING = "R@1"
WITH_INTERVAL = ("R@1", "AP")
_AGAIN = "run `relocbench evaluate-retrieval` again to score"


@dataclass(frozen=True, eq=False)
class Retriever:
    """The results of one method on one set."""

    label: str
    run: RetrievalRun
    answers: Mapping[str, Sequence[QueryAnswer]]
    """by task; tasks without results are absent"""
    confirmed: Mapping[str, Confirmed] = field(default_factory=dict)
    """how far the ranks follow from the images that were kept, by task; empty where the truth is not available"""
    ran_as: str = ""
    """the label in the run's record, which the name of the folder replaces"""
    card: KeptCard | None = None
    """of lists that were submitted"""
    folder: RetrieverResults | None = None
    """where its lists are kept"""

    @property
    def renamed(self) -> bool:
        """Whether the folder is not named as its run."""
        return self.ran_as not in ("", self.label, self.label.rpartition("@")[0])

    def per_query(self, task: str, record: TaskRecord, metric: str) -> Array:
        """(Q,) the values of a metric on a task."""
        return scores_of(self.answers[task], record).per_query(metric)


@dataclass(frozen=True, eq=False)
class RetrievalRow:
    """A row for one method; it has no values if the method misses a task."""

    method: Retriever
    values: Mapping[str, float | None]
    intervals: Mapping[str, Interval | None]
    rank: int | None
    failed: int | None = None
    broke: int | None = None
    seconds: float | None = None
    """median over the queries"""
    missing: tuple[str, ...] = ()
    confirmed: Confirmed | None = None
    """how far the values were computed anew, over all tasks; None: not at all"""

    @property
    def rescored(self) -> str:
        """``yes``, ``no``, or ``first K`` where ranks behind the first K are those that the results claim."""
        if self.confirmed is None:
            return "no"
        return "yes" if self.confirmed.depth is None else f"first {self.confirmed.depth}"


@dataclass(frozen=True, eq=False)
class RetrievalTable:
    """A row for each method, on one task or for the mean over several tasks."""

    name: str
    tasks: tuple[str, ...]
    records: tuple[TaskRecord, ...]
    rows: tuple[RetrievalRow, ...]
    """best first; methods without a value come last"""
    chance: Mapping[str, float]

    @property
    def queries(self) -> int:
        return sum(r.queries for r in self.records)

    @property
    def without_positives(self) -> int:
        return sum(r.without_positives for r in self.records)

    @property
    def single_positive(self) -> bool:
        """Whether each query has exactly one positive, so that R@1 bounds AP."""
        return all(r.single_positive for r in self.records)


@dataclass(frozen=True, eq=False)
class SetBoard:
    """All tables of one retrieval set."""

    record: SetRecord
    methods: tuple[Retriever, ...]
    tables: tuple[RetrievalTable, ...]
    unused: tuple[str, ...] = ()
    """tasks that no method has answered"""
    copies: tuple[str, ...] = ()
    """fingerprints of other copies of the same question, from other processors, that methods answered on"""
    truth: RetrievalTruth | None = None
    """the tasks with their images; None where no copy of the dataset is available"""

    @property
    def title(self) -> str:
        return f"{self.record.name}@{self.record.fingerprint[:12]}"


@dataclass(frozen=True, eq=False)
class RetrievalBoard:
    """Everything that a leaderboard of retrievers shows."""

    sets: tuple[SetBoard, ...]
    metric: str
    seed: int
    split: str | None = None
    shown: tuple[str, ...] = field(default=METRICS)


def load_retrieval(
    results: Path,
    *,
    metric: str = RANKING,
    split: str | None = None,
    seed: int = 0,
    datasets: DatasetLookup | None = None,
) -> RetrievalBoard | None:
    """Load the results of all retrievers in a results folder; None where there is nothing of theirs to show.

    Args:
        metric: the metric that ranks methods.
        split: only the tasks of this split; sets without such a split are left out.
        seed: of the draws that decide ranks. Each table has a generator of its own and depends on nothing else.
        datasets: with their truth; without them, those in folders beside ``RESULTS``. Where the dataset of a set is
            among them, ranks are computed anew from the images that were kept of each query.

    Raises:
        PredictionError: with file and line: a bad file, scores that are missing or stale, or ranks that do not follow
            from the retrieved images and the truth.
        ConfigError: an unknown metric, or a split that no set has.
        DatasetError: a dataset that was named is damaged.
    """
    if metric not in METRICS:
        raise ConfigError(f"retrievers cannot be ranked by '{metric}'; expected one of {', '.join(METRICS)}")
    scored = [folder for folder in all_sets(results) if not folder.record.is_withheld]
    if not scored:
        return None
    check_folder(results)
    for folder in scored:
        check_file_names(folder.record.tasks, "the task", folder.root / SET_FILE)
    lookup = datasets or DatasetLookup(results)
    for folder in scored:
        lookup.mark_used(partial(belongs, record=folder.record))
    chosen = scored if split is None else [s for s in scored if split in s.record.splits]
    if not chosen and holds_tracking(results):
        return None  # the split is one of the trackers' datasets
    if not chosen:
        known = sorted({name for s in scored for name in s.record.splits})
        raise ConfigError(f"no split '{split}'{available(str(split), known)}", results)
    sets = tuple(_set(copies, metric, split, seed, lookup) for copies in _group_copies(chosen))
    return RetrievalBoard(sets, metric, seed, split)


def holds_tracking(results: Path) -> bool:
    """Whether the folder holds results of trackers."""
    return bool(folders_with("dataset.yaml", results))


def mean_tables(tasks: Mapping[str, TaskRecord]) -> dict[str, tuple[str, ...]]:
    """The tables of means: over all tasks, each direction of views, and each pair of conditions.

    A task with part of another one's queries (``drone-satellite__Rain``) counts only among its conditions.
    """
    whole = [name for name in tasks if not _is_part(name, tasks)]
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
    if not table.single_positive:
        return
    for row in table.rows:
        recall, ap = row.values["R@1"], row.values["AP"]
        if recall is not None and ap is not None:
            fault = single_positive_fault(f"{100 * recall:.4f}", f"{100 * ap:.4f}")
            if fault:
                raise PredictionError(f"{row.method.label} on {table.name}: {fault}")


def _is_part(name: str, tasks: Mapping[str, TaskRecord]) -> bool:
    whole = name.rpartition("__")[0]
    return whole in tasks


def _group_copies(folders: Sequence[SetResults]) -> list[list[SetResults]]:
    """Group the folders of one question: the same recipe, with images that differ in last digits."""
    by_set: dict[tuple[str, str], list[SetResults]] = {}
    for folder in folders:
        by_set.setdefault((folder.record.name, folder.record.compared_by), []).append(folder)
    return list(by_set.values())


def _set(copies: Sequence[SetResults], metric: str, split: str | None, seed: int, lookup: DatasetLookup) -> SetBoard:
    """The board of all copies of a question, of which the first is shown; repeated labels are made distinct."""
    record, *others = (folder.record for folder in copies)
    for folder, other in zip(copies[1:], others, strict=True):
        different = [n for n in other.tasks if other.tasks[n] != record.tasks.get(n, other.tasks[n])]
        told = (
            f"task '{different[0]}' has other queries or another gallery" if different else _rule_differs(record, other)
        )
        if told:
            raise PredictionError(
                f"{told} than in {copies[0].root.name}, although both folders are marked as results of the same "
                "dataset; evaluate one of them again",
                folder.root / SET_FILE,
            )
        record = record.model_copy(update={"tasks": {**other.tasks, **record.tasks}})
    names = [n for n in record.tasks if split is None or n in record.splits[split]]
    tasks = {name: record.tasks[name] for name in names}
    methods, path_of, truth = _methods_of(copies, tasks, lookup)
    if not methods:
        raise PredictionError(
            "holds no retriever's answers; expected results of `relocbench evaluate-retrieval`", copies[0].root
        )
    tables_of_tasks = (
        (task, m.label, [(a.query, a.positives, a.group) for a in answers], path_of[m.label].answers(task))
        for m in methods
        for task, answers in m.answers.items()
    )
    check_same_queries(tables_of_tasks, "queries, positives or groups")
    used = {n: r for n, r in tasks.items() if any(n in m.answers for m in methods)}
    plans = {**{name: (name,) for name in used}, **mean_tables(used)}
    tables = []
    for name, of in plans.items():
        tables.append(_table(record, name, of, methods, metric, seed))
        check_plausible(tables[-1])
    unused = tuple(n for n in tasks if n not in used)
    return SetBoard(record, methods, tuple(tables), unused, tuple(other.fingerprint for other in others), truth)


def _rule_differs(record: SetRecord, other: SetRecord) -> str:
    """What two records of one question say differently about it, in words; empty if nothing."""
    if (record.positives, record.options) != (other.positives, other.options):
        return "says otherwise which images are right"
    both = record.tasks.keys() & other.tasks.keys()
    for split in sorted(record.splits.keys() | other.splits.keys()):
        if both.intersection(record.splits.get(split, ())) != both.intersection(other.splits.get(split, ())):
            return f"the split '{split}' has other tasks"
    return ""


def _methods_of(
    copies: Sequence[SetResults], tasks: Mapping[str, TaskRecord], lookup: DatasetLookup
) -> tuple[tuple[Retriever, ...], dict[str, RetrieverResults], RetrievalTruth | None]:
    """The methods by label, the folder of each, and the tasks of the first copy that is available."""
    by_label: dict[str, Retriever] = {}
    folders: dict[str, RetrieverResults] = {}
    first: RetrievalTruth | None = None
    for copy in copies:
        truth = truth_of(copy, lookup)
        first = first or truth
        for folder in copy.methods():
            method = load_retriever(folder, copy.record, tasks, truth)
            label = distinct_label(method.label, by_label, copy.record.fingerprint)
            method = replace(method, label=label, run=method.run.model_copy(update={"method": label}))
            by_label[method.label], folders[method.label] = method, folder
    return tuple(by_label[label] for label in sorted(by_label)), folders, first


def load_retriever(
    folder: RetrieverResults, asked: SetRecord, tasks: Mapping[str, TaskRecord], truth: RetrievalTruth | None
) -> Retriever:
    """Read the results of one retriever. Raises PredictionError unless they are whole, scored and follow from files."""
    run = folder.run_record()
    if run.fingerprint != asked.fingerprint:
        raise PredictionError(
            f"was made for {run.dataset}@{run.fingerprint[:12]}, but lies among the results of "
            f"{asked.name}@{asked.fingerprint[:12]}",
            folder.run_yaml,
        )
    for name in tasks:
        if folder.answers(name).exists() and not folder.predictions(name).exists():
            raise PredictionError("missing, although its ranks are there", folder.predictions(name))
    done = {name: record for name, record in tasks.items() if folder.complete(name)}
    if done and not folder.scores_yaml.exists():
        raise PredictionError(f"missing: the answers are not scored; {_AGAIN}", folder.scores_yaml)
    scores = folder.retrieval_scores() if done else None
    if scores is not None:
        _check_digests(folder, done, scores)
    answers = {name: checked_answers(name, record, folder) for name, record in done.items()}
    if scores is not None:
        for name, rows in answers.items():
            _check_summary(folder, name, done[name], rows, scores)
    confirmed = {} if truth is None else {n: truth.confirmed(folder, n, run.keep, rows) for n, rows in answers.items()}
    card = kept_card(folder.root, run)
    named = run.model_copy(update={"method": folder.label})
    return Retriever(folder.label, named, answers, confirmed, run.method, card, folder)


def _check_digests(folder: RetrieverResults, tasks: Collection[str], scored: RetrieverScores) -> None:
    """Raise PredictionError unless ``scores.yaml`` was computed from the files beside it."""
    if not scored.run:
        told = "does not say what it was computed from, as earlier versions did not"
        raise PredictionError(f"{told}; {_AGAIN}", folder.scores_yaml)
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
    """Raise PredictionError unless ``scores.yaml`` has the means of a task's table."""
    summary = scored.tasks.get(task, {})
    scores = scores_of(answers, record)
    for metric in METRICS:
        mean, claimed = float(np.mean(scores.per_query(metric))), summary.get(metric)
        if claimed is None or not math.isclose(mean, claimed, rel_tol=1e-9, abs_tol=1e-12):
            raise PredictionError(
                f"{metric} of '{task}' is {claimed}, its table gives {mean}; {_AGAIN}", folder.scores_yaml
            )


def _confirmed(method: Retriever, tasks: Sequence[str]) -> Confirmed | None:
    """What was confirmed of all tasks; None where one was not looked at."""
    if not all(task in method.confirmed for task in tasks):
        return None
    of_tasks = [method.confirmed[task] for task in tasks]
    depths = [each.depth for each in of_tasks if each.depth is not None]
    believed = {metric: float(np.mean([each.believed[metric] for each in of_tasks])) for metric in METRICS}
    return Confirmed(min(depths, default=None), believed)


def _table(
    record: SetRecord, name: str, tasks: tuple[str, ...], methods: Sequence[Retriever], metric: str, seed: int
) -> RetrievalTable:
    records = tuple(record.tasks[task] for task in tasks)
    place = f"{record.compared_by} {name}"
    independent = all(r.grouped for r in records)  # one value for each place

    def drawn(method: Retriever, metric: str) -> list[Array | None]:
        """The values of each task, or of each place over all tasks."""
        if not set(tasks) <= method.answers.keys():
            return [None]
        values = [
            resampled(method.per_query(t, r, metric), method.answers[t]) for t, r in zip(tasks, records, strict=True)
        ]
        if not independent:
            return [*values]
        return [by_place(values, [sorted({a.group for a in method.answers[t]}) for t in tasks])]

    def drawn_all(method: Retriever) -> list[Array | None]:
        columns = zip(*(drawn(method, m) for m in METRICS), strict=True)
        return [None if any(v is None for v in of_task) else np.stack(of_task) for of_task in columns]

    ranks = rank_with_ties(
        {m.label: drawn(m, metric) for m in methods},
        generator(seed, place, metric),
        {m.label: drawn_all(m) for m in methods},
        independent=independent,
    )
    rows = []
    for method in methods:
        missing = tuple(task for task in tasks if task not in method.answers)
        if missing:
            rows.append(RetrievalRow(method, dict.fromkeys(METRICS), {}, None, missing=missing))
            continue
        sets = {m: [v for v in drawn(method, m) if v is not None] for m in METRICS}
        errors = [np.stack(of_task) for of_task in zip(*sets.values(), strict=True)]
        given = [a for task in tasks for a in method.answers[task]]
        seconds = [a.seconds for a in given if a.seconds is not None]
        rows.append(
            RetrievalRow(
                method,
                {m: float(np.mean([np.mean(v) for v in sets[m]])) for m in METRICS},
                {m: mean_interval(sets[m], errors, independent=independent) for m in {*WITH_INTERVAL, metric}},
                ranks[method.label],
                sum(a.status == "failed" for a in given),
                sum(a.status == "error" for a in given),
                float(np.median(seconds)) if seconds else None,
                confirmed=_confirmed(method, tasks),
            )
        )
    chance = {m: float(np.mean([r.chance.get(m, 0.0) for r in records])) for m in METRICS}
    return RetrievalTable(name, tasks, records, tuple(sorted(rows, key=lambda row: _order(row, metric))), chance)


def _order(row: RetrievalRow, metric: str) -> tuple[bool, float, str]:
    value = row.values[metric]
    return value is None, -(value or 0.0), row.method.label
