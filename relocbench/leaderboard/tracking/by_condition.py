"""Which method finds what share of the queries, by the condition that the query was taken in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.leaderboard.tracking.model import DatasetBoard, Row, Table
from relocbench.metrics import CORRECT, within

RECALL = f"recall@({CORRECT[0]:g}m,{CORRECT[1]:g}deg)"
"""the metric of the shares: that of an answer that counts as found"""


@dataclass(frozen=True, eq=False)
class Found:
    """What one method finds of the queries of one pair set."""

    share: float | None
    """:data:`RECALL` as the board has it; None without a result"""
    right: NDArray[np.bool_]
    """(N,) whether each pair is found, by time of the query and then of the keyframe; empty without a result"""


@dataclass(frozen=True, eq=False)
class Column:
    """The queries of one pair set."""

    pair_set: str
    condition: str
    pairs: int
    one_drive: bool
    """whether keyframes and queries are of one drive, and so of one condition"""


@dataclass(frozen=True, eq=False)
class Line:
    """One method, from the first column to the last."""

    label: str
    floor: bool
    found: tuple[Found, ...]


@dataclass(frozen=True, eq=False)
class ByCondition:
    """The methods of a dataset with one map, against the conditions of its queries."""

    map_condition: str
    columns: tuple[Column, ...]
    """the map's own drive first, then in the order of the dataset's splits"""
    lines: tuple[Line, ...]
    """the method that finds most in all columns first, floors last"""


def by_condition(board: DatasetBoard) -> ByCondition:
    """Sort the results on a dataset whose pair sets share one map by the condition of the query.

    Raises:
        ValueError: the dataset has no pair set with results, or pair sets of several maps.
    """
    driven = [name for names in board.entry.splits.values() for name in names]
    tables = sorted(board.pair_sets, key=lambda table: (not _one_drive(board, table), driven.index(table.pair_set)))
    records = [board.entry.pair_sets[table.pair_set] for table in tables]
    if len({record.reference for record in records}) != 1:
        raise ValueError("expected pair sets with results, all of one map")
    columns = [
        Column(table.pair_set, record.query_condition, table.pairs, _one_drive(board, table))
        for table, record in zip(tables, records, strict=True)
    ]
    rows = [{row.method.label: row for row in table.rows} for table in tables]
    lines = [
        Line(
            method.label,
            method.is_floor or method.is_clock,
            tuple(_found(of_set[method.label], table) for of_set, table in zip(rows, tables, strict=True)),
        )
        for method in board.entry.methods
    ]
    lines.sort(key=lambda line: (line.floor, -sum(int(found.right.sum()) for found in line.found), line.label))
    return ByCondition(records[0].reference_condition, tuple(columns), tuple(lines))


def _one_drive(board: DatasetBoard, table: Table) -> bool:
    record = board.entry.pair_sets[table.pair_set]
    return record.reference == record.query


def _found(row: Row, table: Table) -> Found:
    if row.missing:
        return Found(None, np.zeros(0, dtype=np.bool_))
    errors = row.method.errors[table.pair_set]
    order = np.lexsort((errors.keys[:, 0], errors.keys[:, 1]))
    return Found(row.values[RECALL], within(errors.errors, *CORRECT)[order])
