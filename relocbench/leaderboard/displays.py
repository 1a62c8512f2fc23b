"""How boards of retrievers and of pipelines are shown, in CSV, JSON, Markdown, LaTeX and on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Generic, TypeVar

from relocbench.files import remove_parts, write_text
from relocbench.leaderboard.common.by_query import Board, SetBoard, Table
from relocbench.leaderboard.common.cards import write_cards
from relocbench.leaderboard.common.columns import Column, records
from relocbench.leaderboard.common.latex import LatexTable, document
from relocbench.leaderboard.common.over_datasets import over_latex, over_records
from relocbench.leaderboard.common.text import METHOD, RANK, RETRIEVER, TOP, TRACKER, Value, write_records
from relocbench.leaderboard.relocalization import columns as of_pipelines
from relocbench.leaderboard.relocalization.board import PipelineBoard
from relocbench.leaderboard.relocalization.page import relocalization_page
from relocbench.leaderboard.retrieval import columns as of_retrievers
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.retrieval.page import retrieval_page

B = TypeVar("B", bound=Board[Any, Any, Any, Any])
L = TypeVar("L")


@dataclass(frozen=True)
class Display(Generic[B, L]):
    """How the boards of one task are shown."""

    name: str
    """of its files and of its rows in JSON"""
    columns: Callable[[B], Mapping[str, Column[L]]]
    """all columns by their keys, in the order of CSV"""
    lines: Callable[[Any, Any], Sequence[L]]
    """of a table of a set"""
    terminal: Callable[[B], Sequence[str]]
    """the columns on the terminal"""
    page: Callable[[B], str]
    names: tuple[str, ...]
    """the columns that name a method"""
    paper: Callable[[B], Iterable[str]]
    """the columns of numbers in LaTeX"""
    competes: Callable[[L], bool]
    """whether values of a line may be the best of a table"""
    note: str = ""
    """what the caption says besides the number of queries"""

    def records(self, board: B) -> list[dict[str, Value]]:
        """The rows of CSV and JSON: shares 0..1, metres, degrees, seconds; None where there is no value."""
        lines = [line for of in board.sets for table in of.tables for line in self.lines(of, table)]
        return records(self.columns(board).values(), lines)

    def texts(self, board: B, of: SetBoard[Any, Any, Any, Any], table: Table[Any, Any]) -> list[list[str]]:
        """The cells of a table on the terminal."""
        columns = self.columns(board)
        keys = self.terminal(board)
        return [[columns[key].text(line, bounds=False) for key in keys] for line in self.lines(of, table)]

    def latex(self, board: B) -> str:
        """All tables in LaTeX, that over all sets first, then means over several tasks."""
        columns = self.columns(board)
        of_sets = (
            LatexTable(
                of=of.title,
                place=table.name,
                names=[columns[key] for key in self.names],
                rank=columns[RANK],
                columns=[columns[key] for key in dict.fromkeys(self.paper(board))],
                lines=self.lines(of, table),
                competes=self.competes,
                metric=board.metric,
                note=f"{table.queries} queries{self.note}.",
            )
            for of in board.sets
            for table in of.means_first
        )
        return document(chain(map(over_latex, board.over), of_sets))

    def write_table(self, board: B, out: Path) -> list[Path]:
        """Write the tables in CSV, that over all sets where there are several; returns the files."""
        remove_parts(out, deep=False)
        tables = {f"{self.name}.csv": self.records(board), f"{self.name}_datasets.csv": over_records(board.over)}
        kept = {out / name: rows for name, rows in tables.items() if rows or not name.endswith("_datasets.csv")}
        for path, rows in kept.items():
            write_records(path, rows)
        return list(kept)

    def write_page(self, board: B, out: Path) -> list[Path]:
        """Write the page in Markdown and the cards that it links; returns the files."""
        remove_parts(out, deep=False)
        cards = [path for of in board.sets for path in write_cards(out, of.title, of.methods)]
        write_text(out / f"{self.name}.md", self.page(board))
        return [*cards, out / f"{self.name}.md"]


RETRIEVAL: Display[RetrievalBoard, of_retrievers.RetrievalLine] = Display(
    "retrieval",
    of_retrievers.retrieval_columns,
    of_retrievers.lines_of,
    of_retrievers.terminal_columns,
    retrieval_page,
    (METHOD,),
    of_retrievers.paper_columns,
    lambda line: line.row is not None and not line.row.method.is_baseline,
)
RELOCALIZATION: Display[PipelineBoard, of_pipelines.PipelineLine] = Display(
    "relocalization",
    of_pipelines.pipeline_columns,
    of_pipelines.lines_of,
    of_pipelines.terminal_columns,
    relocalization_page,
    (RETRIEVER, TRACKER, TOP),
    of_pipelines.paper_columns,
    of_pipelines.competes,
    f"; {TOP} is the number of keyframes that are tried",
)
