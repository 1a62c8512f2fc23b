"""The matrix that every board opens with: what share of the pairs each method finds, by condition.

Pages, Markdown, the terminal and the demo's picture show the same rows, columns and numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Mask
from relocbench.leaderboard.common.model import rank_text
from relocbench.leaderboard.tracking.doubt import doubts_of
from relocbench.leaderboard.tracking.marks import DAGGER, is_ranked
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import DatasetBoard
from relocbench.leaderboard.tracking.reservations import finer_thresholds
from relocbench.metrics import CORRECT, within
from relocbench.metrics.pose.metric import finer_than_truth
from relocbench.metrics.pose.tiers import TIERS

UNKNOWN = "unknown"
"""the condition of drives of which none is recorded"""


@dataclass(frozen=True, eq=False)
class Column:
    """The pairs of one dataset whose keyframes are of one condition and whose queries are of one."""

    dataset: DatasetBoard
    pair_sets: tuple[str, ...]
    map_condition: str
    condition: str
    """of the queries"""
    split: str
    """empty where all results of the dataset are of one split"""
    pairs: int
    same_drive: bool
    """whether keyframes and queries are of one drive, and so of one condition"""
    metres: float = CORRECT[0]
    degrees: float = CORRECT[1]
    """the greatest errors of a pair that is found"""
    tier: str = ""
    """the tier whose pairs of all conditions these are; empty for a column of a condition"""

    @property
    def title(self) -> str:
        """The tier or condition, or what stands for it where it is not known: the queries' drives, or all pairs."""
        if self.tier:
            return self.tier
        if self.condition != UNKNOWN:
            return self.condition
        entry = self.dataset.entry
        if set(self.pair_sets) == set(entry.used):
            return "all pairs"
        return ", ".join(dict.fromkeys(entry.pair_sets[name].query for name in self.pair_sets))

    @property
    def is_finer(self) -> bool:
        """Whether a pair must be closer than usual: the dataset's :func:`finer_thresholds`."""
        return (self.metres, self.degrees) != CORRECT

    @property
    def is_finer_than_truth(self) -> bool:
        """Whether the thresholds are finer than the ground truth allows."""
        records = [self.dataset.entry.pair_sets[name] for name in self.pair_sets]
        sigmas = [(record.median_sigma_translation_m, record.median_sigma_rotation_deg) for record in records]
        return any(finer_than_truth(self.metres, self.degrees, *sigma) for sigma in sigmas)

    @property
    def doubt(self) -> str:
        """By how much truth and images of the pair sets whose truth is in doubt are apart, in words; empty if none."""
        return "; ".join(words for _, words in doubts_of(self.dataset.entry.truth_checks, self.pair_sets))


@dataclass(frozen=True, eq=False)
class ConditionRecall:
    """What one method finds of the pairs of one column."""

    share: float | None
    """the mean over the column's pair sets, each counting the same, or over the pairs of a tier; None where the result
    on one set is missing"""
    right: Mask
    """(N,) whether each pair is found, by time of the query and then of the keyframe; empty without a share"""


@dataclass(frozen=True, eq=False)
class Line:
    """One method, from the first column to the last."""

    label: str
    methods: tuple[Method, ...]
    """its results on each dataset that has any"""
    rank: str
    """in the first total of the only dataset, as :func:`rank_text` says it; empty over several datasets"""
    baseline: bool
    """whether it is a trivial baseline"""
    share: float | None
    """the mean over the pair sets across conditions, or over all where there are none; None where one is missing"""
    found: tuple[ConditionRecall, ...]
    """one a column"""


@dataclass(frozen=True, eq=False)
class ByCondition:
    """The methods against the conditions."""

    columns: tuple[Column, ...]
    """by dataset and split; pairs of the same drive first, then in the order of the dataset's splits"""
    lines: tuple[Line, ...]
    """the method that finds most across conditions first, trivial baselines last"""

    @property
    def has_total(self) -> bool:
        """Whether the share of a line is the mean of several columns, and so more than one of them."""
        return sum(not column.is_finer and not column.tier for column in self.columns) > 1

    @property
    def in_total(self) -> tuple[Column, ...]:
        """The columns that the share of a line is the mean of: those across conditions, or all where there are none."""
        return _in_total(self.columns)

    @property
    def across_pairs(self) -> int:
        """The pairs across conditions, of which the share of a line is where there are any."""
        return sum(column.pairs for column in self.in_total if not column.same_drive)

    @property
    def total_title(self) -> str:
        """The head of the column of these shares."""
        return "across conditions" if self.across_pairs else "all"

    def details(self, column: Column) -> list[str]:
        """What tells a column from others beside its title: keyframes, split and thresholds, where they differ."""
        of_dataset = [other for other in self.columns if other.dataset is column.dataset and not other.tier]
        maps = {other.map_condition for other in of_dataset}
        if column.tier:
            return []
        out = ["same drive"] if column.same_drive else []
        if not column.same_drive and len(maps) > 1 and column.map_condition != UNKNOWN:
            out.append(f"map: {column.map_condition}")
        if column.split:
            out.append(f"split {column.split}")
        if any(other.is_finer for other in of_dataset):
            out.append(f"{column.metres:g} m, {column.degrees:g}°{DAGGER if column.is_finer_than_truth else ''}")
        return out

    @property
    def usual(self) -> ByCondition:
        """The columns of conditions alone, without finer thresholds and without tiers."""
        kept = [i for i, column in enumerate(self.columns) if not column.is_finer and not column.tier]
        lines = tuple(replace(line, found=tuple(line.found[i] for i in kept)) for line in self.lines)
        return ByCondition(tuple(self.columns[i] for i in kept), lines)


def by_condition(datasets: Sequence[DatasetBoard]) -> ByCondition:
    """Sort the results on some datasets by the condition of the query.

    Only the results are read, and the totals for ranks: a board without tables has the same columns and no ranks.

    The columns of a dataset that standing still nearly solves occur twice: within the usual thresholds, and beside it
    within the finer ones that fit.
    """
    columns = [column for dataset in datasets for column in _columns(dataset)]
    methods: dict[str, list[Method]] = {}
    for dataset in datasets:
        for method in dataset.entry.methods:
            methods.setdefault(method.label, []).append(method)
    ranks = _ranks(datasets)
    lines = [_line(label, own, ranks.get(label, ""), columns) for label, own in methods.items()]
    return ByCondition(tuple(columns), tuple(sorted(lines, key=_place)))


def _columns(dataset: DatasetBoard) -> list[Column]:
    entry = dataset.entry
    split_of = {name: split for split, names in entry.splits.items() for name in names}
    splits = [split for split in (*entry.splits, "") if any(split_of.get(name, "") == split for name in entry.used)]
    names_of: dict[tuple[int, bool, str, str], list[str]] = {}
    for name in entry.used:
        record, split = entry.pair_sets[name], splits.index(split_of.get(name, ""))
        across = record.reference != record.query
        key = split, across, record.reference_condition, record.query_condition
        names_of.setdefault(key, []).append(name)
    finer = finer_thresholds(entry)
    columns = []
    for (split, across, map_condition, condition), own in sorted(names_of.items(), key=lambda item: item[0][:2]):
        shown = splits[split] if len(splits) > 1 else ""
        pairs = sum(entry.pair_sets[name].pairs for name in own)
        column = Column(dataset, tuple(own), map_condition, condition, shown, pairs, not across)
        columns.append(column)
        if finer is not None:
            columns.append(replace(column, metres=finer.metres, degrees=finer.degrees))
    return [*columns, *_tier_columns(dataset, columns)]


def _tier_columns(dataset: DatasetBoard, columns: Sequence[Column]) -> Iterator[Column]:
    """The pairs of the total by tier, where they are of several."""
    together = _in_total(columns)
    names = tuple(name for column in together for name in column.pair_sets)
    tables = [table for name in names if (table := dataset.entry.errors_of(name)) is not None]
    known = np.concatenate([table.scores.tiers for table in tables]) if len(tables) == len(names) else np.zeros(0)
    counts = {tier: int(np.count_nonzero(known == index)) for index, tier in enumerate(TIERS)}
    if sum(count > 0 for count in counts.values()) > 1:
        for tier, count in counts.items():
            if count:
                same_drive = all(column.same_drive for column in together)
                yield Column(dataset, names, UNKNOWN, UNKNOWN, "", count, same_drive, tier=tier)


def _ranks(datasets: Sequence[DatasetBoard]) -> dict[str, str]:
    """The ranks in the first total, which is that across conditions where there is one."""
    if len(datasets) != 1 or not datasets[0].totals:
        return {}
    first = datasets[0].totals[0]
    return {row.method.label: rank_text(row, first.rows) for row in first.rows}


def _line(label: str, methods: Sequence[Method], rank: str, columns: Sequence[Column]) -> Line:
    found = tuple(_found(label, column) for column in columns)
    together = _in_total(columns)
    counted = [(column, own) for column, own in zip(columns, found, strict=True) if column in together]
    sets = sum(len(column.pair_sets) for column in together)
    shares = [None if own.share is None else own.share * len(column.pair_sets) for column, own in counted]
    known = [share for share in shares if share is not None]
    share = sum(known) / sets if known and len(known) == len(shares) else None
    return Line(label, tuple(methods), rank, any(method.is_baseline for method in methods), share, found)


def _in_total(columns: Sequence[Column]) -> tuple[Column, ...]:
    usual = [column for column in columns if not column.is_finer and not column.tier]
    return tuple([column for column in usual if not column.same_drive] or usual)


def _place(line: Line) -> tuple[bool, bool, int, float, float, str]:
    known = [own.share for own in line.found if own.share is not None]
    missing = len(line.found) - len(known)
    return line.baseline, not all(map(is_ranked, line.methods)), missing, -(line.share or 0.0), -sum(known), line.label


def _found(label: str, column: Column) -> ConditionRecall:
    method = next((m for m in column.dataset.entry.methods if m.label == label), None)
    tables = [] if method is None else [method.errors.get(name) for name in column.pair_sets]
    known = [table for table in tables if table is not None]
    if not known or len(known) < len(column.pair_sets):
        return ConditionRecall(None, np.zeros(0, dtype=np.bool_))
    rights = [within(table.errors, column.metres, column.degrees) for table in known]
    if column.tier:
        tier = TIERS.index(column.tier)
        of_tier = [right[table.scores.tiers == tier] for right, table in zip(rights, known, strict=True)]
        together = np.concatenate(of_tier)
        if len(together) != column.pairs:  # errors that an earlier version computed, of which no tier is known
            return ConditionRecall(None, np.zeros(0, dtype=np.bool_))
        return ConditionRecall(float(np.mean(together)), together)
    keys = np.concatenate([table.keys for table in known])
    order = np.lexsort((keys[:, 0], keys[:, 1]))
    return ConditionRecall(float(np.mean([right.mean() for right in rights])), np.concatenate(rights)[order])
