"""Writing the leaderboard of trackers: the same results give the same bytes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.files import remove_parts, write_table, write_text
from relocbench.leaderboard.common.cards import write_cards
from relocbench.leaderboard.common.over_datasets import over_records
from relocbench.leaderboard.common.text import write_records
from relocbench.leaderboard.tracking.doubt import check_truth, truth_rows
from relocbench.leaderboard.tracking.front_page import READING, front_page, reading_page
from relocbench.leaderboard.tracking.load import load_results
from relocbench.leaderboard.tracking.long_form import ERROR_COLUMNS, error_rows, leaderboard_rows, seed_rows
from relocbench.leaderboard.tracking.marks import not_rescored
from relocbench.leaderboard.tracking.matching import matching_rows
from relocbench.leaderboard.tracking.model import RANKING, Board, DatasetEntry
from relocbench.leaderboard.tracking.set_page import set_file, set_page
from relocbench.leaderboard.tracking.tables import make_board, ranking_metric
from relocbench.progress import Reporter, Silent

_OF_A_DATASET = re.compile(r"@[0-9a-f]{12}\.md$")
"""the end of the name of a dataset's page"""


def write_leaderboard(
    results: Path,
    out: Path,
    *,
    metric: str = RANKING,
    split: str | None = None,
    seed: int = 0,
    datasets: DatasetLookup | None = None,
    reporter: Reporter | None = None,
) -> Board:
    """Compare the methods in a results folder, and write the leaderboard.

    Args:
        results: ``RESULTS``, or one of its ``DATASET@FINGERPRINT`` folders; it is only read.
        out: folder for the files of :func:`write_tables` and :func:`write_pages`.
        metric: the metric that ranks methods, a mean over pairs.
        split: only the pair sets of this split.
        seed: of the draws that decide ranks.
        datasets: with their truth; without them, those in folders beside ``results``.
        reporter: receives progress and notes on missing results.

    Raises:
        PredictionError: no results, a bad file, scores that are missing or stale, or errors that are not those of the
            predictions.
        ConfigError: an unknown metric or split.
        DatasetError: a dataset that was named is damaged.
    """
    report = Silent() if reporter is None else reporter
    ranking_metric(metric)  # a mistyped metric is reported before anything is read
    entries = load_results(results, split, datasets=datasets)
    board = compare(entries, metric=metric, split=split, seed=seed, reporter=report)
    write_tables(board, out)
    write_pages(board, out)
    return board


def compare(
    entries: Sequence[DatasetEntry],
    *,
    metric: str = RANKING,
    split: str | None = None,
    seed: int = 0,
    reporter: Reporter,
) -> Board:
    """Compare the methods of these entries as :func:`write_leaderboard` does, with its notes; nothing is written."""
    for entry in entries:
        claimed = [method.label for method in entry.methods if not_rescored(method)]
        if claimed:
            why = "not rescored, as the dataset is not available (--dataset)"
            reporter.note(f"{entry.title}: {why}: {', '.join(claimed)}")
        for method in entry.methods:
            for pair_set in (name for name in entry.used if name in method.missing):
                reporter.note(f"{entry.title}: {method.label} has no result on {pair_set}: {method.missing[pair_set]}")
    checked = [_with_checked_truth(entry, reporter) for entry in entries]
    return make_board(checked, metric=metric, seed=seed, split=split, reporter=reporter)


def _with_checked_truth(entry: DatasetEntry, reporter: Reporter) -> DatasetEntry:
    """The entry with what the images of its dataset say of the truth, where the dataset is available."""
    if entry.dataset is None:
        return entry
    return replace(entry, truth_checks=check_truth(entry.dataset, entry.used, reporter))


def write_tables(board: Board, out: Path) -> list[Path]:
    """Write ``leaderboard.csv`` and ``errors.csv``; returns the files.

    ``datasets.csv`` (all datasets together), ``seeds.csv``, ``matching.csv`` and ``truth.csv`` are written as well if
    they have rows. Each appears whole or not at all, and none contains a date.
    """
    remove_parts(out, deep=False)
    paths = [out / "leaderboard.csv", out / "errors.csv"]
    write_records(paths[0], leaderboard_rows(board))
    write_table(paths[1], ERROR_COLUMNS, error_rows(board))
    checks = [
        row
        for dataset in board.datasets
        for row in truth_rows(
            {"dataset": dataset.entry.record.name, "fingerprint": dataset.entry.record.fingerprint},
            dataset.entry.truth_checks,
        )
    ]
    further = {
        "datasets.csv": over_records(board.over),
        "seeds.csv": seed_rows(board),
        "matching.csv": matching_rows(board),
        "truth.csv": checks,
    }
    for name, records in further.items():
        if records:
            paths.append(out / name)
            write_records(paths[-1], records)
    return paths


def write_pages(board: Board, out: Path) -> list[Path]:
    """Write the pages in Markdown; returns the files.

    ``leaderboard.md`` is the first page, ``sets/`` has one for each dataset and of no other, and ``reading.md`` says
    how to read them. Each file appears whole or not at all, and none contains a date.
    """
    for folder in (out, out / "sets"):
        remove_parts(folder, deep=False)
    paths: list[Path] = []
    for dataset in board.datasets:
        paths += write_cards(out, dataset.entry.title, dataset.entry.methods)
    pages = {set_file(dataset): set_page(board, dataset) for dataset in board.datasets}
    pages |= {READING: reading_page(board), "leaderboard.md": front_page(board)}
    for name, text in pages.items():
        paths.append(out / name)
        write_text(paths[-1], text)
    for page in set((out / "sets").glob("*@*.md")) - set(paths):
        if _OF_A_DATASET.search(page.name):
            page.unlink()  # it has left the leaderboard, and the first page does not link it
    return paths
