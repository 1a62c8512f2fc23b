"""The tables for programs: a row for each dataset, pair set, group and method, with numbers in full."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Any

from relocbench.evaluation.common.error_table import ERROR_COLUMNS, ErrorTable
from relocbench.files import CHUNK_ROWS
from relocbench.leaderboard.common.text import Value, cell, json_text
from relocbench.leaderboard.tracking.marks import made_elsewhere
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import METRICS

ERRORS_HEAD = ("dataset", "fingerprint", "pair_set", "method")


def leaderboard_rows(board: Board) -> list[dict[str, Value]]:
    """The rows of ``leaderboard.csv``: shares 0..1, metres, degrees, seconds; None where there is no value."""
    return [
        _row(board, dataset, table, row) for dataset in board.datasets for table in dataset.tables for row in table.rows
    ]


def seed_rows(board: Board) -> list[dict[str, Value]]:
    """The rows of ``seeds.csv``: mean and standard deviation over runs that differ by their seed alone."""
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


def error_rows(board: Board) -> Iterator[Sequence[Value]]:
    """The rows of ``errors.csv``, with its header: the errors of every pair and every method, as safe texts.

    In each pair set, pairs of different places follow those of one place.
    """
    yield [*ERRORS_HEAD, *ERROR_COLUMNS]
    for dataset in board.datasets:
        record = dataset.entry.record
        for name in dataset.entry.pair_sets:
            for method in dataset.entry.methods:
                for table in method.tables(name) if name in method.errors else ():
                    place = (record.name, method.run.fingerprint, name, method.label)
                    yield from _error_rows(place, table)


def _error_rows(place: tuple[str, ...], rows: ErrorTable) -> Iterator[Sequence[Value]]:
    """The rows of one method as texts made safe by :func:`relocbench.leaderboard.common.text.cell`, name by name."""
    words = [repeat(cell(word)) for word in place]
    named = replace(rows, group_names=tuple(str(cell(name)) for name in rows.group_names))
    for start in range(0, len(rows), CHUNK_ROWS):
        yield from zip(*words, *named[start : start + CHUNK_ROWS].texts(), strict=False)


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
        "rescored": _yes(row.method.rescored),
        "isolated": None if made_elsewhere(run) else _yes(run.isolated),
        "uses_times": _yes(run.uses_times),
        "made_elsewhere": _yes(made_elsewhere(run)),
    }
    finer = [m.name for m in METRICS if m.name in table.finer]
    for metric in METRICS:
        out[metric.name] = row.values[metric.name]
        if metric in board.with_interval:
            interval = row.intervals.get(metric.name)
            out[f"{metric.name}_low"] = interval.low if interval else None
            out[f"{metric.name}_high"] = interval.high if interval else None
    elsewhere = row.elsewhere
    out["elsewhere"] = elsewhere.pairs if elsewhere else None
    out["elsewhere_answered"] = elsewhere.answered_share if elsewhere else None
    out["elsewhere_confident"] = elsewhere.confident_share if elsewhere else None
    out["elsewhere_confident_high"] = elsewhere.confident_high if elsewhere else None
    above = row.above_identity
    out["above_identity"] = above.mean if above else None
    out["above_identity_low"] = above.interval.low if above and above.interval else None
    out["above_identity_high"] = above.interval.high if above and above.interval else None
    out["finer_than_truth"] = " ".join(finer)
    out |= {f"median_{name}": value for name, value in table.medians.items()}
    out |= {
        "fingerprint": run.fingerprint,
        "target": run.target,
        "parameters": json_text(run.parameters, sort_keys=True),
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
    only = entry.pair_sets[table.pair_sets[0]] if not table.is_total else None
    return {
        "dataset": entry.record.name,
        "fingerprint": entry.record.fingerprint,
        "question": entry.record.question,
        "pair_set": table.pair_set,
        "split": table.split,
        "group": table.group,
        "reference_condition": only.reference_condition if only else None,
        "query_condition": only.query_condition if only else None,
    }


def _yes(known: bool | None) -> Value:
    """``yes`` or ``no``; blank where it is not known."""
    return None if known is None else "yes" if known else "no"


def _plain(value: Any) -> Value:
    return value if value is None or isinstance(value, str | int | float) else str(value)
