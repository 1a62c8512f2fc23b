"""The tables for programs: a row for each dataset, pair set, group and method, with numbers in full."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import repeat

from relocbench.evaluation.tables.errors import ERRORS, ErrorTable
from relocbench.files import CHUNK_ROWS
from relocbench.leaderboard.common.columns import Line, records
from relocbench.leaderboard.common.text import Value, cell
from relocbench.leaderboard.tracking.columns import lines_of, place_columns, tracking_columns
from relocbench.leaderboard.tracking.model import Board

ERROR_COLUMNS = ("dataset", "fingerprint", "pair_set", "method", *ERRORS.columns)


def leaderboard_rows(board: Board) -> list[dict[str, Value]]:
    """The rows of ``leaderboard.csv``: shares 0..1, metres, degrees, seconds; None where there is no value."""
    lines = [line for dataset in board.datasets for table in dataset.tables for line in lines_of(dataset, table)]
    return records(tracking_columns(board).values(), lines)


def seed_rows(board: Board) -> list[dict[str, Value]]:
    """The rows of ``seeds.csv``: mean and standard deviation over runs that differ by their seed alone."""
    return [
        {
            **records(place_columns(), [Line(dataset, table, None)])[0],
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
    """The rows of ``errors.csv``, of :data:`ERROR_COLUMNS`: the errors of every pair and every method, as safe texts.

    In each pair set, pairs of different places follow those of one place.
    """
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
