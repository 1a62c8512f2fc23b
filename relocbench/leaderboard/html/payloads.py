"""What the pages show, as payloads: the tables of a set, and the errors of every pair of a pair set."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from relocbench.leaderboard.common.model import rank_text
from relocbench.leaderboard.common.text import COUNTS, SECONDS
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import bytes_of, floats, integers
from relocbench.leaderboard.tracking.by_condition import UNKNOWN, by_condition
from relocbench.leaderboard.tracking.marks import MARKS, about_ranks, level_with_identity, plain_heading
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import MEDIANS, SAME_DRIVE_TOTAL, Board, DatasetBoard, Row, Table
from relocbench.metrics import CORRECT, Interval, metric_named, shown_in
from relocbench.metrics.pose.metric import SIGMA_FACTOR
from relocbench.metrics.pose.tiers import TIERS

_LIST: list[dict[str, Any]] = [
    {"key": "task", "title": "pair", "kind": "link"},
    {"key": "found", "title": "found", "kind": "found", "higher": True},
    {"key": "translation_error_m", "title": "translation error, m", "kind": "error_m", "higher": False},
    {"key": "rotation_error_deg", "title": "rotation error, °", "kind": "error_deg", "higher": False},
    {"key": "confidence", "title": "confidence", "kind": "number", "higher": True},
    {"key": "status", "title": "answer", "kind": "status"},
    {"key": "seconds", "title": "seconds", "kind": "s", "higher": False},
    {"key": "distance_m", "title": "distance, m", "kind": "m"},
    {"key": "angle_deg", "title": "angle, °", "kind": "deg"},
    {"key": "tier", "title": "tier", "kind": "text"},
    {"key": "task", "title": "pair set", "kind": "text"},
]
"""the columns of lists of pairs: key of a row, heading, how it is shown, and whether more is better"""


def set_payload(board: Board, dataset: DatasetBoard) -> dict[str, Any]:
    """All tables of a dataset."""
    entry = dataset.entry
    tables = [table for name in entry.pair_sets if (table := entry.errors_of(name)) is not None]
    has_tiers = any((table.scores.tiers >= 0).any() for table in tables)
    _, *shown = shown_in("set page", board.metric)
    first = [metric for metric in shown if metric.name in MEDIANS]
    metrics = [board.metric, *first, *(m for m in shown if m not in first), metric_named(SECONDS)]
    described = {m.name: {"heading": plain_heading(m), "unit": m.unit, "higher": m.higher_is_better} for m in metrics}
    return {
        "id": links.set_id(entry.record),
        "title": entry.title,
        "ranking": board.metric.name,
        "unit": "pair",
        "units": "pairs",
        "page": {"file": links.PAIR_PAGE, "task": "pairset", "unit": "pair", "method": "method"},
        "correct": list(CORRECT),
        "worst": "both",
        "list": [column for column in _LIST if column["key"] != "tier" or has_tiers],
        "columns": {**described, COUNTS: {"heading": COUNTS, "unit": ""}},
        "views": {"methods": ["method", "rank", *described, COUNTS]},
        "heat": ["query", "reference"],
        "least_cells": 2,
        "charts": f"charts/{links.set_id(entry.record)}",
        "methods": {m.label: _method(m) for m in _best_first(dataset)},
        "tasks": {
            name: {
                "answers": links.unit_key("errors", entry.record, name),
                "pictures": links.unit_key("pairs", entry.record, name),
                "title": record.query if record.query_condition == UNKNOWN else record.query_condition,
                "gallery": record.reference_condition,
                "query": record.query_condition,
                "has_conditions": True,
                "finest_m": _finest(record.median_sigma_translation_m),
                "finest_deg": _finest(record.median_sigma_rotation_deg),
            }
            for name, record in entry.pair_sets.items()
        },
        "tables": [_table(board, dataset, table, list(described)) for table in dataset.tables],
    }


def errors_payload(dataset: DatasetBoard, pair_set: str) -> dict[str, Any] | None:
    """The errors of all methods on the pairs of one place of a pair set; None where no method has any."""
    known = {m.label: m.errors[pair_set] for m in dataset.entry.methods if pair_set in m.errors}
    if not known:
        return None
    first = next(iter(known.values()))
    has_tiers = bool((first.scores.tiers >= 0).any())
    return {
        "pairs": len(first),
        "units": {
            "reference": integers(first.keys[:, 0]),
            "query": integers(first.keys[:, 1]),
            "group": floats(first.group_index),
            "distance_m": floats(first.column("distance_m")),
            "angle_deg": floats(first.column("angle_deg")),
            **({"tier": bytes_of(first.scores.tiers + 1)} if has_tiers else {}),
        },
        "words": {"group": list(first.group_names), **({"tier": ["", *TIERS]} if has_tiers else {})},
        "methods": {
            label: {
                "translation_error_m": floats(rows.errors.translation_error_m),
                "rotation_error_deg": floats(rows.errors.rotation_error_deg),
                "confidence": floats(rows.column("confidence")),
                "seconds": floats(rows.column("seconds")),
                "status": bytes_of(rows.status_index),
            }
            for label, rows in known.items()
        },
    }


def _method(method: Method) -> dict[str, Any]:
    return {"baseline": method.is_baseline, "competes": not method.is_baseline, "marks": marks_of(method)}


def marks_of(method: Method) -> list[str]:
    """What stands behind the name of a method in every table."""
    marks = [mark.name for mark in MARKS if mark.applies(method)]
    if method.is_identity:
        marks.insert(0, "trivial baseline")
    elif method.is_clock:
        marks.insert(0, "timestamp-only baseline")
    elif method.run.uses_times:
        marks.insert(0, "uses times")
    return [*marks, *filter(None, [method.run.assumes])]


def _finest(sigma: float | None) -> float | None:
    return None if sigma is None else SIGMA_FACTOR * sigma


def table_title(table: Table) -> str:
    """The name of a table in a choice of tables."""
    if not table.is_total:
        return table.pair_set
    kind = "total, same drive" if table.pair_set == SAME_DRIVE_TOTAL else "total, cross-condition"
    return f"{kind}, split {table.split}" if table.split else kind


def no_gain(dataset: DatasetBoard, table: Table) -> str:
    """Which methods of a table gain nothing over the identity pose, without a full stop; empty for none."""
    level = ", ".join(level_with_identity(dataset, table))
    return f"No significant gain over the identity baseline: {level}" if level else ""


def _best_first(dataset: DatasetBoard) -> list[Method]:
    """The methods in the order of the matrix."""
    order = [line.label for line in by_condition([dataset]).lines]
    return sorted(dataset.entry.methods, key=lambda method: order.index(method.label))


def _table(board: Board, dataset: DatasetBoard, table: Table, metrics: list[str]) -> dict[str, Any]:
    return {
        "title": table_title(table),
        "total": table.is_total,
        "tasks": list(table.pair_sets),
        "group": table.group,
        "finer": sorted(table.finer),
        "about": f"{'. '.join(_about(table))}.",
        "notes": [about_ranks(board, table), no_gain(dataset, table)],
        "rows": [_row(table, row, metrics) for row in table.rows],
    }


def _row(table: Table, row: Row, metrics: list[str]) -> dict[str, Any]:
    intervals: Mapping[str, Interval | None] = row.intervals
    return {
        "method": row.method.label,
        "texts": {
            "rank": rank_text(row, table.rows),
            COUNTS: "" if row.failed is None else f"{row.failed} / {row.broke}",
        },
        "values": {name: row.values[name] for name in metrics},
        "intervals": {n: [i.low, i.high] for n in metrics if (i := intervals.get(n)) is not None},
        "missing": list(row.missing),
    }


def _about(table: Table) -> Iterator[str]:
    """How many pairs a table is of, and which results are missing in it."""
    rejected = f"; {table.rejected} more have no accepted truth" if table.rejected else ""
    yield f"{table.pairs} pairs{rejected}"
    missing = [
        f"{row.method.label} on {name} ({row.method.missing.get(name, 'no result')})"
        for row in table.rows
        for name in row.missing
    ]
    if missing:
        yield f"Missing: {'; '.join(missing)}"
