"""A board of any task that is asked by queries: sets of tasks, tables over some of them, a row for each method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from relocbench.evaluation.common.set_folder import TaskLike
from relocbench.metrics import Interval


class Answer(Protocol):
    """What became of one query."""

    @property
    def status(self) -> str: ...

    @property
    def seconds(self) -> float | None: ...


class Method(Protocol):
    """The results of one method on one set."""

    @property
    def label(self) -> str: ...

    @property
    def answers(self) -> Mapping[str, Sequence[Answer]]:
        """By task; tasks without results are absent."""
        ...


M_co = TypeVar("M_co", bound=Method, covariant=True)
U_co = TypeVar("U_co", bound=TaskLike, covariant=True)
S_co = TypeVar("S_co", covariant=True)
T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True, eq=False)
class Row(Generic[M_co]):
    """A row for one method; it has no values if the method misses a task."""

    method: M_co
    values: Mapping[str, float | None]
    """means over the tasks of means over queries; medians are over all queries together"""
    intervals: Mapping[str, Interval | None]
    rank: int | None
    """None if a task is missing, and for a method that is not ranked"""
    failed: int | None = None
    broke: int | None = None
    missing: tuple[str, ...] = ()


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
class SetBoard(Generic[S_co, U_co, M_co, T_co]):
    """All tables of one set of tasks."""

    record: S_co
    title: str
    methods: tuple[M_co, ...]
    """sorted by label"""
    tables: tuple[Table[M_co, U_co], ...]
    unused: tuple[str, ...] = ()
    """tasks that no method has answered"""
    copies: tuple[str, ...] = ()
    """fingerprints of other copies of the same question, from other processors, that methods answered on"""
    truth: T_co | None = None
    """the tasks with their images and truth; None where no copy of the dataset is available"""

    @property
    def used(self) -> list[str]:
        """The tasks that some method has answered, in the order of the tables."""
        return list(dict.fromkeys(task for table in self.tables for task in table.tasks))


@dataclass(frozen=True, eq=False)
class Board(Generic[S_co, U_co, M_co, T_co]):
    """Everything that a leaderboard of one task shows."""

    sets: tuple[SetBoard[S_co, U_co, M_co, T_co], ...]
    metric: str
    """the metric that ranks methods"""
    seed: int
    split: str | None = None
