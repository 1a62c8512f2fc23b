"""The tables for programs: one row for each dataset, pair set, group and method, numbers in full."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from relocbench.evaluation.results import ERROR_COLUMNS
from relocbench.leaderboard.model import TOTAL, Board, DatasetBoard, Row, Table
from relocbench.metrics import METRICS

Value = str | int | float | None
ERRORS_HEAD = ("dataset", "fingerprint", "pair_set", "method")


def leaderboard_rows(board: Board) -> list[dict[str, Value]]:
    """Rows of ``leaderboard.csv``: shares 0..1, metres, degrees, seconds; None where there is no value."""
    return [
        _row(board, dataset, table, row) for dataset in board.datasets for table in dataset.tables for row in table.rows
    ]


def seed_rows(board: Board) -> list[dict[str, Value]]:
    """Rows of ``seeds.csv``: mean and standard deviation of runs that differ by their seed alone."""
    return [
        {
            **_place(dataset, table),
            "target": row.target,
            "methods": " ".join(row.labels),
            "seeds": " ".join(map(str, row.seeds)),
            "metric": name,
            "mean": None if spread is None else spread.mean,
            "standard_deviation": None if spread is None else spread.standard_deviation,
        }
        for dataset in board.datasets
        for table in dataset.tables
        for row in table.seeds
        for name, spread in row.spread.items()
    ]


def error_rows(board: Board) -> Iterator[list[Value]]:
    """Rows of ``errors.csv``, after its header: the errors of every pair and every method."""
    yield [*ERRORS_HEAD, *ERROR_COLUMNS]
    for dataset in board.datasets:
        record = dataset.entry.record
        for name in dataset.entry.pair_sets:
            for method in dataset.entry.methods:
                for row in method.errors.get(name, ()):
                    values = [*row.key, *(getattr(row, column) for column in ERROR_COLUMNS[2:])]
                    yield [record.name, record.fingerprint, name, method.label, *values]


def _row(board: Board, dataset: DatasetBoard, table: Table, row: Row) -> dict[str, Value]:
    run = row.method.run
    out: dict[str, Value] = {
        **_place(dataset, table),
        "method": row.method.label,
        "rank": row.rank,
        "ranked_by": board.metric.name,
        "pairs": table.pairs,
        "rejected": table.rejected,
        "answered": row.answered,
        "failed": row.failed,
        "broke": row.broke,
        "missing": " ".join(row.missing),
    }
    finer = [m.name for m in METRICS if m.name in table.grey]
    for metric in METRICS:
        out[metric.name] = row.values[metric.name]
        if metric in board.with_interval:
            interval = row.intervals.get(metric.name)
            out[f"{metric.name}_low"] = interval.low if interval else None
            out[f"{metric.name}_high"] = interval.high if interval else None
    above = row.above_floor
    out["above_identity"] = above.mean if above else None
    out["above_identity_low"] = above.interval.low if above and above.interval else None
    out["above_identity_high"] = above.interval.high if above and above.interval else None
    out["finer_than_truth"] = " ".join(finer)
    out |= {f"median_{name}": value for name, value in table.medians.items()}
    out |= {
        "target": run.target,
        "parameters": json.dumps(run.parameters, sort_keys=True, ensure_ascii=False),
        "seed": row.method.seed,
        "version": run.versions.get("method"),
        "relocbench": run.versions.get("relocbench"),
        "machine": _plain(run.machine.get("cpu")),
        "cores": _plain(run.machine.get("cores")),
        "workers": run.workers,
    }
    return out


def _place(dataset: DatasetBoard, table: Table) -> dict[str, Value]:
    entry = dataset.entry
    only = entry.pair_sets[table.pair_sets[0]] if table.pair_set != TOTAL else None
    return {
        "dataset": entry.record.name,
        "fingerprint": entry.record.fingerprint,
        "pair_set": table.pair_set,
        "split": table.split,
        "group": table.group,
        "reference_condition": only.reference_condition if only else None,
        "query_condition": only.query_condition if only else None,
    }


def _plain(value: Any) -> Value:
    return value if value is None or isinstance(value, str | int | float) else str(value)
