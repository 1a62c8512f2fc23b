"""``leaderboard.md``: how the methods compare on every dataset, in one table and one more for each dataset."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from relocbench.leaderboard.common.cards import shown_cards
from relocbench.leaderboard.common.headings import METHOD, RANK, SECONDS
from relocbench.leaderboard.common.text import number
from relocbench.leaderboard.tracking.cells import (
    DAGGER,
    cell,
    group_heading,
    heading,
    level_with_floor,
    name,
    rank,
    same_method,
    share_a_rank,
    total_name,
    without_intervals,
)
from relocbench.leaderboard.tracking.load import Method
from relocbench.leaderboard.tracking.marks import MARKS, signs
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, Table
from relocbench.leaderboard.tracking.set_page import set_file
from relocbench.metrics import LEVEL, MIN_EFFECTIVE, metric_named
from relocbench.pages import render
from relocbench.pages.markdown import escaped, table_text

READING = "reading.md"
_BESIDE = ("coverage", "median_translation_error_m", "median_rotation_error_deg", "t_auc@0.5m", "r_auc@0.5deg")
"""the metrics of a dataset's table besides the ranking metric"""


def front_page(board: Board) -> str:
    """The page that links the others."""
    lookup = [d for d in board.datasets if any(m.rescored for m in d.entry.methods)]
    datasets = {0: "", 1: " --dataset DATASET"}.get(len(lookup), " --dataset DATASETS")
    split = f" --split {shlex.quote(board.split)}" if board.split else ""
    methods = [method for dataset in board.datasets for method in dataset.entry.methods]
    return render(
        __name__,
        "front_page.md.j2",
        metric=board.metric,
        summary=_summary(board),
        datasets=[_dataset(board, dataset) for dataset in board.datasets],
        grouped=any(dataset.groups_of(table) for dataset in board.datasets for table in dataset.totals),
        signed=[mark for mark in MARKS if any(mark.applies(method) for method in methods)],
        dagger=DAGGER if any(_shows_finer(board, table) for d in board.datasets for table in d.totals) else "",
        reading=READING,
        min_effective=f"{MIN_EFFECTIVE:g}",
        page_command=f"relocbench leaderboard RESULTS --out DIR{datasets} --metric '{board.metric.name}' "
        f"--seed {board.seed}{split}",
    )


def reading_page(board: Board) -> str:
    """How to read the tables: what is counted, ranked, marked and left out."""
    return render(__name__, "reading.md.j2", metric=board.metric, marks=MARKS, dagger=DAGGER, level=f"{LEVEL:.0%}")


def _dataset(board: Board, dataset: DatasetBoard) -> dict[str, object]:
    entry = dataset.entry
    missing = [m.label for m in entry.methods if any(pair_set in entry.used for pair_set in m.missing)]
    return {
        "entry": entry,
        "name": _shown_name(board, dataset),
        "page": quote(set_file(dataset)),
        "missing": missing,
        "cards": shown_cards(entry.title, entry.methods),
        "totals": [
            {
                "title": total_name(table),
                "numbers": _total_table(board, dataset, table),
                "without_intervals": without_intervals(board, table),
                "ranks_shared": share_a_rank(table.rows),
                "ranked_by_finer": board.metric.name in table.finer,
                "level_with_floor": level_with_floor(dataset, table),
            }
            for table in dataset.totals
        ],
    }


def _shown_name(board: Board, dataset: DatasetBoard) -> str:
    """The name of a dataset, with its fingerprint where another one has the same name."""
    name = dataset.entry.record.name
    alone = sum(other.entry.record.name == name for other in board.datasets) == 1
    return escaped(name if alone else dataset.entry.title)


def _total_table(board: Board, dataset: DatasetBoard, table: Table) -> str:
    """A row for each method: the ranking metric with its interval and by group, and what else is asked first."""
    groups = dataset.groups_of(table)
    beside = [metric_named(metric) for metric in _BESIDE if metric != board.metric.name]
    columns = [
        RANK,
        METHOD,
        heading(board.metric, table),
        *map(group_heading, groups),
        *(heading(metric, table) for metric in beside),
        SECONDS,
    ]
    rows = [
        [
            rank(row, table),
            name(row),
            cell(board.metric, row, table, interval=row.rank is not None and not share_a_rank(table.rows)),
            *(cell(board.metric, same_method(row, group), group, interval=False) for group in groups),
            *(cell(metric, row, table, interval=False) for metric in beside),
            number(row.values["median_seconds"], "s"),
        ]
        for row in table.rows
    ]
    return table_text(columns, rows, left=2)


def _shows_finer(board: Board, table: Table) -> bool:
    """Whether the page shows a metric of the table whose thresholds are finer than the ground truth allows."""
    return bool(table.finer & {board.metric.name, *_BESIDE})


@dataclass(frozen=True)
class _Column:
    """A total in the summary."""

    title: str
    table: Table


def _summary(board: Board) -> str:
    """The ranking metric of every method on every total, whichever of the two are more as rows; empty without rows."""
    columns = list(_columns(board))
    labels = _labels(columns)
    if not labels:
        return ""
    cells = [[_summary_cell(board, column.table, label) for column in columns] for label in labels]
    names = [_named(columns, label) for label in labels]
    titles = [column.title for column in columns]
    if len(columns) <= len(labels):
        return table_text([METHOD, *titles], [[a, *row] for a, row in zip(names, cells, strict=True)], left=1)
    across = [list(row) for row in zip(*cells, strict=True)]
    return table_text(["dataset", *names], [[a, *row] for a, row in zip(titles, across, strict=True)], left=1)


def _columns(board: Board) -> Iterator[_Column]:
    for dataset in board.datasets:
        link = f"[{_shown_name(board, dataset)}]({quote(set_file(dataset))})"
        for table in dataset.totals:
            yield _Column(f"{link}<br>{total_name(table)}<br>{table.pairs} pairs", table)


def _labels(columns: Sequence[_Column]) -> list[str]:
    """The labels of all methods: those with ranks on more totals first, then by their mean rank, the floors last."""
    rows: dict[str, list[Row]] = {}
    for column in columns:
        for row in column.table.rows:
            rows.setdefault(row.method.label, []).append(row)

    def place(label: str) -> tuple[bool, bool, int, float, str]:
        own = rows[label]
        ranks = [row.rank for row in own if row.rank is not None]
        floor = any(row.method.is_floor or row.method.is_clock for row in own)
        return floor, not ranks, -len(ranks), sum(ranks) / max(len(ranks), 1), label

    return sorted(rows, key=place)


def _named(columns: Sequence[_Column], label: str) -> str:
    """A method's label; the floors in italics, and with signs of marks that it has on any dataset."""
    methods: list[Method] = [r.method for c in columns for r in c.table.rows if r.method.label == label]
    shown = escaped(label)
    if any(method.is_floor or method.is_clock for method in methods):
        shown = f"*{shown}*"
    return " ".join([shown, *dict.fromkeys(sign for method in methods for sign in signs(method).split())])


def _summary_cell(board: Board, table: Table, label: str) -> str:
    """The ranking metric, in bold at the first rank unless all share it; empty where the method was not run."""
    row = next((row for row in table.rows if row.method.label == label), None)
    if row is None:
        return ""
    text = cell(board.metric, row, table, interval=False)
    return f"**{text}**" if text and row.rank == 1 and not share_a_rank(table.rows) else text
