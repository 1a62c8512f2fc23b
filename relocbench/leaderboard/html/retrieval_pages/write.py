"""Writing the pages of retrieval sets and what the page of a query loads.

``data/retrieval/SET.js`` holds the tables of a set, ``data/ranks/SET/TASK.js`` the ranks of each query, from which
curves are drawn, and ``data/lists/SET/TASK.js`` the first images of each query.
"""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.chosen import kept_rows
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.pages import write_board_page, write_query_page
from relocbench.leaderboard.html.retrieval_pages.distances import distances_of
from relocbench.leaderboard.html.retrieval_pages.lists import kept_lists, task_of
from relocbench.leaderboard.html.retrieval_pages.payloads import (
    id_of_places,
    lists_key,
    ranks_key,
    ranks_payload,
    retrieval_payload,
)
from relocbench.leaderboard.html.retrieval_pages.queries import (
    chosen_queries,
    lists_payload,
    thumbnails_of,
)
from relocbench.leaderboard.html.thumbnails import Thumbnail, write_thumbnails
from relocbench.leaderboard.retrieval.board import RetrievalBoard, RetrievalSetBoard
from relocbench.progress import Reporter


def write_retrieval_pages(board: RetrievalBoard, site: Path, *, queries: int, reporter: Reporter) -> set[Path]:
    """Write the page of each set of a board and that of a query; returns the paths of all files.

    Args:
        site: the folder of the site.
        queries: in each task, so many worst queries of each method that is no trivial baseline, and so many drawn at
            random, have pictures where the dataset is available.
        reporter: receives the number of pictures that are done.

    Raises:
        PredictionError: a list of retrieved images is bad.
        DatasetError: an image of a dataset cannot be read.
    """
    written: set[Path] = set()
    thumbnails: list[Thumbnail] = []
    for asked in board.sets:
        written |= _write_set(board, asked, site, queries, thumbnails)
    page = site / links.QUERY_PAGE
    write_query_page(page, "query", "retrieval")
    return written | {page} | write_thumbnails(thumbnails, reporter)


def _write_set(
    board: RetrievalBoard, asked: RetrievalSetBoard, site: Path, count: int, thumbnails: list[Thumbnail]
) -> set[Path]:
    of_set = id_of_places(asked)
    key = f"retrieval/{of_set}"
    written = {write_data(site, key, retrieval_payload(board, asked))}
    names = asked.used
    rows = sum(len(rows) for m in asked.methods for rows in m.answers.values())
    for name in names:
        methods = [m for m in asked.methods if name in m.answers]
        distances = distances_of(asked.truth, name)
        lists = {m.label: kept_lists(asked, m, name) for m in methods}
        written.add(write_data(site, ranks_key(asked, name), ranks_payload(asked, name, lists, distances)))
        chosen = chosen_queries(methods, name, count)
        kept = kept_rows(chosen, asked.record.tasks[name].queries, rows)
        payload = lists_payload(asked, name, lists, kept, chosen, distances)
        written.add(write_data(site, lists_key(asked, name), payload))
        task = task_of(asked, name)
        if task is not None:
            thumbnails.extend(thumbnails_of(task, lists, chosen, distances, site, of_set))
    page = site / links.retrieval_page(of_set)
    facts = {
        "task": "retrieval",
        "fingerprint": asked.record.fingerprint[:SHORT],
        **({"right are": asked.record.positives} if asked.record.positives else {}),
        "tasks": len(names),
    }
    write_board_page(page, "retrieval", key, asked.title, asked.record.name, facts, ("recall",))
    return written | {page}
