"""What the start page and the pages of methods have of retrievers, and of pipelines of a retriever and a tracker."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.common.text import json_text
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.looks import looks
from relocbench.leaderboard.html.pipeline_pages.payloads import is_keyframe_pose
from relocbench.leaderboard.html.retrieval_pages.payloads import id_of_places, is_random, marks_of_retriever
from relocbench.leaderboard.html.rows import pipeline_line, retriever_line
from relocbench.leaderboard.relocalization.board import PipelineBoard, PipelineSetBoard
from relocbench.leaderboard.retrieval.board import RetrievalBoard, RetrievalSetBoard, Retriever
from relocbench.leaderboard.retrieval.page import evaluate_command
from relocbench.leaderboard.tracking.method import machine_words


def with_other_tasks(payload: Mapping[str, Any], boards: Boards) -> dict[str, Any]:
    """What every page knows, with the looks of retrievers and pipelines, and the pages of retrievers.

    Each task draws from the same colours, so that those of trackers do not depend on what else was evaluated; a
    retriever that is called as a tracker looks as that one does.
    """
    retrievers = [m for asked in _sets(boards.retrieval) for m in asked.methods]
    pipelines = [c for asked in _pipelines(boards.relocalization) for c in asked.methods]
    labels = {m.label for m in retrievers}
    added = looks({c.label for c in pipelines}, {c.label for c in pipelines if is_keyframe_pose(c)})
    added |= looks(labels, {m.label for m in retrievers if is_random(m)})
    pages = {label: links.method_page(label) for label in sorted(labels)}
    return {**payload, "looks": {**added, **payload["looks"]}, "pages": {**pages, **payload["pages"]}}


def retriever_labels(boards: Boards) -> list[str]:
    """The labels of all retrievers, sorted."""
    return sorted({m.label for asked in _sets(boards.retrieval) for m in asked.methods})


def results_of(label: str, boards: Boards) -> dict[str, Any]:
    """What the page of a method has besides its results as a tracker: those as a retriever, and in pipelines."""
    retrieval = boards.retrieval
    own = [(asked, m) for asked in _sets(retrieval) for m in asked.methods if m.label == label]
    in_pipelines = [
        pipeline_line(board, asked, table, row)
        for board in ([boards.relocalization] if boards.relocalization is not None else [])
        for asked in board.sets
        for table in asked.tables
        for row in table.rows
        if label in (row.method.run.retriever, row.method.run.tracker)
    ]
    rows = [
        retriever_line(retrieval, asked, table, row)
        for asked in _sets(retrieval)
        for table in asked.tables
        for row in table.rows
        if retrieval is not None and row.method.label == label
    ]
    return {
        "retrieval_marks": list(dict.fromkeys(mark for _, m in own for mark in marks_of_retriever(m))),
        "retrieval_metric": None if retrieval is None else retrieval.metric,
        "retrieved": rows,
        "retrieval_runs": [_run(asked, m) for asked, m in own],
        "pipeline_metric": None if boards.relocalization is None else boards.relocalization.metric,
        "pipelines": in_pipelines,
    }


def _sets(board: RetrievalBoard | None) -> Iterable[RetrievalSetBoard]:
    return () if board is None else board.sets


def _pipelines(board: PipelineBoard | None) -> Iterable[PipelineSetBoard]:
    return () if board is None else board.sets


def _run(asked: RetrievalSetBoard, method: Retriever) -> dict[str, Any]:
    run = method.run
    return {
        "title": asked.title,
        "page": links.retrieval_page(id_of_places(asked)),
        "facts": [
            ("target", run.target),
            ("parameters", json_text(run.parameters)),
            ("versions", json_text(run.versions)),
            ("machine", machine_words(run) or "not recorded"),
            *([("files", json_text(run.files))] if run.files else []),
            *([("what it tells of itself", json_text(run.info))] if run.info else []),
        ],
        "missing": sorted(set(asked.used) - method.answers.keys()),
        "command": evaluate_command(asked.record, run),
    }
