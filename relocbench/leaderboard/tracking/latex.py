"""``leaderboard.tex``: a table for each total and each pair set of trackers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from relocbench.leaderboard.common.latex import LatexTable, document
from relocbench.leaderboard.common.over_datasets import over_latex
from relocbench.leaderboard.common.text import METHOD, RANK, SECONDS
from relocbench.leaderboard.tracking.columns import TrackingLine, lines_of, tracking_columns
from relocbench.leaderboard.tracking.marks import total_words
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Table
from relocbench.metrics import shown_in


def latex_page(board: Board) -> str:
    """All tables, those over all datasets first, then totals of several pair sets."""
    return document(chain(map(over_latex, board.over), _of_datasets(board)))


def _of_datasets(board: Board) -> Iterator[LatexTable[TrackingLine]]:
    columns = tracking_columns(board)
    keys = [*(metric.name for metric in shown_in("paper", board.metric)), SECONDS]
    yield from (
        LatexTable(
            of=dataset.entry.title,
            place=total_words(table) if table.is_total else table.pair_set,
            names=[columns[METHOD]],
            rank=columns[RANK],
            columns=[columns[key] for key in keys],
            lines=lines_of(dataset, table),
            competes=_competes,
            metric=board.metric.name,
            note=_note(table, keys),
        )
        for dataset in board.datasets
        for table in _tables(dataset)
    )


def _tables(dataset: DatasetBoard) -> Iterator[Table]:
    yield from (table for table in dataset.totals if len(table.pair_sets) > 1)
    yield from dataset.pair_sets


def _note(table: Table, keys: list[str]) -> str:
    note = f"{table.pairs} pairs"
    note += f", {table.rejected} more rejected." if table.rejected else "."
    if finer := [key for key in keys if key in table.finer]:
        note += f" Finer than twice the standard deviation of the ground truth: {', '.join(finer)}."
    return note


def _competes(line: TrackingLine) -> bool:
    return line.row is not None and not (line.row.method.is_baseline or line.row.method.run.uses_times)
