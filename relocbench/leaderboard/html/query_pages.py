"""The pages of tasks that are asked by queries: one way to write those of retrievers and those of pipelines.

``data/TABLES/SET.js`` holds the tables of a set, ``data/ANSWERS/SET/TASK.js`` what methods answered to each query, and
``data/DETAILS/SET/TASK.js`` what else the page of a query shows; each task has its own names for these folders.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Generic, Protocol

from numpy.typing import ArrayLike

from relocbench.leaderboard.common.by_query import Board, M, S, SetBoard, T, Table, U
from relocbench.leaderboard.common.model import Row
from relocbench.leaderboard.displays import Display
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.chosen import kept_rows, worst_and_drawn
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.pages import write_page
from relocbench.leaderboard.html.thumbnails import Thumbnail, write_thumbnails
from relocbench.metrics import CORRECT
from relocbench.progress import Reporter
from relocbench.retrieval import ImageView


class Queries(Protocol):
    """The queries of one task, with what its methods answered."""

    def answers(self) -> dict[str, Any]:
        """The payload of all answers."""
        ...

    def how_bad(self) -> Sequence[ArrayLike]:
        """(Q,) how bad each answer of a method is, for every method that is no trivial baseline."""
        ...

    def details(self, kept: Sequence[int], chosen: Sequence[int]) -> dict[str, Any] | None:
        """The payload of what the page of a query shows besides; None where it needs a dataset that is not available.

        Args:
            kept: indices of the queries that the payload holds, ascending.
            chosen: those of them that have pictures.
        """
        ...

    def views(self, chosen: Sequence[int]) -> Iterable[ImageView]:
        """The images that the pages of these queries show; none where the dataset is not available."""
        ...


class QueryPages(ABC, Generic[S, U, M, T]):
    """What the site has of one task: the names of its pages and payloads, and what these hold."""

    display: Display[Any, Any]
    title: str
    """of its table on the start page"""
    page: str
    """the first part of the names of the pages of sets"""
    charts: tuple[str, ...]
    """the scripts of these pages' charts"""
    query_page: str
    folders: tuple[str, str, str]
    """of the payloads of tables, answers and details"""
    has_method_pages: bool

    @abstractmethod
    def payload(self, board: Board[S, U, M, T], of: SetBoard[S, U, M, T]) -> dict[str, Any]:
        """All tables of a set."""

    @abstractmethod
    def queries(self, of: SetBoard[S, U, M, T], task: str) -> Queries:
        """The queries of a task that some method has answered."""

    @abstractmethod
    def facts(self, of: SetBoard[S, U, M, T]) -> dict[str, object]:
        """What stands below the heading of the page of a set."""

    @abstractmethod
    def is_baseline(self, method: M) -> bool:
        """Whether a method is a trivial baseline."""

    @abstractmethod
    def marks(self, row: Row[M], table: Table[M, U]) -> list[str]:
        """The words behind the name of a method."""

    @abstractmethod
    def involves(self, method: M, label: str) -> bool:
        """Whether a row stands on the page of the method with that label."""

    def name(self, of: SetBoard[S, U, M, T]) -> str:
        """The heading of the page of a set."""
        return of.record.name

    def note(self, board: Board[S, U, M, T], table: Table[M, U]) -> str:
        """A sentence without its full stop for below a table, besides why there are no ranks; empty for none."""
        return ""

    def is_first(self, table: Table[M, U]) -> bool:
        """Whether a reader looks at a table first, where there are means over several tasks."""
        return table.name.startswith("mean ")


def write_query_pages(
    pages: QueryPages[S, U, M, T], board: Board[S, U, M, T], site: Path, *, queries: int, reporter: Reporter
) -> set[Path]:
    """Write the page of each set of a board and that of a query; returns the paths of all files.

    Args:
        site: the folder of the site.
        queries: in each task, so many worst queries of each method that is no trivial baseline, and so many drawn at
            random, have pictures where the dataset is available.
        reporter: receives the number of pictures that are done.

    Raises:
        PredictionError: a file of the results is bad.
        DatasetError: an image of a dataset cannot be read.
    """
    written = {site / pages.query_page}
    write_page(site / pages.query_page, "query.html.j2", page=Path(pages.query_page).stem, sets=pages.folders[0])
    thumbnails: list[Thumbnail] = []
    for of in board.sets:
        written |= _write_set(pages, board, of, site, queries, thumbnails)
    return written | write_thumbnails(thumbnails, reporter)


def _write_set(
    pages: QueryPages[S, U, M, T],
    board: Board[S, U, M, T],
    of: SetBoard[S, U, M, T],
    site: Path,
    count: int,
    thumbnails: list[Thumbnail],
) -> set[Path]:
    of_set = links.set_id(of.record)
    tables, answers, details = pages.folders
    key = f"{tables}/{of_set}"
    written = {write_data(site, key, pages.payload(board, of))}
    rows = sum(len(answers) for method in of.methods for answers in method.answers.values())
    for name in of.used:
        queries = pages.queries(of, name)
        written.add(write_data(site, links.unit_key(answers, of.record, name), queries.answers()))
        chosen = worst_and_drawn(queries.how_bad(), of.units[name].queries, count)
        payload = queries.details(kept_rows(chosen, of.units[name].queries, rows), chosen)
        if payload is not None:
            written.add(write_data(site, links.unit_key(details, of.record, name), payload))
        thumbnails += [Thumbnail(site, of_set, view) for view in queries.views(chosen)]
    page = site / links.set_page(of.record, pages.page)
    facts = pages.facts(of).items()
    values = {"key": key, "title": of.title, "name": pages.name(of), "facts": facts, "charts": pages.charts}
    write_page(page, "query_board.html.j2", page=pages.page, correct=CORRECT, **values)
    return written | {page}
