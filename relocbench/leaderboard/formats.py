"""In which formats a leaderboard is written. One more is one more line of :data:`FORMATS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from relocbench.errors import ConfigError, quoted
from relocbench.files import write_text
from relocbench.leaderboard.relocalization import latex as chain_latex
from relocbench.leaderboard.relocalization.board import ChainBoard
from relocbench.leaderboard.relocalization.write import write_chain_page, write_chain_table
from relocbench.leaderboard.retrieval import latex as retrieval_latex
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.retrieval.write import write_retrieval_page, write_retrieval_table
from relocbench.leaderboard.tracking import latex as tracking_latex
from relocbench.leaderboard.tracking.model import Board
from relocbench.leaderboard.tracking.write import write_pages, write_tables
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class Boards:
    """What there is to write; None where a results folder holds nothing of a task."""

    tracking: Board | None = None
    retrieval: RetrievalBoard | None = None
    chains: ChainBoard | None = None


Writer = Callable[[Boards, Path, bool, Reporter], list[Path]]
"""writes boards into a folder, with or without plots, and returns the files"""


def _csv(boards: Boards, out: Path, plots: bool, reporter: Reporter) -> list[Path]:
    files = [] if boards.tracking is None else write_tables(boards.tracking, out)
    files += [] if boards.retrieval is None else write_retrieval_table(boards.retrieval, out)
    return files + ([] if boards.chains is None else write_chain_table(boards.chains, out))


def _markdown(boards: Boards, out: Path, plots: bool, reporter: Reporter) -> list[Path]:
    files = [] if boards.tracking is None else write_pages(boards.tracking, out, plots=plots, reporter=reporter)
    files += [] if boards.retrieval is None else write_retrieval_page(boards.retrieval, out)
    return files + ([] if boards.chains is None else write_chain_page(boards.chains, out))


def _latex(boards: Boards, out: Path, plots: bool, reporter: Reporter) -> list[Path]:
    texts = {
        "leaderboard.tex": None if boards.tracking is None else tracking_latex.latex_page(boards.tracking),
        "retrieval.tex": None if boards.retrieval is None else retrieval_latex.latex_page(boards.retrieval),
        "relocalization.tex": None if boards.chains is None else chain_latex.latex_page(boards.chains),
    }
    files = []
    for name, text in texts.items():
        if text is not None:
            files.append(out / name)
            write_text(files[-1], text)
    return files


FORMATS: Mapping[str, Writer] = MappingProxyType({"csv": _csv, "markdown": _markdown, "latex": _latex})
"""name of a format -> what writes it"""
USUAL = ("csv", "markdown")
"""the formats that are written unless others are asked for"""


def check_formats(names: Sequence[str]) -> tuple[str, ...]:
    """The formats without repetition, or the usual ones where none is named. Raises ConfigError for an unknown one."""
    for name in names:
        if name not in FORMATS:
            raise ConfigError(f"--format is one of {', '.join(FORMATS)}, got {quoted(name)}")
    return tuple(dict.fromkeys(names)) or USUAL


def write_formats(
    boards: Boards, out: Path, formats: Sequence[str], *, plots: bool = True, reporter: Reporter
) -> list[Path]:
    """Write boards in these formats; returns the files. Each appears whole or not at all, and none holds a date."""
    return [path for name in formats for path in FORMATS[name](boards, out, plots, reporter)]
