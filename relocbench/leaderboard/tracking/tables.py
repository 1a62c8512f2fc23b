"""Computing ranked tables from the errors of pairs, without I/O.

A pair set is a total over one set, and a group is a set of fewer pairs: one function computes all tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import ConfigError
from relocbench.evaluation.common.error_table import ErrorTable
from relocbench.evaluation.common.matching_table import ALL
from relocbench.evaluation.common.tables import STATUSES
from relocbench.leaderboard.tracking.load import DatasetEntry, Method
from relocbench.leaderboard.tracking.marks import is_ranked
from relocbench.leaderboard.tracking.model import (
    INTERVALS,
    MEDIANS,
    SAME_DRIVE_TOTAL,
    TOTAL,
    Board,
    DatasetBoard,
    Row,
    SeedRow,
    Table,
)
from relocbench.metrics import (
    METRICS,
    DifferentPlaces,
    Interval,
    Metric,
    PairScores,
    PoseErrors,
    Spread,
    generator,
    mean_interval,
    median_interval,
    metric_named,
    paired_difference,
    rank_with_ties,
    spread_over_seeds,
    totals,
)
from relocbench.progress import Reporter, Silent

Array = NDArray[np.float64]
RANKING = "recall@(0.25m,2deg)"
"""The default ranking metric: the share of pairs whose pose is right, in position and in rotation."""


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
    plans = [_plan(entry) for entry in entries]
    boards = []
    with (reporter or Silent()).stage("comparing", sum(map(len, plans))) as advance:
        for entry, plan in zip(entries, plans, strict=True):
            tables = []
            for planned in plan:
                tables.append(_table(entry, planned, ranking, seed))
                advance(1)
            boards.append(DatasetBoard(entry, tuple(tables)))
    return Board(tuple(boards), ranking, seed, split)


@dataclass(frozen=True)
class _Planned:
    """A table that is to be computed."""

    names: tuple[str, ...]
    group: str = ALL
    split: str | None = None
    """None for the table of one pair set"""
    total: str = ""
    """which of the totals, empty for the table of one pair set"""


def _plan(entry: DatasetEntry) -> list[_Planned]:
    """The tables of each used pair set and its groups, and of each split's totals and the groups that all sets share.

    Pair sets of one drive, whose keyframes and queries saw the same light and weather, have totals of their own.
    """
    plan = [_Planned((name,), group) for name in entry.used for group in (ALL, *entry.groups(name))]
    for split, of_split in entry.splits.items():
        same = {name for name in of_split if entry.pair_sets[name].reference == entry.pair_sets[name].query}
        for total, names in (
            (TOTAL, tuple(n for n in of_split if n not in same)),
            (SAME_DRIVE_TOTAL, tuple(n for n in of_split if n in same)),
        ):
            if any(name in entry.used for name in names):
                shared = [g for g in entry.groups(names[0]) if all(g in entry.groups(n) for n in names)]
                plan += [_Planned(names, group, split, total) for group in (ALL, *shared)]
    return plan


def _table(entry: DatasetEntry, planned: _Planned, metric: Metric, seed: int) -> Table:
    names, group, split = planned.names, planned.group, planned.split
    shown = planned.total or names[0]
    place = f"{entry.record.compared_by} {shown} {split or ''} {group}"
    sets = {m.label: [_of_group(m, name, group) for name in names] for m in entry.methods}
    ranks: dict[str, int | None] = dict.fromkeys(sets)
    if group == ALL:
        ranks |= rank_with_ties(
            {
                m.label: [None if rows is None else _per_pair(metric, rows) for rows in sets[m.label]]
                for m in entry.methods
                if is_ranked(m)
            },
            generator(seed, place, metric.name),
            {label: [None if rows is None else _errors(rows) for rows in own] for label, own in sets.items()},
            higher_is_better=metric.higher_is_better,
        )
    identity = sets[entry.identity.label] if entry.identity else None
    rows = [_row(m, sets[m.label], names, ranks[m.label], identity, metric) for m in entry.methods]
    if group == ALL:
        rows = [row if row.missing else replace(row, elsewhere=_elsewhere(row.method, names)) for row in rows]
    asked = _pairs_asked(sets)
    return Table(
        pair_set=shown,
        pair_sets=names,
        split=" ".join(s for s in entry.splits if s and names[0] in entry.splits[s]) if split is None else split,
        group=group,
        pairs=sum(entry.pair_sets[n].pairs for n in names) if group == ALL else sum(map(len, asked)),
        rejected=sum(entry.pair_sets[n].rejected for n in names) if group == ALL else None,
        medians=_medians(asked),
        finer=_finer(entry, names),
        rows=tuple(sorted(rows, key=lambda row: _order(row, metric))),
        seeds=tuple(_seed_rows(rows)),
    )


def _row(
    method: Method,
    sets: Sequence[ErrorTable | None],
    names: Sequence[str],
    rank: int | None,
    identity: Sequence[ErrorTable | None] | None,
    metric: Metric,
) -> Row:
    missing = tuple(name for name, rows in zip(names, sets, strict=True) if rows is None)
    there = [rows for rows in sets if rows is not None]
    values = totals([None if rows is None else rows.summary for rows in sets])
    if len(sets) > 1 and not missing:
        values |= _pooled(there)
    if missing:
        return Row(method, sum(map(len, there)), None, None, None, values, {}, rank, None, missing)
    counts = {status: sum(rows.with_status(status) for rows in there) for status in STATUSES}
    intervals = {m.name: _interval(m, there) for m in METRICS if m.name in {*INTERVALS, *MEDIANS, metric.name}}
    above = None
    if identity is not None and identity is not sets and not any(rows is None for rows in identity):
        above = paired_difference(
            [_sign(metric) * _per_pair(metric, rows) for rows in there],
            [_sign(metric) * _per_pair(metric, rows) for rows in identity if rows is not None],
        )
    return Row(
        method=method,
        pairs=sum(map(len, there)),
        answered=counts["ok"],
        failed=counts["failed"],
        broke=counts["error"],
        values=values,
        intervals=intervals,
        rank=rank,
        above_identity=above,
    )


def _elsewhere(method: Method, names: Sequence[str]) -> DifferentPlaces | None:
    """The pairs of different places of the pair sets together; None where there are none."""
    tables = [method.elsewhere[name] for name in names if name in method.elsewhere]
    return DifferentPlaces.total(table.different_places for table in tables) if tables else None


def _interval(metric: Metric, sets: Sequence[ErrorTable]) -> Interval | None:
    """The interval of a share or area, or of the median of one pair set."""
    if metric.name not in MEDIANS:
        return mean_interval([_per_pair(metric, rows) for rows in sets], [_errors(rows) for rows in sets])
    return median_interval(_errors(sets[0])[MEDIANS.index(metric.name)]) if len(sets) == 1 else None


def _errors(rows: ErrorTable) -> Array:
    """(2, N) the translation and rotation errors: by them, statistics know how alike neighbouring pairs are."""
    return np.stack([rows.errors.translation_error_m, rows.errors.rotation_error_deg])


def _pooled(sets: Sequence[ErrorTable]) -> dict[str, float | None]:
    """Medians, percentiles and what confidences are worth, over the pairs of all sets together.

    A mean of medians would be infinite as soon as a method fails on half of the pairs of one set. In a mean over sets,
    the only answer to one of them would weigh as much as all the answers to another.
    """
    names = ("rotation_error_deg", "translation_error_m", "mlad_translation_error_m")
    errors = PoseErrors(*(np.concatenate([rows.column(name) for rows in sets]) for name in names))
    seconds, confidence = (np.concatenate([rows.column(name) for rows in sets]) for name in ("seconds", "confidence"))
    scores = PairScores(errors, seconds, None if np.isnan(confidence).all() else confidence)
    return {m.name: m.compute(scores) for m in METRICS if m.per_pair is None}


def _of_group(method: Method, pair_set: str, group: str) -> ErrorTable | None:
    rows = method.errors.get(pair_set)
    return None if rows is None else rows.of_group(group)


def _per_pair(metric: Metric, rows: ErrorTable) -> Array:
    if metric.per_pair is None:
        raise ValueError(f"{metric.name} is not a mean over pairs")
    return metric.per_pair(rows.errors)


def _sign(metric: Metric) -> float:
    return 1.0 if metric.higher_is_better else -1.0


def _order(row: Row, metric: Metric) -> tuple[bool, bool, bool, float, str]:
    value, method = row.values[metric.name], row.method
    place = 0.0 if value is None else -_sign(metric) * value
    return method.is_baseline, not is_ranked(method), value is None, place, method.label


def _pairs_asked(sets: Mapping[str, Sequence[ErrorTable | None]]) -> list[ErrorTable]:
    """The rows of each pair set, from any method that has it: all have the same pairs."""
    columns = zip(*sets.values(), strict=True)
    return [rows for column in columns if (rows := next((r for r in column if r is not None), None)) is not None]


def _medians(asked: Sequence[ErrorTable]) -> dict[str, float | None]:
    out: dict[str, float | None] = {}
    for name in ("distance_m", "angle_deg", "sigma_translation_m", "sigma_rotation_deg"):
        values = np.concatenate([np.zeros(0), *(rows.column(name) for rows in asked)])
        known = values[~np.isnan(values)]
        out[name] = float(np.median(known)) if known.size else None
    return out


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
