"""Writing ``retrieval.csv`` and ``retrieval.md``: the same results give the same bytes."""

from __future__ import annotations

from pathlib import Path

from relocbench.files import remove_parts, write_text
from relocbench.leaderboard.common.cards import write_cards
from relocbench.leaderboard.common.columns import records
from relocbench.leaderboard.common.text import Value, write_records
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.retrieval.columns import all_lines, retrieval_columns
from relocbench.leaderboard.retrieval.page import retrieval_page


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
    """The rows of ``retrieval.csv``: shares 0..1, seconds; None where there is no value."""
    return records(retrieval_columns(board).values(), all_lines(board))
