"""``leaderboard.md``: how the methods compare on every dataset, in one table and one more for each dataset."""

from __future__ import annotations

from urllib.parse import quote

from relocbench.leaderboard.common.cards import shown_cards
from relocbench.leaderboard.common.commands import page_command
from relocbench.leaderboard.common.model import rank_text, share_a_rank
from relocbench.leaderboard.common.over_datasets import over_sections
from relocbench.leaderboard.common.text import METHOD, RANK, SECONDS, number
from relocbench.leaderboard.tracking.marks import (
    DAGGER,
    MARKS,
    about_ranks,
    cell,
    group_heading,
    heading,
    level_with_identity,
    name,
    same_method,
    total_name,
)
from relocbench.leaderboard.tracking.matrix_text import matrix_text
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Table, short_title
from relocbench.leaderboard.tracking.reservations import reservations
from relocbench.leaderboard.tracking.set_page import set_file
from relocbench.metrics import CORRECT, LEVEL, shown_in
from relocbench.pages import render
from relocbench.pages.markdown import escaped, table_text

READING = "reading.md"


def front_page(board: Board) -> str:
    """The page that links the others."""
    rescored = [d for d in board.datasets if any(m.rescored for m in d.entry.methods)]
    datasets = {0: "", 1: "DATASET"}.get(len(rescored), "DATASETS")
    return render(
        __name__,
        "front_page.md.j2",
        metric=board.metric,
        matrix=matrix_text(board.datasets, [set_file(dataset) for dataset in board.datasets]),
        correct=CORRECT,
        reservations=[words for dataset in board.datasets for words in reservations(dataset)],
        over=over_sections(board.over),
        datasets=[_dataset(board, dataset) for dataset in board.datasets],
        grouped=any(dataset.groups_of(table) for dataset in board.datasets for table in dataset.totals),
        signed=[mark for mark in MARKS if any(mark.applies(method) for method in board.methods)],
        dagger=DAGGER if any(_shows_finer(board, table) for d in board.datasets for table in d.totals) else "",
        reading=READING,
        page_command=page_command("--metric", board.metric.name, board.seed, board.split, datasets),
    )


def reading_page(board: Board) -> str:
    """How to read the tables: what is counted, ranked, marked and left out."""
    return render(__name__, "reading.md.j2", metric=board.metric, marks=MARKS, dagger=DAGGER, level=f"{LEVEL:.0%}")


def _dataset(board: Board, dataset: DatasetBoard) -> dict[str, object]:
    entry = dataset.entry
    missing = [m.label for m in entry.methods if any(pair_set in entry.used for pair_set in m.missing)]
    return {
        "entry": entry,
        "name": escaped(short_title(dataset, board.datasets)),
        "page": quote(set_file(dataset)),
        "missing": missing,
        "cards": shown_cards(entry.title, entry.methods),
        "totals": [
            {
                "title": total_name(table),
                "numbers": _total_table(board, dataset, table),
                "about_ranks": about_ranks(board, table),
                "ranked_by_finer": board.metric.name in table.finer,
                "level": level_with_identity(dataset, table),
            }
            for table in dataset.totals
        ],
    }


def _total_table(board: Board, dataset: DatasetBoard, table: Table) -> str:
    """A row for each method: the ranking metric with its interval and by group, and what else is asked first."""
    groups = dataset.groups_of(table)
    _, *beside = shown_in("first page", board.metric)
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
            rank_text(row, table.rows),
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
    return bool(table.finer & {metric.name for metric in shown_in("first page", board.metric)})
