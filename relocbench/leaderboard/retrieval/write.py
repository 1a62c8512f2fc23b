"""Writing ``retrieval.csv`` and ``retrieval.md``: the same results give the same bytes."""

from __future__ import annotations

from pathlib import Path

from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.files import remove_parts, write_text
from relocbench.leaderboard.common.cards import write_cards
from relocbench.leaderboard.common.text import Value, write_records
from relocbench.leaderboard.retrieval.board import (
    RANKING,
    RetrievalBoard,
    RetrievalRow,
    RetrievalTable,
    SetBoard,
    load_retrieval,
)
from relocbench.leaderboard.retrieval.page import CHANCE, retrieval_page
from relocbench.progress import Reporter


def write_retrieval_leaderboard(
    results: Path,
    out: Path,
    *,
    metric: str = RANKING,
    split: str | None = None,
    seed: int = 0,
    datasets: DatasetLookup | None = None,
    reporter: Reporter,
) -> RetrievalBoard | None:
    """Compare retrievers and write both files; None where a results folder has no retrievers to show.

    Args:
        datasets: with their truth; without them, those in folders beside ``results``.

    Raises:
        PredictionError: a bad file, scores that are missing or stale, or ranks that do not follow from the answers.
        ConfigError: an unknown metric or split.
        DatasetError: a dataset that was named is damaged.
    """
    board = load_retrieval(results, metric=metric, split=split, seed=seed, datasets=datasets)
    if board is not None:
        write_retrieval_board(board, out, reporter)
    return board


def write_retrieval_board(board: RetrievalBoard, out: Path, reporter: Reporter) -> None:
    """Write ``retrieval.csv`` and ``retrieval.md``, and note which results are missing."""
    note_missing(board, reporter)
    write_retrieval_table(board, out)
    write_retrieval_page(board, out)


def note_missing(board: RetrievalBoard, reporter: Reporter) -> None:
    """Tell which methods have no result on a task."""
    for asked in board.sets:
        for method in asked.methods:
            missing = [t.name for t in asked.tables if len(t.tasks) == 1 and t.name not in method.answers]
            for name in missing:
                reporter.note(f"{asked.title}: {method.label} has no result on {name}")


def write_retrieval_table(board: RetrievalBoard, out: Path) -> list[Path]:
    """Write ``retrieval.csv``; returns the files."""
    remove_parts(out, deep=False)
    write_records(out / "retrieval.csv", retrieval_rows(board))
    return [out / "retrieval.csv"]


def write_retrieval_page(board: RetrievalBoard, out: Path) -> list[Path]:
    """Write ``retrieval.md`` and the cards that it links; returns the files."""
    remove_parts(out, deep=False)
    cards = [path for asked in board.sets for path in write_cards(out, asked.title, asked.methods)]
    write_text(out / "retrieval.md", retrieval_page(board))
    return [*cards, out / "retrieval.md"]


def retrieval_rows(board: RetrievalBoard) -> list[dict[str, Value]]:
    """The rows of ``retrieval.csv``: shares 0..1, seconds; None where there is no value.

    ``METRIC_believed`` is by how much a mean could be another one, given the images that were kept of each query.
    """
    out = []
    for asked in board.sets:
        for table in asked.tables:
            out += [_row(board, asked, table, row) for row in table.rows]
            out.append(_row(board, asked, table, None))
    return out


def _row(board: RetrievalBoard, asked: SetBoard, table: RetrievalTable, row: RetrievalRow | None) -> dict[str, Value]:
    """The row of a method, or of chance if ``row`` is None."""
    one = table.records[0] if len(table.records) == 1 else None
    place: dict[str, Value] = {
        "dataset": asked.record.name,
        "fingerprint": asked.record.fingerprint,
        "question": asked.record.question,
        "table": table.name,
        "tasks": " ".join(table.tasks),
        "view_query": "+".join(sorted({r.view_query for r in table.records})),
        "view_gallery": "+".join(sorted({r.view_gallery for r in table.records})),
        "condition_query": one.condition_query if one else None,
        "condition_gallery": one.condition_gallery if one else None,
        "queries": table.queries,
        "without_positives": table.without_positives,
        "gallery": one.gallery if one else None,
        "method": CHANCE if row is None else row.method.label,
        "target": None if row is None else row.method.run.target,
        "rank": None if row is None else row.rank,
        "missing": "" if row is None else " ".join(row.missing),
        "rescored": None if row is None else row.rescored,
        "failed": None if row is None else row.failed,
        "broke": None if row is None else row.broke,
        "median_seconds": None if row is None else row.seconds,
    }
    for metric in board.shown:
        place[metric] = table.chance[metric] if row is None else row.values[metric]
    for metric in dict.fromkeys(("R@1", "AP", board.metric)):
        interval = None if row is None else row.intervals.get(metric)
        place[f"{metric}_low"] = None if interval is None else interval.low
        place[f"{metric}_high"] = None if interval is None else interval.high
    believed = None if row is None or row.confirmed is None else row.confirmed.believed
    for metric in board.shown:
        place[f"{metric}_believed"] = None if believed is None else believed[metric]
    return place
