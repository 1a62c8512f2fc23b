"""Computing ranked tables from the errors of pairs, without I/O.

A pair set is a total over one set, and a group is a set of fewer pairs: one function computes all tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from relocbench.errors import ConfigError
from relocbench.evaluation.tables.errors import ErrorTable
from relocbench.evaluation.tables.schema import ALL
from relocbench.leaderboard.common.loading import Plan, compared
from relocbench.leaderboard.common.over_datasets import OverDatasets, Part, over_datasets
from relocbench.leaderboard.tracking.load import Trackers
from relocbench.leaderboard.tracking.marks import total_words
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import (
    RANKING,
    SAME_DRIVE_TOTAL,
    TOTAL,
    TOTALS,
    Board,
    DatasetBoard,
    DatasetEntry,
    Row,
    SeedRow,
    Table,
)
from relocbench.leaderboard.tracking.rows import tables_of
from relocbench.metrics import METRICS, Metric, Spread, metric_named, spread_over_seeds
from relocbench.progress import Reporter, Silent


def ranking_metric(name: str) -> Metric:
    """The metric of that name. Raises ConfigError unless it is a mean over pairs, as ranks require."""
    metric = metric_named(name)
    if metric.per_pair is None:
        able = ", ".join(m.name for m in METRICS if m.per_pair is not None)
        raise ConfigError(
            f"methods cannot be ranked by '{name}', which is not a mean over pairs; expected one of {able}"
        )
    return metric


def make_board(
    entries: Sequence[DatasetEntry],
    *,
    metric: str = RANKING,
    seed: int = 0,
    split: str | None = None,
    reporter: Reporter | None = None,
) -> Board:
    """Compute all tables.

    Args:
        entries: what :func:`relocbench.leaderboard.tracking.load.load_results` returned.
        metric: the metric that ranks methods, a mean over pairs.
        seed: of the draws that decide ranks. Each table has a generator of its own and depends on nothing else.
        split: the split that ``entries`` were limited to, to be recorded.
        reporter: receives the number of tables that are done.

    Raises:
        ConfigError: an unknown metric, or one that is not a mean over pairs.
    """
    ranking = ranking_metric(metric)
    plans = [_plans(entry) for entry in entries]
    boards = []
    with (reporter or Silent()).stage("comparing", sum(map(len, plans))) as advance:
        for entry, plan in zip(entries, plans, strict=True):
            tables = []
            for planned in plan:
                tables.append(_table(entry, planned, ranking, seed))
                advance(1)
            boards.append(DatasetBoard(entry, tuple(tables)))
    return Board(tuple(boards), ranking, seed, split, tuple(_over_datasets(boards, ranking, seed)))


def _over_datasets(boards: Sequence[DatasetBoard], metric: Metric, seed: int) -> Iterator[OverDatasets[Method]]:
    """The totals over all datasets, split by split where all have the same splits."""
    for kind in TOTALS:
        totals = [[table for table in board.totals if table.pair_set == kind] for board in boards]
        of_kind = [(board, tables) for board, tables in zip(boards, totals, strict=True) if tables]
        splits = {tuple(table.split for table in tables) for _, tables in of_kind}
        for split in next(iter(splits)) if len(splits) == 1 else [None] if splits else []:
            chosen = [(board, [t for t in tables if split in (None, t.split)]) for board, tables in of_kind]
            name = total_words(chosen[0][1][0] if split is not None else replace(chosen[0][1][0], split=""))
            parts = [_part(board, tables) for board, tables in chosen]
            over = over_datasets(Trackers(metric.name), name, parts, metric.name, "pairs", seed=seed)
            if over is not None:
                yield over


def _part(board: DatasetBoard, tables: Sequence[Table]) -> Part[Method]:
    entry, first = board.entry, tables[0]
    units = tuple(dict.fromkeys(name for table in tables for name in table.pair_sets))
    count = sum(entry.pair_sets[name].pairs for name in units)
    return Part(entry.record.name, entry.title, entry.methods, Plan(first.pair_set, units), count)


def _plans(entry: DatasetEntry) -> list[Plan]:
    """The tables of each used pair set and its groups, and of each split's totals and the groups that all sets share.

    Pair sets of one drive, whose keyframes and queries saw the same light and weather, have totals of their own.
    """
    plans = []
    for name in entry.used:
        split = " ".join(s for s in entry.splits if s and name in entry.splits[s])
        plans += [Plan(name, (name,), group, split, f"{name}  {group}") for group in (ALL, *entry.groups(name))]
    for split, of_split in entry.splits.items():
        same = {name for name in of_split if entry.pair_sets[name].reference == entry.pair_sets[name].query}
        for total, names in (
            (TOTAL, tuple(n for n in of_split if n not in same)),
            (SAME_DRIVE_TOTAL, tuple(n for n in of_split if n in same)),
        ):
            if any(name in entry.used for name in names):
                shared = [g for g in entry.groups(names[0]) if all(g in entry.groups(n) for n in names)]
                plans += [Plan(total, names, group, split, f"{total} {split} {group}") for group in (ALL, *shared)]
    return plans


def _table(entry: DatasetEntry, plan: Plan, metric: Metric, seed: int) -> Table:
    trackers = Trackers(metric.name, entry.identity)
    rows = compared(trackers, entry.methods, plan, metric.name, seed=seed, question=entry.record.compared_by)
    asked = _pairs_asked(entry, plan)
    records, whole = [entry.pair_sets[name] for name in plan.units], plan.group == ALL
    return Table(
        pair_set=plan.name,
        pair_sets=plan.units,
        split=plan.split,
        group=plan.group,
        pairs=sum(record.pairs for record in records) if whole else sum(map(len, asked)),
        rejected=sum(record.rejected for record in records) if whole else None,
        medians=_medians(asked),
        over=_over(asked),
        finer=_finer(entry, plan.units),
        rows=tuple(rows),
        seeds=tuple(_seed_rows(rows)),
    )


def _pairs_asked(entry: DatasetEntry, plan: Plan) -> list[ErrorTable]:
    """The rows of each pair set, from any method that has it: all have the same pairs."""
    columns = zip(*(tables_of(method, plan) for method in entry.methods), strict=True)
    return [rows for column in columns if (rows := next((r for r in column if r is not None), None)) is not None]


def _medians(asked: Sequence[ErrorTable]) -> dict[str, float | None]:
    out: dict[str, float | None] = {}
    for name in ("distance_m", "angle_deg", "sigma_translation_m", "sigma_rotation_deg"):
        values = np.concatenate([np.zeros(0), *(rows.column(name) for rows in asked)])
        known = values[~np.isnan(values)]
        out[name] = float(np.median(known)) if known.size else None
    return out


def _over(asked: Sequence[ErrorTable]) -> dict[str, int]:
    """The number of pairs of metrics that are over some of them."""
    return {m.name: sum(m.over(rows.scores) for rows in asked) for m in METRICS if m.over is not None}


def _finer(entry: DatasetEntry, names: Sequence[str]) -> frozenset[str]:
    """The metrics with a threshold finer than the ground truth of any of the pair sets allows."""
    records = [entry.pair_sets[name] for name in names]
    return frozenset(
        m.name
        for m in METRICS
        for r in records
        if m.threshold_finer_than(r.median_sigma_translation_m, r.median_sigma_rotation_deg)
    )


def _seed_rows(rows: Sequence[Row]) -> list[SeedRow]:
    """Rows for runs of one target and version whose parameters differ by the seed alone."""
    alike: dict[str, dict[int, Row]] = {}
    for row in rows:
        run, seed = row.method.run, row.method.seed
        if seed is not None:
            same = repr((run.target, sorted(row.method.settings.items()), run.versions.get("method")))
            alike.setdefault(same, {}).setdefault(seed, row)
    out = []
    for runs in alike.values():
        if len(runs) > 1:
            seeds = tuple(sorted(runs))
            chosen = [runs[seed] for seed in seeds]
            spread = {m.name: _spread([row.values[m.name] for row in chosen]) for m in METRICS}
            out.append(SeedRow(chosen[0].method.run.target, tuple(r.method.label for r in chosen), seeds, spread))
    return out


def _spread(values: Sequence[float | None]) -> Spread | None:
    known = [value for value in values if value is not None]
    return spread_over_seeds(known) if len(known) == len(values) else None
