"""Writing ``relocalization.csv`` and ``relocalization.md``: the same results give the same bytes."""

from __future__ import annotations

from pathlib import Path

from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.relocalization.score import POSE_METRICS, RANKING
from relocbench.files import remove_parts, write_text
from relocbench.leaderboard.common.text import Value, write_records
from relocbench.leaderboard.relocalization.board import (
    SHARES,
    WITH_INTERVAL,
    PipelineBoard,
    PipelineRow,
    PipelineSetBoard,
    PipelineTable,
    load_pipelines,
)
from relocbench.leaderboard.relocalization.page import relocalization_page
from relocbench.progress import Reporter


def write_relocalization_leaderboard(
    results: Path,
    out: Path,
    *,
    metric: str = RANKING,
    split: str | None = None,
    seed: int = 0,
    datasets: DatasetLookup | None = None,
    reporter: Reporter,
) -> PipelineBoard | None:
    """Compare pipelines and write both files; None where a results folder has no pipelines to show.

    Args:
        datasets: with their truth; without them, those in folders beside ``results``.

    Raises:
        PredictionError: a bad file, scores that are missing or stale, or rows that do not follow from the answers.
        ConfigError: an unknown metric or split.
        DatasetError: a dataset that was named is damaged.
    """
    board = load_pipelines(results, metric=metric, split=split, seed=seed, datasets=datasets)
    if board is not None:
        write_pipeline_board(board, out, reporter)
    return board


def write_pipeline_board(board: PipelineBoard, out: Path, reporter: Reporter) -> None:
    """Write ``relocalization.csv`` and ``relocalization.md``, and note which results are missing."""
    note_missing(board, reporter)
    write_pipeline_table(board, out)
    write_pipeline_page(board, out)


def note_missing(board: PipelineBoard, reporter: Reporter) -> None:
    """Tell which pipelines have no result on a task."""
    for asked in board.sets:
        for pipeline in asked.pipelines:
            for name in (t.name for t in asked.tables if len(t.tasks) == 1 and t.name not in pipeline.answers):
                reporter.note(f"{asked.title}: {pipeline.label} has no result on {name}")


def write_pipeline_table(board: PipelineBoard, out: Path) -> list[Path]:
    """Write ``relocalization.csv``; returns the files."""
    remove_parts(out, deep=False)
    write_records(out / "relocalization.csv", pipeline_rows(board))
    return [out / "relocalization.csv"]


def write_pipeline_page(board: PipelineBoard, out: Path) -> list[Path]:
    """Write ``relocalization.md``; returns the files."""
    remove_parts(out, deep=False)
    write_text(out / "relocalization.md", relocalization_page(board))
    return [out / "relocalization.md"]


def pipeline_rows(board: PipelineBoard) -> list[dict[str, Value]]:
    """The rows of ``relocalization.csv``: shares 0..1, metres, degrees, seconds; None where there is no value."""
    return [_row(board, asked, t, row) for asked in board.sets for t in asked.tables for row in t.rows]


def _row(board: PipelineBoard, asked: PipelineSetBoard, table: PipelineTable, row: PipelineRow) -> dict[str, Value]:
    run = row.pipeline.run
    basin = row.pipeline.basins.get(table.tasks[0]) if len(table.tasks) == 1 else None
    place: dict[str, Value] = {
        "dataset": asked.record.dataset,
        "fingerprint": asked.record.dataset_fingerprint,
        "table": table.name,
        "tasks": " ".join(table.tasks),
        "queries": table.queries,
        "retriever": run.retriever,
        "tracker": run.tracker,
        "top": run.top,
        "rank": row.rank,
        "missing": " ".join(row.missing),
        "rescored": "yes" if row.rescored else "no",
        "failed": row.failed,
        "broke": row.broke,
        "basin_m": None if basin is None else basin.metres,
        "basin_deg": None if basin is None else basin.degrees,
        "basin_source": None if basin is None else basin.source,
    }
    medians = ("median_translation_error_m", "median_rotation_error_deg", "median_seconds")
    for name in (*POSE_METRICS, *SHARES, "right_given_hit", *medians):
        place[name] = row.values.get(name)
    for name in dict.fromkeys((*WITH_INTERVAL, board.metric)):
        interval = row.intervals.get(name)
        place[f"{name}_low"] = None if interval is None else interval.low
        place[f"{name}_high"] = None if interval is None else interval.high
    return place
