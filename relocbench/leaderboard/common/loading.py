"""Reading the results of one task in a results folder and comparing its methods: one way for every task.

A task says what its records, methods, truth and metrics are; which folders are read, how copies of one set are merged,
what is refused, and how ranks, intervals and the order of rows come about is the same for all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import AnswerFolder, SetFolder, SetLike, folders_with, sets_in
from relocbench.evaluation.common.results import RunRecord
from relocbench.evaluation.tables.schema import ALL
from relocbench.leaderboard.common.cards import distinct_label
from relocbench.leaderboard.common.model import Method, Row
from relocbench.leaderboard.common.near_copies import came, nearly_same_settings
from relocbench.leaderboard.common.untrusted_results import check_file_names, check_folder, check_same_questions
from relocbench.metrics import Interval, families_of, generator, mean_interval, rank_with_ties, same_answers

F = TypeVar("F", bound=AnswerFolder)
S = TypeVar("S", bound=SetLike)
U = TypeVar("U")
M = TypeVar("M", bound=Method)
T = TypeVar("T")
R = TypeVar("R", bound=Row[Any])
TRACKERS_FILE = "dataset.yaml"


@dataclass(frozen=True)
class Plan:
    """A table that is to be computed."""

    name: str
    units: tuple[str, ...]
    """the tasks or pair sets that it is over, each of which counts the same"""
    group: str = ALL
    """only what is of this group of them"""
    split: str = ""
    place: str = ""
    """what, with the set, decides its draws; empty: the name"""


@dataclass(frozen=True, eq=False)
class Standing:
    """Where a method stands in a table."""

    rank: int | None
    """None for a method that is not ranked, or misses a unit"""
    intervals: Mapping[str, Interval | None]
    missing: tuple[str, ...]
    """units without results"""
    family: tuple[str, ...] = ()
    """the labels of its near-copies and its own, the one that represents them first; empty where there are none"""


@dataclass(frozen=True, eq=False)
class Loaded(Generic[S, U, M, T]):
    """All results on one set, with those on its copies."""

    record: S
    methods: tuple[M, ...]
    """sorted by label"""
    units: Mapping[str, U]
    """those that are compared, in the order of tables"""
    copies: tuple[str, ...] = ()
    """fingerprints of other copies of the same question, from other processors, that methods answered on"""
    truth: T | None = None
    """of the first copy that is available"""

    @property
    def parts(self) -> dict[str, Any]:
        """The fields by name, to make more of them."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def used(self) -> tuple[str, ...]:
        """The units on which some method has a result."""
        return tuple(name for name in self.units if any(name in method.answers for method in self.methods))


class BoardTask(ABC, Generic[F, S, U, M, T, R]):
    """A task as boards see it.

    F is the folder of a method, S the record of a set, U that of a unit of it (a task of queries or a pair set), M what
    is read of a method, T the truth of a set, and R a row of a table.
    """

    what: str
    """its methods, in the plural"""
    kind: type[SetFolder[S, F]]
    """of the folders of its sets"""
    rankable: tuple[str, ...]
    """the metrics that can rank: means over what is asked"""
    ranking: str
    """the metric that ranks unless another is asked for"""
    with_interval: tuple[str, ...]
    """the metrics that have an interval besides the one that ranks"""

    # Reading

    @abstractmethod
    def units(self, record: S, split: str | None = None) -> Mapping[str, U]:
        """The records of the units of a set, or of a split of it, that can be compared."""

    def is_scored(self, record: S) -> bool:
        """Whether answers to a set can be scored here."""
        return True

    @abstractmethod
    def is_of(self, dataset: Dataset | CrossViewSet, record: S) -> bool:
        """Whether results are of a dataset or of a copy of it."""

    @abstractmethod
    def truth(self, folder: SetFolder[S, F], record: S, lookup: DatasetLookup) -> T | None:
        """The truth of a set; None where its dataset is not available."""

    @abstractmethod
    def read(self, folder: F, record: S, units: Mapping[str, U], truth: T | None) -> M:
        """The results of one method. Raises PredictionError unless they are whole, scored and follow from files."""

    @abstractmethod
    def renamed(self, method: M, label: str) -> M:
        """The method under another label."""

    @abstractmethod
    def question(self, method: M, unit: str) -> object:
        """What all methods must agree on in their answers to a unit, such as the names of queries."""

    def table_of(self, folder: F, unit: str) -> Path:
        """The file that tells it."""
        return folder.answers(unit)

    def merged(self, record: S, other: S, first: Path, path: Path) -> S:
        """The record of two copies of one set. Raises PredictionError where they say otherwise of it."""
        return record

    # Comparing

    @abstractmethod
    def values(self, method: M, plan: Plan, metric: str) -> list[Array]:
        """The values of a metric: an array for each unit, or one for each place over all of them."""

    @abstractmethod
    def alike(self, method: M, plan: Plan) -> list[Array]:
        """(K, N) for each of these arrays: by them, statistics know how alike neighbouring values are."""

    def answers(self, method: M, plan: Plan) -> list[Array]:
        """(K, N) for each array: two methods whose values are close to each other give the same answer; inf for none.

        :func:`relocbench.metrics.same_answers` finds near-copies by them.
        """
        return self.alike(method, plan)

    @abstractmethod
    def runs(self, method: M) -> Sequence[RunRecord]:
        """How the method was run; both halves of a pipeline."""

    @abstractmethod
    def row(self, method: M, plan: Plan, standing: Standing) -> R:
        """The row of a method, which has no values where it misses a unit."""

    def is_ranked(self, method: M) -> bool:
        """Whether a method takes part in ranks."""
        return True

    def stands_last(self, method: M) -> tuple[bool, ...]:
        """What puts a method behind all others, whatever its value."""
        return ()

    def higher_is_better(self, metric: str) -> bool:
        return True

    def independent(self, method: M, plan: Plan) -> bool:
        """Whether the values are known to be independent."""
        return False


def load_sets(
    task: BoardTask[F, S, U, M, T, R], results: Path, split: str | None, lookup: DatasetLookup
) -> list[Loaded[S, U, M, T]]:
    """Read all methods of a task in a results folder; a set is merged with its copies.

    Raises:
        PredictionError: with file and line: a bad file, scores that are missing or stale, or answers that do not follow
            from the files beside them and the truth.
        ConfigError: a split that no set has.
        DatasetError: a dataset that was named is damaged.
    """
    check_folder(results)
    scored = [(of, record) for of in sets_in(results, task.kind) if task.is_scored(record := of.record)]
    seen: dict[tuple[str, str], SetFolder[S, F]] = {}
    for folder, record in scored:
        check_file_names([record.name, record.fingerprint], "the name or fingerprint", folder.record_file)
        check_file_names(record.names, f"the {task.kind.UNIT}", folder.record_file)
        other = seen.setdefault((record.name, record.fingerprint), folder)
        if other is not folder:
            raise PredictionError(f"is the same set as {other.root.name}; expected one folder of each", folder.root)
        lookup.mark_used(lambda dataset, record=record: task.is_of(dataset, record))  # type: ignore[misc]
    copies: dict[tuple[str, str], list[tuple[SetFolder[S, F], S]]] = {}
    for folder, record in scored:
        if split is None or split in record.splits:
            copies.setdefault((record.name, record.compared_by), []).append((folder, record))
    if scored and not copies and not _may_be_of_trackers(task, results):
        known = sorted({name for _, record in scored for name in record.splits})
        raise ConfigError(f"no split '{split}'{available(str(split), known)}", results)
    return [_merged(task, of_one, split, lookup) for of_one in copies.values()]


def _may_be_of_trackers(task: BoardTask[F, S, U, M, T, R], results: Path) -> bool:
    """Whether a split that no set has may be one of the datasets of trackers beside them."""
    return task.kind.FILE != TRACKERS_FILE and bool(folders_with(TRACKERS_FILE, results))


def _merged(
    task: BoardTask[F, S, U, M, T, R],
    copies: Sequence[tuple[SetFolder[S, F], S]],
    split: str | None,
    lookup: DatasetLookup,
) -> Loaded[S, U, M, T]:
    """The results on all copies of a set, of which the first is shown; repeated labels are made distinct."""
    (first, record), *others = copies
    for other, of_other in others:
        record = task.merged(record, of_other, first.root, other.record_file)
    units = task.units(record, split)
    methods: dict[str, M] = {}
    folder_of: dict[str, F] = {}
    truth: T | None = None
    for copy, of_copy in copies:
        own = task.truth(copy, of_copy, lookup)
        truth = truth or own
        folders = copy.methods()
        check_file_names((folder.label for folder in folders), "the method", copy.root)
        for folder in folders:
            label = distinct_label(folder.label, methods, of_copy.fingerprint)
            methods[label] = task.renamed(task.read(folder, of_copy, task.units(of_copy, split), own), label)
            folder_of[label] = folder
    in_order = tuple(methods[label] for label in sorted(methods))
    check_same_questions(
        (name, method.label, task.question(method, name), task.table_of(folder_of[method.label], name))
        for method in in_order
        for name in method.answers
    )
    return Loaded(record, in_order, units, tuple(of_other.fingerprint for _, of_other in others), truth)


def compared(
    task: BoardTask[F, S, U, M, T, R],
    methods: Sequence[M],
    plan: Plan,
    metric: str,
    *,
    seed: int,
    question: str,
) -> list[R]:
    """The rows of a table, best first.

    Args:
        metric: the metric that ranks; only tables over all groups have ranks.
        question: the set. With the plan, the metric and the seed it decides the draws: a table depends on no other.
    """
    whole = {m.label: [(m, plan)] for m in methods if set(plan.units) <= m.answers.keys()}
    rng = generator(seed, f"{question} {plan.place or plan.name}", metric)
    known = standings(task, whole, metric, rng, [""], ranked=plan.group == ALL)
    rows = []
    for method in methods:
        missing = tuple(name for name in plan.units if name not in method.answers)
        rows.append(task.row(method, plan, known.get(method.label) or Standing(None, {}, missing)))
    return best_first(task, rows, metric, lambda row: task.stands_last(row.method))


def standings(
    task: BoardTask[F, S, U, M, T, R],
    whole: Mapping[str, Sequence[tuple[M, Plan]]],
    metric: str,
    rng: np.random.Generator,
    roads: Sequence[str],
    *,
    ranked: bool = True,
) -> dict[str, Standing]:
    """Where methods without missing results stand, by label.

    Args:
        whole: by label, the method in each part of the table, with what it is asked there.
        roads: of each part, such as the names of datasets; parts of one road count as one together.
    """
    shown = dict.fromkeys((*task.with_interval, metric))
    values = {
        label: {each: [x for method, plan in parts for x in task.values(method, plan, each)] for each in shown}
        for label, parts in whole.items()
    }
    alike = {label: [x for method, plan in parts for x in task.alike(method, plan)] for label, parts in whole.items()}
    first = next(iter(whole.values()), ())
    of_arrays = [road for road, part in zip(roads, first, strict=False) for _ in task.values(*part, metric)]
    independent = bool(first) and all(task.independent(*part) for part in first)
    runs = {label: [task.runs(method) for method, _ in parts] for label, parts in whole.items()}
    competing = [
        label
        for label in sorted(whole, key=lambda label: came(runs[label], label))
        if ranked and all(task.is_ranked(method) for method, _ in whole[label])
    ]
    answers = {label: [x for part in whole[label] for x in task.answers(*part)] for label in competing}
    sign = 1.0 if task.higher_is_better(metric) else -1.0
    families = families_of(
        {label: [sign * x for x in values[label][metric]] for label in competing},
        lambda a, b: all(map(nearly_same_settings, runs[a], runs[b])) or same_answers(answers[a], answers[b]),
    )
    ranks = rank_with_ties(
        {label: values[label][metric] for label in competing},
        rng,
        alike,
        families=families,
        higher_is_better=task.higher_is_better(metric),
        roads=of_arrays,
        independent=independent,
    )
    out = {}
    for label, own in values.items():
        bounds = {
            each: mean_interval(x, alike[label], roads=of_arrays, independent=independent) for each, x in own.items()
        }
        family = tuple(other for other in competing if families[other] == families.get(label))
        out[label] = Standing(ranks.get(label), bounds, (), family if len(family) > 1 else ())
    return out


def best_first(
    task: BoardTask[F, S, U, M, T, Any], rows: Iterable[R], metric: str, last: Callable[[R], tuple[bool, ...]]
) -> list[R]:
    """Rows in the order in which tables show them.

    Args:
        last: what puts a row behind all others, whatever its value.
    """
    sign = -1.0 if task.higher_is_better(metric) else 1.0

    def place(row: R) -> tuple[tuple[bool, ...], bool, float, int, str]:
        value = row.values[metric]
        return last(row), value is None, sign * (value or 0.0), row.rank or 0, row.method.label

    return sorted(rows, key=place)
