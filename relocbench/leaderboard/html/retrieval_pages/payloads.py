"""What the page of a retrieval set shows: its tables, and of every query the rank of its first right image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.evaluation.retrieval.records import TaskRecord
from relocbench.evaluation.tables.rows import STATUSES
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import bytes_of, floats
from relocbench.leaderboard.html.query_tables import ANSWER_COLUMNS, columns_payload, table_payload, view_of
from relocbench.leaderboard.html.retrieval_pages.distances import Distances
from relocbench.leaderboard.html.retrieval_pages.lists import KeptLists
from relocbench.leaderboard.retrieval.board import (
    RetrievalBoard,
    RetrievalSetBoard,
    RetrievalTable,
    Retriever,
)
from relocbench.leaderboard.retrieval.columns import CHANCE, PAGE, RetrievalColumn, lines_of, retrieval_columns
from relocbench.leaderboard.retrieval.page import not_above_chance
from relocbench.leaderboard.tracking.marks import made_elsewhere
from relocbench.metrics import chance_recall

RANDOM = "random"
"""the target of the retriever that ranks at random"""
_CURVE_POINTS = 60
"""numbers of images for which the recall of chance is told"""
_LIST = (
    {"key": "task", "title": "task", "kind": "text"},
    {"key": "query", "title": "query", "kind": "link"},
    {"key": "group", "title": "place", "kind": "text", "optional": True},
    {"key": "first", "title": "first right rank", "kind": "rank"},
    {"key": "positives", "title": "right images", "kind": "rank"},
    {"key": "distance_m", "title": "first keyframe, m", "kind": "m", "optional": True},
)


def id_of_places(asked: RetrievalSetBoard) -> str:
    """The id of a retrieval set in links and names of files."""
    return links.set_id(asked.record.name, asked.record.fingerprint)


def ranks_key(asked: RetrievalSetBoard, task: str) -> str:
    """The key of the payload with the ranks of a task's queries."""
    return f"ranks/{id_of_places(asked)}/{links.pair_set_id(task)}"


def lists_key(asked: RetrievalSetBoard, task: str) -> str:
    """The key of the payload with the images that were retrieved for a task's queries."""
    return f"lists/{id_of_places(asked)}/{links.pair_set_id(task)}"


def is_random(method: Retriever) -> bool:
    """Whether a method is the trivial baseline, which ranks at random."""
    return method.run.target == RANDOM


def marks_of_retriever(method: Retriever) -> list[str]:
    """The words behind the name of a retriever."""
    marks = ["trivial baseline"] if is_random(method) else []
    return [*marks, *(["made elsewhere"] if made_elsewhere(method.run) else [])]


def retrieval_payload(board: RetrievalBoard, asked: RetrievalSetBoard) -> dict[str, Any]:
    """All tables of a retrieval set."""
    record, used, columns = asked.record, set(asked.used), retrieval_columns(board)
    return {
        "id": id_of_places(asked),
        "title": asked.title,
        "ranking": board.metric,
        "unit": "query",
        "units": "queries",
        "page": {"file": links.QUERY_PAGE, "task": "task", "unit": "query", "method": "method"},
        "worst": "first",
        "list": [*_LIST, *ANSWER_COLUMNS],
        "columns": columns_payload(columns, view_of(PAGE)),
        "heat": ["query", "gallery"],
        "least_cells": 1,
        "radius_m": radius if isinstance(radius := record.options.get("radius"), float | int) else None,
        "methods": {
            m.label: {"baseline": is_random(m), "competes": not is_random(m), "marks": marks_of_retriever(m)}
            for m in asked.methods
        },
        "tasks": {name: _task(asked, name, record.tasks[name]) for name in record.tasks if name in used},
        "tables": [_table(board, asked, table, columns) for table in asked.tables],
    }


def ranks_payload(
    asked: RetrievalSetBoard, task: str, lists: Mapping[str, KeptLists], distances: Distances | None
) -> dict[str, Any]:
    """The ranks of all methods on the queries of a task.

    Args:
        lists: of each method that has answered it, by label; at least one.
        distances: between the cameras of queries and keyframes; None where they are not known.
    """
    known = {m.label: m for m in asked.methods if m.label in lists}
    record, first = asked.record.tasks[task], next(iter(known.values())).answers[task]
    positives, gallery = [a.positives for a in first], record.gallery - record.junk
    depths = np.unique(np.rint(np.geomspace(1, max(gallery, 1), _CURVE_POINTS)).astype(np.int64)).tolist()
    return {
        "units": {
            "query": [a.query for a in first],
            "group": [a.group for a in first] if record.grouped else None,
            "positives": floats(positives),
        },
        "gallery": gallery,
        "chance": [depths, [round(share, 6) for share in chance_recall(positives, gallery, depths)]],
        "nearest_m": None if distances is None else floats(distances.nearest),
        "methods": {label: _ranks(m, task, lists[label], distances) for label, m in known.items()},
    }


def _task(asked: RetrievalSetBoard, name: str, task: TaskRecord) -> dict[str, Any]:
    return {
        "answers": ranks_key(asked, name),
        "details": lists_key(asked, name),
        "query": _shown_as(task, task.view_query, task.condition_query),
        "gallery": _shown_as(task, task.view_gallery, task.condition_gallery),
        "has_conditions": bool(task.condition_query or task.condition_gallery),
    }


def _shown_as(task: TaskRecord, view: str, condition: str) -> str:
    """Queries or a gallery in words: their condition, and their view where the two differ in it."""
    return ", ".join(filter(None, [view if task.view_query != task.view_gallery else "", condition])) or view


def _table(
    board: RetrievalBoard, asked: RetrievalSetBoard, table: RetrievalTable, columns: Mapping[str, RetrievalColumn]
) -> dict[str, Any]:
    several, without = len(table.tasks) > 1, sum(r.without_positives for r in table.records)
    of = f"Mean over {len(table.tasks)} tasks" if several else table.records[0].direction
    about = f"{of}. {table.queries} queries, {sum(r.gallery for r in table.records)} images in the galler"
    about += "ies." if several else "y."
    if without:
        about += f" {without} queries have no right image in the gallery, and count as not found."
    at_chance = ", ".join(row.method.label for row in table.rows if not_above_chance(board, table, row))
    return table_payload(
        table,
        {"methods": view_of(PAGE)},
        columns,
        [(CHANCE if line.row is None else line.row.method.label, line) for line in lines_of(asked, table)],
        metric=board.metric,
        about=about,
        note=f"No significant gain over chance: {at_chance}" if at_chance else "",
    )


def _ranks(method: Retriever, task: str, lists: KeptLists, distances: Distances | None) -> dict[str, Any]:
    answers = method.answers[task]
    return {
        "first": floats([a.ranks[0] if a.ranks else np.inf for a in answers]),
        "status": bytes_of([STATUSES.index(a.status) for a in answers]),
        "seconds": floats([np.nan if a.seconds is None else a.seconds for a in answers]),
        "distance_m": None if distances is None else floats(_of_first(lists, distances)),
        "depth": lists.depth,
        "messages": {row: answer.message for row, answer in enumerate(answers) if answer.message},
    }


def _of_first(lists: KeptLists, distances: Distances) -> Array:
    """(Q,) metres between each query and the keyframe that was retrieved first; infinite where there is none."""
    return np.array([distances.of(q, keys[0]) if keys else np.inf for q, keys in enumerate(lists.top)])
