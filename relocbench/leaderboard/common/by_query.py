"""Boards of the tasks that are asked by queries, those of retrievers and of pipelines: sets, tables and rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import AnswerFolder, SetLike, folders_with
from relocbench.evaluation.tables.schema import Schema
from relocbench.leaderboard.common.loading import BoardTask, Loaded, Plan, Standing, compared, load_sets
from relocbench.leaderboard.common.model import Method, Row
from relocbench.leaderboard.common.over_datasets import OverDatasets, Part, over_datasets
from relocbench.leaderboard.common.text import SECONDS
from relocbench.progress import Reporter


class Answer(Protocol):
    """What became of one query."""

    @property
    def status(self) -> str: ...

    @property
    def seconds(self) -> float | None: ...


class ByQuery(Method, Protocol):
    """The results of one method on one set of tasks."""

    @property
    def answers(self) -> Mapping[str, Sequence[Answer]]: ...


class TaskLike(Protocol):
    """What is known of a task whether its images are available or not."""

    @property
    def queries(self) -> int: ...


class QuerySet(SetLike, Protocol):
    """A set of tasks."""

    @property
    def tasks(self) -> Mapping[str, Any]: ...


F = TypeVar("F", bound=AnswerFolder)
S = TypeVar("S", bound=QuerySet)
U = TypeVar("U", bound=TaskLike)
M = TypeVar("M", bound=ByQuery)
T = TypeVar("T")
U_co = TypeVar("U_co", bound=TaskLike, covariant=True)
M_co = TypeVar("M_co", bound=ByQuery, covariant=True)


@dataclass(frozen=True, eq=False)
class Table(Generic[M_co, U_co]):
    """A row for each method, on one task or for the mean over several tasks."""

    name: str
    tasks: tuple[str, ...]
    records: tuple[U_co, ...]
    """of the tasks"""
    rows: tuple[Row[M_co], ...]
    """best first; methods without a value come last"""

    @property
    def queries(self) -> int:
        return sum(record.queries for record in self.records)


@dataclass(frozen=True, eq=False)
class SetBoard(Loaded[S, U, M, T]):
    """All tables of one set of tasks."""

    title: str = ""
    tables: tuple[Table[M, U], ...] = ()

    @property
    def unused(self) -> list[str]:
        """The tasks that no method has answered."""
        return [name for name in self.units if name not in self.used]

    @property
    def means_first(self) -> list[Table[M, U]]:
        """The tables, those of means over several tasks before those of single ones."""
        return sorted(self.tables, key=lambda table: len(table.tasks) == 1)

    @property
    def missing(self) -> list[tuple[str, tuple[str, ...]]]:
        """The methods that miss a task of the first of these tables, each with what it misses."""
        return [(row.method.label, row.missing) for table in self.means_first[:1] for row in table.rows if row.missing]


@dataclass(frozen=True, eq=False)
class Board(Generic[S, U, M, T]):
    """Everything that a leaderboard of one task shows."""

    sets: tuple[SetBoard[S, U, M, T], ...]
    metric: str
    """the metric that ranks methods"""
    seed: int
    split: str | None = None
    over: tuple[OverDatasets[M], ...] = ()
    """the table over all sets together"""


class QueryTask(BoardTask[F, S, U, M, T, Row[M]]):
    """A task that is asked by queries."""

    schema: Schema[Any]
    """of the answers of a method to a task"""
    shows_unanswered: bool = False
    """whether a set is shown of which no method has answered a task; one without any method is then a fault"""

    def units(self, record: S, split: str | None = None) -> Mapping[str, U]:
        return {name: of for name, of in record.tasks.items() if split is None or name in record.splits[split]}

    @abstractmethod
    def title(self, record: S) -> str: ...

    @abstractmethod
    def tables(self, tasks: Mapping[str, U]) -> dict[str, tuple[str, ...]]:
        """The names of all tables and the tasks of each, in their order."""

    def further(self, method: M, plan: Plan, means: Mapping[str, float]) -> Mapping[str, float | None]:
        """What a row has besides the means of the metrics."""
        return {}

    def check(self, table: Table[M, U]) -> None:
        """Raise PredictionError for a table whose numbers cannot be."""
        return

    def row(self, method: M, plan: Plan, standing: Standing) -> Row[M]:
        if standing.missing:
            return Row(method, dict.fromkeys(self.rankable), {}, None, missing=standing.missing)
        means = {
            metric: float(np.mean([np.mean(of) for of in self.values(method, plan, metric)]))
            for metric in self.rankable
        }
        answers = [answer for task in plan.units for answer in method.answers[task]]
        return Row(
            method,
            {**means, **self.further(method, plan, means), SECONDS: _median(answer.seconds for answer in answers)},
            standing.intervals,
            standing.rank,
            sum(answer.status == "failed" for answer in answers),
            sum(answer.status == "error" for answer in answers),
            family=standing.family,
        )


def load_board(
    task: QueryTask[F, S, U, M, T],
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
    if metric not in task.rankable:
        expected = f"expected one of {', '.join(task.rankable)}"
        raise ConfigError(f"{task.what} cannot be ranked by '{metric}'; {expected}")
    if not folders_with(task.kind.FILE, results):
        return None
    sets = []
    for loaded in load_sets(task, results, split, datasets or DatasetLookup(results)):
        if not loaded.methods and task.shows_unanswered:
            raise PredictionError("holds no method's answers; expected results of the evaluate commands", results)
        tables = tuple(
            _table(task, loaded, Plan(name, units), metric, seed)
            for name, units in task.tables({each: loaded.units[each] for each in loaded.used}).items()
        )
        if tables or task.shows_unanswered:
            sets.append(SetBoard(**loaded.parts, title=task.title(loaded.record), tables=tables))
    return Board(tuple(sets), metric, seed, split, _over_sets(task, sets, metric, seed)) if sets else None


def _over_sets(
    task: QueryTask[F, S, U, M, T], sets: Sequence[SetBoard[S, U, M, T]], metric: str, seed: int
) -> tuple[OverDatasets[M], ...]:
    """The table over all sets, of each of which all tasks."""
    first = [(of, of.means_first[0]) for of in sets if of.tables]
    parts = [
        Part(of.record.name, of.title, of.methods, Plan(table.name, table.tasks), table.queries) for of, table in first
    ]
    over = over_datasets(task, "all tasks", parts, metric, "queries", seed=seed)
    return () if over is None else (over,)


def note_missing(board: Board[Any, Any, Any, Any], reporter: Reporter) -> None:
    """Tell which methods have no result on a task."""
    for asked in board.sets:
        for method in asked.methods:
            for name in (name for name in asked.used if name not in method.answers):
                reporter.note(f"{asked.title}: {method.label} has no result on {name}")


def _table(
    task: QueryTask[F, S, U, M, T], loaded: Loaded[S, U, M, T], plan: Plan, metric: str, seed: int
) -> Table[M, U]:
    rows = compared(task, loaded.methods, plan, metric, seed=seed, question=loaded.record.compared_by)
    table = Table(plan.name, plan.units, tuple(loaded.units[name] for name in plan.units), tuple(rows))
    task.check(table)
    return table


def _median(seconds: Iterable[float | None]) -> float | None:
    known = [value for value in seconds if value is not None]
    return float(np.median(known)) if known else None
