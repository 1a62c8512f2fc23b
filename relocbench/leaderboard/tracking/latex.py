"""``leaderboard.tex``: a table for each total and each pair set of trackers."""

from __future__ import annotations

from collections.abc import Iterator

from relocbench.leaderboard.common.headings import METHOD, SECONDS, heading
from relocbench.leaderboard.common.latex import Column, LatexTable, Line, document, intervals_of
from relocbench.leaderboard.tracking.cells import total_words
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.metrics import Metric, metric_named, shown_in


def latex_page(board: Board) -> str:
    """All tables, totals of several pair sets first."""
    return document([_table(board, dataset, table) for dataset in board.datasets for table in _tables(dataset)])


def _tables(dataset: DatasetBoard) -> Iterator[Table]:
    yield from (table for table in dataset.totals if len(table.pair_sets) > 1)
    yield from dataset.pair_sets


def _table(board: Board, dataset: DatasetBoard, table: Table) -> LatexTable:
    metrics = shown_in("paper", board.metric)
    seconds = metric_named(SECONDS)
    place = total_words(table) if table.is_total else table.pair_set
    note = f"{table.pairs} pairs"
    note += f", {table.rejected} more rejected." if table.rejected else "."
    if finer := [metric.name for metric in metrics if metric.name in table.finer]:
        note += f" Finer than twice the standard deviation of the ground truth: {', '.join(finer)}."
    return LatexTable(
        title=f"{dataset.entry.title}, {place}",
        label=f"tab:{dataset.entry.title}:{place}",
        heads=(METHOD,),
        columns=(*map(_column, metrics), _column(seconds)),
        lines=tuple(_line(board, row, [*metrics, seconds]) for row in table.rows),
        note=note,
    )


def _column(metric: Metric) -> Column:
    return Column(heading(metric.name, metric.unit), metric.unit, metric.higher_is_better, metric.description)


def _line(board: Board, row: Row, metrics: list[Metric]) -> Line:
    names = [metric.name for metric in metrics]
    shown = {board.metric.name: row.intervals.get(board.metric.name)}
    return Line(
        names=(row.method.label,),
        rank=row.rank,
        values=tuple(row.values[name] for name in names),
        intervals=intervals_of(names, shown),
        competes=not (row.method.is_baseline or row.method.run.uses_times),
    )
