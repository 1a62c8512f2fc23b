"""The pages of a leaderboard as one text: those of its datasets first, so that a heading's first table is theirs."""

from __future__ import annotations

from pathlib import Path


def board_pages(board: Path) -> str:
    """The pages of the datasets, then how to read them, then the first page."""
    paths = [*sorted((board / "sets").glob("*.md")), board / "reading.md", board / "leaderboard.md"]
    return "\n".join(path.read_text(encoding="utf-8") for path in paths)
