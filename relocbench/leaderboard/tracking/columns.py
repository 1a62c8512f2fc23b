"""The columns of trackers' tables."""

from __future__ import annotations

from typing import Any

from relocbench.files import json_text
from relocbench.leaderboard.common.columns import (
    Column,
    Line,
    bounds_columns,
    by_key,
    counts_column,
    family_column,
    number_column,
    rank_column,
)
from relocbench.leaderboard.common.text import ELSEWHERE, METHOD, RESCORED, SECONDS_AND_P95, Value, number
from relocbench.leaderboard.tracking.marks import made_elsewhere
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import METRICS, Difference, DifferentPlaces, Metric

TrackingLine = Line[DatasetBoard, Table, Row]
TrackingColumn = Column[TrackingLine]


def lines_of(dataset: DatasetBoard, table: Table) -> list[TrackingLine]:
    """A line for each method."""
    return [Line(dataset, table, row) for row in table.rows]


def place_columns() -> list[TrackingColumn]:
    """What a table is of."""
    return [
        Column("dataset", lambda line: line.set.entry.record.name),
        Column("fingerprint", lambda line: line.set.entry.record.fingerprint),
        Column("question", lambda line: line.set.entry.record.question),
        Column("pair_set", lambda line: line.table.pair_set),
        Column("split", lambda line: line.table.split),
        Column("group", lambda line: line.table.group),
        Column("reference_condition", lambda line: _of_single(line, "reference_condition")),
        Column("query_condition", lambda line: _of_single(line, "query_condition")),
    ]


def tracking_columns(board: Board) -> dict[str, TrackingColumn]:
    """All columns by their keys; those of CSV first, in its order."""
    place = place_columns()
    return by_key(
        [
            *(_of_run("fingerprint", "fingerprint") if of.key == "fingerprint" else of for of in place),
            Column(METHOD, lambda line: line.of_row(lambda row: row.method.label)),
            rank_column(),
            family_column(),
            Column("ranked_by", lambda line: board.metric.name),
            Column("pairs", lambda line: line.table.pairs),
            Column("rejected", lambda line: line.table.rejected),
            Column("answered", lambda line: line.of_row(lambda row: row.answered)),
            Column("failed", lambda line: line.of_row(lambda row: row.failed)),
            Column("broke", lambda line: line.of_row(lambda row: row.broke)),
            counts_column(),
            Column("missing", lambda line: line.of_row(lambda row: " ".join(row.missing))),
            Column(RESCORED, lambda line: line.of_row(lambda row: _yes(row.method.rescored))),
            Column("isolated", lambda line: line.of_row(_isolated)),
            Column("uses_times", lambda line: line.of_row(lambda row: _yes(row.method.run.uses_times))),
            Column("made_elsewhere", lambda line: line.of_row(lambda row: _yes(made_elsewhere(row.method.run)))),
            *(column for metric in METRICS for column in _metric(board, metric)),
            Column(SECONDS_AND_P95, lambda line: None, shown=_seconds, for_programs=False),
            *map(_elsewhere, ELSEWHERE, ("pairs", "answered_share", "confident_share", "confident_high")),
            Column("above_identity", lambda line: None if (of := _above(line)) is None else of.mean, "share"),
            Column("above_identity_low", lambda line: _above_bound(line, "low"), "share"),
            Column("above_identity_high", lambda line: _above_bound(line, "high"), "share"),
            Column("finer_than_truth", lambda line: " ".join(m.name for m in METRICS if m.name in line.table.finer)),
            *(_median(name) for name in ("distance_m", "angle_deg", "sigma_translation_m", "sigma_rotation_deg")),
            _of_run("target", "target"),
            Column("parameters", lambda line: line.of_row(_parameters)),
            Column("seed", lambda line: line.of_row(lambda row: row.method.seed)),
            Column("version", lambda line: line.of_row(lambda row: row.method.run.versions.get("method"))),
            Column("relocbench", lambda line: line.of_row(lambda row: row.method.run.versions.get("relocbench"))),
            Column("machine", lambda line: line.of_row(lambda row: _plain(row.method.run.machine.get("cpu")))),
            Column("cores", lambda line: line.of_row(lambda row: _plain(row.method.run.machine.get("cores")))),
            _of_run("workers", "workers"),
            Column("one_core", lambda line: line.of_row(lambda row: _yes(row.method.run.one_core))),
        ]
    )


def _metric(board: Board, metric: Metric) -> list[TrackingColumn]:
    """The column of a metric, with those of its bounds where it has an interval."""
    name = metric.name
    column: TrackingColumn = number_column(
        name, metric.unit, definition=metric.description, higher_is_better=metric.higher_is_better
    )
    pairs: TrackingColumn = Column(f"{name}_pairs", lambda line: line.table.over[name])
    bounds = bounds_columns([name]) if metric in board.with_interval else []
    return [column, *bounds, *([pairs] if metric.over is not None else [])]


def _seconds(line: TrackingLine) -> str:
    median, p95 = line.value("median_seconds"), line.value("p95_seconds")
    return "" if median is None else f"{number(median, 's')} / {number(p95, 's')}"


def _elsewhere(key: str, name: str) -> TrackingColumn:
    """A number about pairs of different places."""

    def value(line: TrackingLine) -> Value:
        places: DifferentPlaces | None = None if line.row is None else line.row.elsewhere
        found: Value = None if places is None else getattr(places, name)
        return found

    return Column(key, value, "" if name == "pairs" else "share")


def _above(line: TrackingLine) -> Difference | None:
    return None if line.row is None else line.row.above_identity


def _above_bound(line: TrackingLine, end: str) -> Value:
    above = _above(line)
    found: Value = None if above is None else getattr(above.interval, end, None)
    return found


def _median(name: str) -> TrackingColumn:
    """A median over the pairs of a table."""
    unit = "deg" if name.endswith("_deg") else "m"
    return Column(f"median_{name}", lambda line: line.table.medians[name], unit)


def _of_run(key: str, name: str) -> TrackingColumn:
    """A field of the run's record."""

    def value(line: TrackingLine) -> Value:
        return line.of_row(lambda row: getattr(row.method.run, name))

    return Column(key, value)


def _of_single(line: TrackingLine, name: str) -> Value:
    """A fact of the pair set that a table is of; None of a total."""
    if line.table.is_total:
        return None
    found: Value = getattr(line.set.entry.pair_sets[line.table.pair_sets[0]], name)
    return found


def _isolated(row: Row) -> Value:
    return None if made_elsewhere(row.method.run) else _yes(row.method.run.isolated)


def _parameters(row: Row) -> str:
    return json_text(row.method.run.parameters, sort_keys=True)


def _yes(known: bool | None) -> Value:
    """``yes`` or ``no``; blank where it is not known."""
    return None if known is None else "yes" if known else "no"


def _plain(value: Any) -> Value:
    return value if value is None or isinstance(value, str | int | float) else str(value)
