"""Reading the results of one task in a results folder and comparing its methods: one way for every task.

A task says what its records, methods, truth and metrics are; which folders are read, how copies of one set are merged,
what is refused, and how tables, means, intervals and ranks come about is the same for all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import AnswerFolder, folders_with
from relocbench.evaluation.common.set_folder import SetFolder, SetLike, TaskLike, sets_in
from relocbench.leaderboard.common.copies import distinct_label
from relocbench.leaderboard.common.headings import SECONDS
from relocbench.leaderboard.common.model import Board, Method, Row, SetBoard, Table
from relocbench.leaderboard.common.untrusted_results import check_file_names, check_folder, check_same_queries
from relocbench.metrics import generator, mean_interval, rank_with_ties
from relocbench.progress import Reporter

F = TypeVar("F", bound=AnswerFolder)
S = TypeVar("S", bound=SetLike)
U = TypeVar("U", bound=TaskLike)
M = TypeVar("M", bound=Method)
T = TypeVar("T")


class BoardTask(ABC, Generic[F, S, U, M, T]):
    """A task as boards see it. F: the folder of a method, S: the record of a set, U: that of a task of it, M: what is
    read of a method, T: the truth of a set."""

    what: str
    """its methods, in the plural"""
    kind: type[SetFolder[S, F]]
    """of the folders of its sets"""
    metrics: tuple[str, ...]
    """the metrics that are means over queries, in the order in which tables show them"""
    with_interval: tuple[str, ...]
    """those that have an interval besides the one that ranks"""
    ranking: str
    """the metric that ranks unless another is asked for"""
    shows_unanswered: bool = False
    """whether a set is shown of which no method has answered a task; one without any method is then a fault"""

    # Reading

    @abstractmethod
    def units(self, record: S) -> Mapping[str, U]:
        """The records of a set's tasks."""

    def is_scored(self, record: S) -> bool:
        """Whether answers to a set can be scored here."""
        return True

    @abstractmethod
    def is_of(self, dataset: Dataset | CrossViewSet, record: S) -> bool:
        """Whether results are of a dataset or of a copy of it."""

    @abstractmethod
    def truth(self, folder: SetFolder[S, F], lookup: DatasetLookup) -> T | None:
        """The truth of a set; None where its dataset is not available."""

    @abstractmethod
    def read(self, folder: F, record: S, tasks: Mapping[str, U], truth: T | None) -> M:
        """The results of one method. Raises PredictionError unless they are whole, scored and follow from files."""

    @abstractmethod
    def renamed(self, method: M, label: str) -> M:
        """The method under another label."""

    @abstractmethod
    def question(self, method: M, task: str) -> Sequence[object]:
        """What all methods must agree on in their answers to a task, such as the names of queries."""

    def merged(self, record: S, other: S, first: Path, path: Path) -> S:
        """The record of two copies of one set. Raises PredictionError where they say otherwise of it."""
        return record

    @abstractmethod
    def title(self, record: S) -> str: ...

    # Comparing

    @abstractmethod
    def tables(self, tasks: Mapping[str, U]) -> dict[str, tuple[str, ...]]:
        """The names of all tables and the tasks of each, in their order."""

    @abstractmethod
    def values(self, method: M, tasks: Mapping[str, U], metric: str) -> list[Array]:
        """The values of a metric: an array for each task, or one for each place over all of them."""

    @abstractmethod
    def alike(self, method: M, tasks: Mapping[str, U], values: Mapping[str, list[Array]]) -> list[Array]:
        """(K, N) for each of these arrays: by them, statistics know how alike neighbouring queries are."""

    def further(self, method: M, tasks: Mapping[str, U], means: Mapping[str, float]) -> Mapping[str, float | None]:
        """What a row has besides the means of the metrics."""
        return {}

    def is_ranked(self, method: M) -> bool:
        """Whether a method takes part in ranks."""
        return True

    def higher_is_better(self, metric: str) -> bool:
        return True

    def independent(self, tasks: Mapping[str, U]) -> bool:
        """Whether the values are known to be independent."""
        return False

    def check(self, table: Table[M, U]) -> None:
        """Raise PredictionError for a table whose numbers cannot be."""
        return


def load_board(
    task: BoardTask[F, S, U, M, T],
    results: Path,
    *,
    metric: str | None = None,
    split: str | None = None,
    seed: int = 0,
    datasets: DatasetLookup | None = None,
) -> Board[S, U, M, T] | None:
    """Read and compare all methods of a task in a results folder; None where there is nothing of theirs to show.

    Args:
        metric: the metric that ranks methods, one of the task's.
        split: only the tasks of this split; sets without such a split are left out.
        seed: of the draws that decide ranks. Each table has a generator of its own and depends on nothing else.
        datasets: with their truth; without them, those in folders beside ``RESULTS``. Where the dataset of a set is
            among them, answers are scored anew.

    Raises:
        PredictionError: with file and line: a bad file, scores that are missing or stale, or answers that do not follow
            from the files beside them and the truth.
        ConfigError: a metric that the task does not have, or a split that no set has.
        DatasetError: a dataset that was named is damaged.
    """
    metric = metric or task.ranking
    if metric not in task.metrics:
        expected = f"expected one of {', '.join(task.metrics)}"
        raise ConfigError(f"{task.what} cannot be ranked by '{metric}'; {expected}")
    folders = [folder for folder in sets_in(results, task.kind) if task.is_scored(folder.record)]
    if not folders:
        return None
    check_folder(results)
    lookup = datasets or DatasetLookup(results)
    for folder in folders:
        record = folder.record
        check_file_names(record.tasks, "the task", folder.record_file)
        lookup.mark_used(lambda dataset, record=record: task.is_of(dataset, record))  # type: ignore[misc]
    chosen = [folder for folder in folders if split is None or split in folder.record.splits]
    if not chosen and not folders_with("dataset.yaml", results):  # else the split is one of the trackers' datasets
        known = sorted({name for folder in folders for name in folder.record.splits})
        raise ConfigError(f"no split '{split}'{available(str(split), known)}", results)
    copies: dict[tuple[str, str], list[SetFolder[S, F]]] = {}
    for folder in chosen:
        copies.setdefault((folder.record.name, folder.record.compared_by), []).append(folder)
    sets = [_set(task, of_one, metric, split, seed, lookup) for of_one in copies.values()]
    shown = tuple(one for one in sets if one.tables or task.shows_unanswered)
    return Board(shown, metric, seed, split) if shown else None


def note_missing(board: Board[S, U, M, T], reporter: Reporter) -> None:
    """Tell which methods have no result on a task."""
    for asked in board.sets:
        for method in asked.methods:
            for name in (name for name in asked.used if name not in method.answers):
                reporter.note(f"{asked.title}: {method.label} has no result on {name}")


def _set(
    task: BoardTask[F, S, U, M, T],
    copies: Sequence[SetFolder[S, F]],
    metric: str,
    split: str | None,
    seed: int,
    lookup: DatasetLookup,
) -> SetBoard[S, U, M, T]:
    """The board of all copies of a set, of which the first is shown; repeated labels are made distinct."""
    first, *others = copies
    record = first.record
    for other in others:
        record = task.merged(record, other.record, first.root, other.record_file)
    units = task.units(record)
    tasks = {name: units[name] for name in units if split is None or name in record.splits[split]}
    methods: dict[str, M] = {}
    folder_of: dict[str, F] = {}
    truth: T | None = None
    for copy in copies:
        of_copy = task.truth(copy, lookup)
        truth = truth or of_copy
        for folder in copy.methods():
            label = distinct_label(folder.label, methods, copy.record.fingerprint)
            methods[label] = task.renamed(task.read(folder, copy.record, tasks, of_copy), label)
            folder_of[label] = folder
    if not methods and task.shows_unanswered:
        raise PredictionError("holds no method's answers; expected results of the evaluate commands", first.root)
    in_order = [methods[label] for label in sorted(methods)]
    check_same_queries(
        (
            (name, method.label, task.question(method, name), folder_of[method.label].answers(name))
            for method in in_order
            for name in method.answers
        ),
        "queries, or other facts of them,",
    )
    used = {name: one for name, one in tasks.items() if any(name in method.answers for method in in_order)}
    plans = {name: {each: used[each] for each in of} for name, of in task.tables(used).items()}
    return SetBoard(
        record,
        task.title(record),
        tuple(in_order),
        tuple(_checked(task, record, name, of, in_order, metric, seed) for name, of in plans.items()),
        tuple(name for name in tasks if name not in used),
        tuple(other.record.fingerprint for other in others),
        truth,
    )


def _checked(
    task: BoardTask[F, S, U, M, T],
    record: S,
    name: str,
    tasks: Mapping[str, U],
    methods: Sequence[M],
    metric: str,
    seed: int,
) -> Table[M, U]:
    table = _table(task, name, tasks, methods, metric, generator(seed, f"{record.compared_by} {name}", metric))
    task.check(table)
    return table


def _table(
    task: BoardTask[F, S, U, M, T],
    name: str,
    tasks: Mapping[str, U],
    methods: Sequence[M],
    metric: str,
    rng: np.random.Generator,
) -> Table[M, U]:
    """A table over some tasks, each of which counts the same."""
    whole = [method for method in methods if tasks.keys() <= method.answers.keys()]
    values = {m.label: {each: task.values(m, tasks, each) for each in task.metrics} for m in whole}
    alike = {m.label: task.alike(m, tasks, values[m.label]) for m in whole}
    better, independent = task.higher_is_better(metric), task.independent(tasks)
    ranked = {m.label: values[m.label][metric] for m in whole if task.is_ranked(m)}
    ranks = rank_with_ties(ranked, rng, alike, higher_is_better=better, independent=independent)
    rows: list[Row[M]] = []
    for method in methods:
        if method.label not in values:
            missing = tuple(each for each in tasks if each not in method.answers)
            rows.append(Row(method, dict.fromkeys(task.metrics), {}, None, missing=missing))
            continue
        own = values[method.label]
        means = {each: float(np.mean([np.mean(array) for array in arrays])) for each, arrays in own.items()}
        answers = [answer for each in tasks for answer in method.answers[each]]
        shown = dict.fromkeys((*task.with_interval, metric))
        rows.append(
            Row(
                method,
                {**means, **task.further(method, tasks, means), SECONDS: _median(a.seconds for a in answers)},
                {each: mean_interval(own[each], alike[method.label], independent=independent) for each in shown},
                ranks.get(method.label),
                sum(answer.status == "failed" for answer in answers),
                sum(answer.status == "error" for answer in answers),
            )
        )
    sign = -1.0 if better else 1.0
    rows.sort(key=lambda row: (row.values[metric] is None, sign * (row.values[metric] or 0.0), row.method.label))
    return Table(name, tuple(tasks), tuple(tasks.values()), tuple(rows))


def _median(seconds: Iterable[float | None]) -> float | None:
    known = [value for value in seconds if value is not None]
    return float(np.median(known)) if known else None
