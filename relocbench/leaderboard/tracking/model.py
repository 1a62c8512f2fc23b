"""What a leaderboard shows: a board of datasets, their tables, and a row for each method."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.common.dataset_lookup import Truth
from relocbench.evaluation.common.results import DatasetRecord, PairSetRecord
from relocbench.evaluation.tables.errors import ErrorTable
from relocbench.evaluation.tables.schema import ALL
from relocbench.leaderboard.common import model as common
from relocbench.leaderboard.common.loading import Loaded
from relocbench.leaderboard.tracking.method import Method, natural
from relocbench.metrics import METRICS, Difference, DifferentPlaces, Metric, Spread

if TYPE_CHECKING:
    from relocbench.leaderboard.common.over_datasets import OverDatasets
    from relocbench.leaderboard.tracking.doubt import TruthCheck

RANKING = "recall@(0.25m,2deg)"
"""the default ranking metric: the share of pairs whose pose is right, in position and in rotation"""
TOTAL = "total"
"""the total over pair sets of two drives"""
SAME_DRIVE_TOTAL = "total_same_drive"
"""the total over pair sets whose keyframes and queries are of one drive"""
TOTALS = (TOTAL, SAME_DRIVE_TOTAL)
MEDIANS = ("median_translation_error_m", "median_rotation_error_deg")
"""the medians that tables of one pair set show with an interval"""


@dataclass(frozen=True, eq=False)
class DatasetEntry(Loaded[DatasetRecord, PairSetRecord, Method, Truth]):
    """One dataset with all results on it."""

    splits: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """split -> pair sets of its total; one split called '' with all pair sets where the dataset has none"""
    withheld: tuple[str, ...] = ()
    """chosen pair sets that cannot be scored: the ground truth is withheld or no pair was accepted"""
    truth_checks: Mapping[str, TruthCheck] = field(default_factory=dict)
    """by pair set whose truth was compared with its images"""

    @property
    def pair_sets(self) -> Mapping[str, PairSetRecord]:
        """The pair sets that are compared: chosen, with ground truth, and with at least one pair."""
        return self.units

    @property
    def dataset(self) -> Dataset | None:
        """The dataset itself, or a copy of it, where it is available."""
        return None if self.truth is None else self.truth.dataset

    @property
    def title(self) -> str:
        """The name and short fingerprint, as in the name of the results folder."""
        return f"{self.record.name}@{self.record.fingerprint[:SHORT]}"

    @cached_property
    def identity(self) -> Method | None:
        """The identity pose, if it was run."""
        return next((m for m in self.methods if m.is_identity), None)

    @cached_property
    def clock(self) -> Method | None:
        """The timestamp-only baseline, if it was run."""
        return next((m for m in self.methods if m.is_clock), None)

    @cached_property
    def used(self) -> tuple[str, ...]:
        """The pair sets on which at least one method was run, completely or not."""
        return tuple(n for n in self.pair_sets if any(n in m.errors or n in m.stopped for m in self.methods))

    def errors_of(self, pair_set: str) -> ErrorTable | None:
        """The errors of the first method that has a result on a pair set: all have the same pairs."""
        return next((m.errors[pair_set] for m in self.methods if pair_set in m.errors), None)

    def groups(self, pair_set: str) -> list[str]:
        """The named groups of a pair set in natural order; none where all pairs are in one group."""
        return sorted(self.pair_sets[pair_set].groups, key=natural) if len(self.pair_sets[pair_set].groups) > 1 else []


@dataclass(frozen=True, eq=False)
class Row(common.Row[Method]):
    """The row of one method in a table."""

    pairs: int = 0
    answered: int | None = None
    above_identity: Difference | None = None
    """difference of the ranking metric to the identity pose on the same pairs; positive is better"""
    elsewhere: DifferentPlaces | None = None
    """what became of the pairs of different places; None where there are none, in tables of groups, and where a pair
    set is missing"""


@dataclass(frozen=True, eq=False)
class SeedRow:
    """The row of several runs of one method that differ by their seed alone."""

    target: str
    labels: tuple[str, ...]
    seeds: tuple[int, ...]
    spread: Mapping[str, Spread | None]
    """by metric; None where a run has no value"""

    @property
    def title(self) -> str:
        return f"{self.target}, {len(self.seeds)} seeds"


@dataclass(frozen=True, eq=False)
class Table:
    """A row for each method: on a pair set, on one group of it, or in total."""

    pair_set: str
    """name, or one of :data:`TOTALS` over ``pair_sets``"""
    pair_sets: tuple[str, ...]
    split: str
    group: str
    """``all`` for all pairs"""
    pairs: int
    rejected: int | None
    """number of pairs whose ground truth was rejected; known only of whole pair sets"""
    medians: Mapping[str, float | None]
    """distance_m and angle_deg of the pairs, sigma_translation_m and sigma_rotation_deg of the ground truth"""
    over: Mapping[str, int]
    """number of pairs of metrics that are over some of the pairs"""
    finer: frozenset[str]
    """metrics with a threshold finer than the ground truth allows"""
    rows: tuple[Row, ...]
    """best first, then methods without a value, those that use times, and the trivial baselines"""
    seeds: tuple[SeedRow, ...]

    @property
    def is_total(self) -> bool:
        """Whether the table is a total, be it over a single pair set."""
        return self.pair_set in TOTALS


@dataclass(frozen=True, eq=False)
class DatasetBoard:
    """All tables of one dataset."""

    entry: DatasetEntry
    tables: tuple[Table, ...]
    """each pair set followed by its groups, then each split's totals followed by the groups that all sets share"""

    @property
    def pair_sets(self) -> list[Table]:
        """The tables of pair sets, over all their pairs."""
        return [t for t in self.tables if not t.is_total and t.group == ALL]

    @property
    def totals(self) -> list[Table]:
        """The tables of the splits' totals, over all pairs."""
        return [t for t in self.tables if t.is_total and t.group == ALL]

    def groups_of(self, table: Table) -> list[Table]:
        """The tables of the groups of a pair set or total."""
        place = (table.pair_set, table.split)
        return [t for t in self.tables if t.group != ALL and (t.pair_set, t.split) == place]


def short_title(dataset: DatasetBoard, datasets: Iterable[DatasetBoard]) -> str:
    """The name of a dataset; with its fingerprint where another one of ``datasets`` has the same name."""
    name = dataset.entry.record.name
    alone = sum(other.entry.record.name == name for other in datasets) == 1
    return name if alone else dataset.entry.title


@dataclass(frozen=True, eq=False)
class Board:
    """Everything that a leaderboard of trackers shows."""

    datasets: tuple[DatasetBoard, ...]
    metric: Metric
    """the metric that ranks methods"""
    seed: int
    split: str | None = None
    over: tuple[OverDatasets[Method], ...] = ()
    """the totals over all datasets together"""

    @property
    def methods(self) -> list[Method]:
        """The methods of all datasets, one after the other."""
        return [method for dataset in self.datasets for method in dataset.entry.methods]

    @property
    def with_interval(self) -> tuple[Metric, ...]:
        """The metrics that are shown with an interval, in the registry's order."""
        return tuple(m for m in METRICS if m.with_interval or m == self.metric)
