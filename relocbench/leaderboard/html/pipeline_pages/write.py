"""Writing the pages of pipelines and what the page of a query loads.

``data/pipelines/SET.js`` holds the tables of a dataset, ``data/located/SET/TASK.js`` the answers to each query, and
``data/candidates/SET/TASK.js`` the keyframes that they were made of, where the dataset is available.
"""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.chosen import kept_rows
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.pages import write_board_page, write_query_page
from relocbench.leaderboard.html.payloads import id_of
from relocbench.leaderboard.html.pipeline_pages.candidates import (
    asked_pipelines,
    candidates_payload,
    chosen_queries,
    thumbnails_of,
    views_of,
)
from relocbench.leaderboard.html.pipeline_pages.payloads import (
    candidates_key,
    id_of_pipelines,
    located_key,
    located_payload,
    pipelines_payload,
)
from relocbench.leaderboard.html.thumbnails import Thumbnail, write_thumbnails
from relocbench.leaderboard.relocalization.board import PipelineBoard, PipelineSetBoard
from relocbench.leaderboard.tracking.model import Board
from relocbench.progress import Reporter


def write_pipeline_pages(
    board: PipelineBoard, tracking: Board | None, site: Path, *, queries: int, reporter: Reporter
) -> set[Path]:
    """Write the page of each dataset's pipelines and that of a query; returns the paths of all files.

    Args:
        tracking: the trackers of the same results, to whose pairs the page of a query links.
        site: the folder of the site.
        queries: in each task, so many worst queries of each pipeline that is no baseline, and so many at random, have
            pictures where the dataset is available.
        reporter: receives the number of pictures that are done.

    Raises:
        PredictionError: rankings or trackers' answers are bad.
        DatasetError: an image of a dataset cannot be read.
    """
    written: set[Path] = set()
    thumbnails: list[Thumbnail] = []
    for asked in board.sets:
        written |= _write_set(board, asked, tracking, site, queries, thumbnails)
    page = site / links.LOCATED_PAGE
    write_query_page(page, "located", "pipelines")
    return written | {page} | write_thumbnails(thumbnails, reporter)


def _write_set(
    board: PipelineBoard,
    asked: PipelineSetBoard,
    tracking: Board | None,
    site: Path,
    count: int,
    thumbnails: list[Thumbnail],
) -> set[Path]:
    of_set = id_of_pipelines(asked)
    payload = pipelines_payload(board, asked, _trackers(asked, tracking))
    key = f"pipelines/{of_set}"
    written = {write_data(site, key, payload)}
    rows = sum(len(rows) for pipeline in asked.methods for rows in pipeline.answers.values())
    for name in payload["tasks"]:
        written.add(write_data(site, located_key(asked, name), located_payload(asked, name)))
        if asked.truth is None:
            continue
        first = next(pipeline.answers[name] for pipeline in asked.methods if name in pipeline.answers)
        times = [answer.query_timestamp_ns for answer in first]
        halves = asked_pipelines(asked.truth, asked.methods, name)
        chosen = chosen_queries(asked.methods, name, count)
        kept = kept_rows(chosen, len(times), rows)
        views = views_of(asked.truth, name, halves, times, chosen)
        told = candidates_payload(asked.truth.truth(name), halves, times, kept, views)
        written.add(write_data(site, candidates_key(asked, name), told))
        thumbnails.extend(thumbnails_of(views, site, of_set))
    page = site / links.relocalization_page(of_set)
    facts = {
        "task": "full pipeline: retrieval, then tracking",
        "fingerprint": asked.record.dataset_fingerprint[:SHORT],
        "tasks": len(asked.record.tasks),
    }
    write_board_page(page, "relocalization", key, asked.title, asked.record.dataset, facts, ("errors", "stages"))
    return written | {page}


def _trackers(asked: PipelineSetBoard, tracking: Board | None) -> dict[str, str]:
    """The tasks that are pair sets of a dataset with results of trackers, and the id of that dataset."""
    if tracking is None:
        return {}
    for dataset in tracking.datasets:
        record = dataset.entry.record
        if (record.name, record.fingerprint) == (asked.record.dataset, asked.record.dataset_fingerprint):
            answered = {name for method in dataset.entry.methods for name in method.errors}
            return {name: id_of(dataset) for name in asked.record.tasks if name in answered}
    return {}
