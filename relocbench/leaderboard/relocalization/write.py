"""Writing ``relocalization.csv`` and ``relocalization.md``: the same results give the same bytes."""

from __future__ import annotations

from pathlib import Path

from relocbench.files import remove_parts, write_text
from relocbench.leaderboard.common.columns import records
from relocbench.leaderboard.common.text import Value, write_records
from relocbench.leaderboard.relocalization.board import PipelineBoard
from relocbench.leaderboard.relocalization.columns import all_lines, pipeline_columns
from relocbench.leaderboard.relocalization.page import relocalization_page


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
    return records(pipeline_columns(board).values(), all_lines(board))
