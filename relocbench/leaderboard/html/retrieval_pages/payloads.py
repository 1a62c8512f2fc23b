"""What the page of a retrieval set shows: its tables, and of every query the rank of its first right image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.evaluation.common.tables import STATUSES
from relocbench.evaluation.retrieval.records import METRICS, TaskRecord
from relocbench.leaderboard.common.headings import SECONDS, heading
from relocbench.leaderboard.common.ranks import rank_text, why_no_ranks
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import bytes_of, floats, integers
from relocbench.leaderboard.html.retrieval_pages.distances import Distances
from relocbench.leaderboard.html.retrieval_pages.lists import KeptLists
from relocbench.leaderboard.retrieval.board import (
    RetrievalBoard,
    RetrievalRow,
    RetrievalSetBoard,
    RetrievalTable,
    Retriever,
    chance_of,
    rescored_text,
)
from relocbench.leaderboard.retrieval.page import not_above_chance
from relocbench.leaderboard.tracking.marks import made_elsewhere

RANDOM = "random"
"""the target of the retriever that ranks at random"""
_CURVE_POINTS = 60
"""numbers of images for which the recall of chance is told"""


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
    record, names, used = asked.record, list(METRICS), set(asked.used)
    return {
        "id": id_of_places(asked),
        "title": asked.title,
        "ranking": board.metric,
        "radius_m": radius if isinstance(radius := record.options.get("radius"), float | int) else None,
        "metrics": [{"name": name, "heading": heading(name), "unit": "share"} for name in names],
        "methods": {m.label: {"baseline": is_random(m), "marks": marks_of_retriever(m)} for m in asked.methods},
        "tasks": {name: _task(asked, name, record.tasks[name]) for name in record.tasks if name in used},
        "tables": [_table(board, table, names) for table in asked.tables],
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
    depths, chance = _chance_curve([a.positives for a in first], record.gallery - record.junk)
    return {
        "queries": [a.query for a in first],
        "groups": [a.group for a in first] if record.grouped else None,
        "positives": integers([a.positives for a in first]),
        "gallery": record.gallery - record.junk,
        "chance": [depths, chance],
        "nearest_m": None if distances is None else floats(distances.nearest),
        "methods": {label: _ranks(m, task, lists[label], distances) for label, m in known.items()},
    }


def _task(asked: RetrievalSetBoard, name: str, task: TaskRecord) -> dict[str, Any]:
    return {
        "ranks": ranks_key(asked, name),
        "lists": lists_key(asked, name),
        "direction": task.direction,
        "query": _shown_as(task, task.view_query, task.condition_query),
        "gallery": _shown_as(task, task.view_gallery, task.condition_gallery),
        "has_conditions": bool(task.condition_query or task.condition_gallery),
    }


def _shown_as(task: TaskRecord, view: str, condition: str) -> str:
    """Queries or a gallery in words: their condition, and their view where the two differ in it."""
    return ", ".join(filter(None, [view if task.view_query != task.view_gallery else "", condition])) or view


def _table(board: RetrievalBoard, table: RetrievalTable, names: Sequence[str]) -> dict[str, Any]:
    return {
        "title": table.name,
        "tasks": list(table.tasks),
        "queries": table.queries,
        "gallery": sum(r.gallery for r in table.records),
        "without_positives": sum(r.without_positives for r in table.records),
        "ranks": why_no_ranks(table.rows, board.metric, f"{table.queries} queries"),
        "at_chance": [row.method.label for row in table.rows if not_above_chance(board, table, row)],
        "chance": [chance_of(table).get(name) for name in names],
        "rows": [_row(row, table, names) for row in table.rows],
    }


def _row(row: RetrievalRow, table: RetrievalTable, names: Sequence[str]) -> dict[str, Any]:
    return {
        "method": row.method.label,
        "rank": rank_text(row, table.rows),
        "values": [row.values.get(name) for name in names],
        "intervals": {n: [i.low, i.high] for n in names if (i := row.intervals.get(n)) is not None},
        "seconds": row.values.get(SECONDS),
        "failed": row.failed,
        "broke": row.broke,
        "rescored": "" if row.missing else rescored_text(row, table),
        "missing": list(row.missing),
    }


def _ranks(method: Retriever, task: str, lists: KeptLists, distances: Distances | None) -> dict[str, Any]:
    answers = method.answers[task]
    return {
        "first": integers([a.ranks[0] if a.ranks else 0 for a in answers]),
        "status": bytes_of([STATUSES.index(a.status) for a in answers]),
        "seconds": floats([np.nan if a.seconds is None else a.seconds for a in answers]),
        "distance_m": None if distances is None else floats(_of_first(lists, distances)),
        "depth": lists.depth,
    }


def _of_first(lists: KeptLists, distances: Distances) -> Array:
    """(Q,) metres between each query and the keyframe that was retrieved first; infinite where there is none."""
    return np.array([distances.of(q, keys[0]) if keys else np.inf for q, keys in enumerate(lists.top)])


def _chance_curve(positives: Sequence[int], gallery: int) -> tuple[list[int], list[float]]:
    """Some numbers of images K, and the recall@K of a gallery in random order: ``1 - C(G - n, K) / C(G, K)``."""
    if gallery < 1:
        return [], []
    depths = np.unique(np.rint(np.geomspace(1, gallery, _CURVE_POINTS)).astype(np.int64))
    counts, queries = np.unique(np.asarray(positives, dtype=np.int64), return_counts=True)
    recall = np.zeros(len(depths))
    for count, number in zip(counts, queries, strict=True):
        place = np.arange(gallery)
        missed = np.cumprod(np.maximum(gallery - count - place, 0) / (gallery - place))
        recall += number * (1.0 - missed[depths - 1])
    return depths.tolist(), [round(float(value), 6) for value in recall / max(len(positives), 1)]
