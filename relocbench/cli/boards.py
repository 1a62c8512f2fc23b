"""Boards of trackers as the terminal shows them: the matrix of methods and conditions first."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from relocbench.leaderboard.tracking.model import RANKING

if TYPE_CHECKING:
    from relocbench.leaderboard.common.by_query import Board as TaskBoard
    from relocbench.leaderboard.common.over_datasets import OverDatasets
    from relocbench.leaderboard.displays import Display
    from relocbench.leaderboard.tracking.by_condition import ByCondition, Column
    from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Table

SHORT_HEADINGS = {
    RANKING: "found, %",
    "median_translation_error_m": "median m",
    "median_rotation_error_deg": "median deg",
    "coverage": "answered, %",
    "median_seconds": "seconds",
}
"""headings of the terminal that are shorter than the columns of CSV"""


def short_heading(metric: str, unit: str = "share") -> str:
    """The heading of a metric on the terminal, as ``recall 1m 5deg, %``."""
    from relocbench.leaderboard.common.text import heading

    if metric in SHORT_HEADINGS:
        return SHORT_HEADINGS[metric]
    return heading(re.sub(r"@\(([^)]*)\)", lambda at: f" {at[1].replace(',', ' ')}", metric), unit)


def print_matrix(results: ByCondition, name: str = "") -> None:
    """The share of pairs that each method finds, by condition: as many columns side by side as the terminal holds."""
    from relocbench.leaderboard.tracking.reservations import reservations

    for columns in _alike(results.columns):
        _print_part(results, columns, name)
    for dataset in dict.fromkeys(column.dataset for column in results.columns):
        for sentence in reservations(dataset):
            print(f"note: {sentence}")


def _alike(columns: Sequence[Column]) -> list[list[int]]:
    """The columns of one dataset, map and threshold, which have one title together, by number."""
    found: dict[tuple[object, ...], list[int]] = {}
    for number, column in enumerate(columns):
        key = column.dataset.entry.title, column.split, column.map_condition, column.metres, column.degrees
        found.setdefault(key, []).append(number)
    return list(found.values())


def _print_part(results: ByCondition, columns: Sequence[int], name: str) -> None:
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.model import NO_RANK
    from relocbench.leaderboard.common.text import METHOD, RANK, number
    from relocbench.leaderboard.tracking.by_condition import UNKNOWN

    first = results.columns[columns[0]]
    of_split = f", split {first.split}" if first.split else ""
    found = f"pairs found within {first.metres:g} m and {first.degrees:g}°, in %"
    of_map = "" if first.map_condition == UNKNOWN else f". Map: {first.map_condition}"
    title = f"{name or first.dataset.entry.record.name}{of_split}: {found}{of_map}"
    ranked = any(line.rank not in ("", NO_RANK) for line in results.lines)
    heads = [METHOD, *([RANK] if ranked else []), *(_heading(results.columns[i]) for i in columns)]
    rows = [
        [
            line.label,
            *([line.rank] if ranked else []),
            *(number(line.found[i].share, "share") or "–" for i in columns),
        ]
        for line in results.lines
        if any(line.found[i].share is not None for i in columns)
    ]
    print_table(title, heads, rows)


def _heading(column: Column) -> str:
    """A word of the condition a line, so that many columns fit a narrow terminal; the number of pairs last."""
    same = ["(same drive)"] if column.same_drive else []
    doubt = ["TRUTH IN", "DOUBT"] if column.doubt else []
    return "\n".join((*column.title.split(", "), *same, *doubt, f"{column.pairs} pairs"))


def print_board(board: Board) -> None:
    """For each dataset the matrix, then a short table for each of its totals, or pair sets where it has none."""
    from relocbench.leaderboard.tracking.by_condition import by_condition

    for dataset in board.datasets:
        print_matrix(by_condition([dataset]))
    for dataset in board.datasets:
        for table in dataset.totals or dataset.pair_sets:
            _print_table(board, dataset, table)
    print_over(board.over)


def _print_table(board: Board, dataset: DatasetBoard, table: Table) -> None:
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.text import METHOD, RANK
    from relocbench.leaderboard.tracking.columns import lines_of, tracking_columns
    from relocbench.leaderboard.tracking.marks import about_ranks, total_words
    from relocbench.metrics import shown_in

    shown = shown_in("terminal", board.metric)
    columns = tracking_columns(board)
    rejected = f", {table.rejected} rejected" if table.rejected else ""
    over = total_words(table) if table.is_total else table.pair_set
    heads = [METHOD, RANK, *(short_heading(metric.name, metric.unit) for metric in shown)]
    keys = [METHOD, RANK, *(metric.name for metric in shown)]
    rows = [[columns[key].text(line, bounds=False) for key in keys] for line in lines_of(dataset, table)]
    print_table(f"{dataset.entry.record.name}, {over} ({table.pairs} pairs{rejected})", heads, rows)
    if why := about_ranks(board, table):
        print(why)


def print_over(tables: Sequence[OverDatasets[Any]]) -> None:
    """The tables over all datasets together."""
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.over_datasets import over_lines, shown_columns
    from relocbench.leaderboard.common.text import METHOD, RANK

    for over in tables:
        columns = shown_columns(over, (METHOD, RANK))
        rows = [[column.text(line) for column in columns] for line in over_lines(over)]
        heads = [short_heading(column.key, column.unit) for column in columns]
        print_table(f"{over.title} ({over.count} {over.what})", heads, rows)
        for note in over.notes:
            print(note)


def print_by_query(display: Display[Any, Any], board: TaskBoard[Any, Any, Any, Any]) -> None:
    """A short table for each table of a board of retrievers or of pipelines."""
    from relocbench.cli.console import print_table
    from relocbench.leaderboard.common.model import about_ranks

    columns = display.columns(board)
    heads = [short_heading(key, columns[key].unit) for key in display.terminal(board)]
    for of in board.sets:
        for table in of.tables:
            rows = display.texts(board, of, table)
            print_table(f"{of.title}: {table.name} ({table.queries} queries)", heads, rows)
            if why := about_ranks(table.rows, board.metric, f"{table.queries} queries"):
                print(why)
    print_over(board.over)
