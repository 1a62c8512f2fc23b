"""From descriptors to what is kept of a task: the first images of each query, and the exact ranks of its positives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.evaluation.retrieval.answers import QueryAnswer
from relocbench.evaluation.retrieval.describe import Described
from relocbench.evaluation.retrieval.handles import RetrieverHandle
from relocbench.metrics import NEVER, count_at_least, exact_scores, ranks_of_positives, sorted_finite
from relocbench.retrieval import Descriptors, RetrievalTask

_BLOCK_BYTES = 64 * 2**20


@dataclass(frozen=True, eq=False)
class Ranked:
    """The ranking of one query."""

    first: Indices
    """gallery indices, best first; among equal scores images that are not positives come first, and among these the one
    that is earlier in the gallery"""
    ranks: tuple[int, ...]
    """1-based ranks of the positives, by the same rule"""
    seconds: float = 0.0
    """of reranking"""
    crash: str = ""


def rank_task(
    task: RetrievalTask,
    queries: Described,
    gallery: Described,
    retriever: RetrieverHandle | None,
    keep: int | None,
    advance: Callable[[int], None] = lambda count: None,
) -> Iterator[tuple[QueryAnswer, list[str]]]:
    """Yield the row and the kept list of each query, in the order of the queries.

    Args:
        retriever: reranks the first images if it can.
        keep: number of images that are kept of each query; None for all.
        advance: called with the number of queries just ranked.
    """
    live = np.flatnonzero(~task.relevance.junk)
    whole = len(live) == len(gallery)
    of_gallery = gallery.values if whole else gallery.values[live]
    if of_gallery.size == 0 or queries.values.shape[1] != of_gallery.shape[1]:
        # One side has no descriptor at all: there are no scores.
        of_gallery, of_queries = np.full((max(len(live), 1), 1), np.nan), np.full((len(queries), 1), np.nan)
    else:
        of_queries = queries.values
    place = np.full(len(gallery), -1)
    place[live] = np.arange(len(live))
    again = retriever if retriever is not None and retriever.rerank_top > 0 else None
    fault = "" if retriever is None else retriever.rerank_fault
    count = len(live) if keep is None else min(keep, len(live))
    block = int(np.clip(_BLOCK_BYTES // (8 * len(of_gallery)), 1, 1024))
    for rows, scores in exact_scores(of_queries, of_gallery, block=block):
        for offset, row in enumerate(scores):
            q = rows.start + offset
            if fault:
                ranked = Ranked(live[:0], (), crash=fault)
            else:
                ranked = _ranked(row, place[task.relevance.of(q)], count, again, of_queries[q], of_gallery)
            yield _answer(task, q, queries, ranked), [task.gallery[i].key for i in live[ranked.first]]
        advance(len(scores))


def _ranked(
    scores: Array,
    positives: Indices,
    count: int,
    again: RetrieverHandle | None,
    query: Descriptors,
    gallery: Descriptors,
) -> Ranked:
    """The ranking of one query from its scores (G,), NaN for images that are not retrieved."""
    top = 0 if again is None else again.rerank_top
    right = np.zeros(len(scores), dtype=bool)
    right[positives] = True
    first = nearest(scores, max(count, top), right)
    if again is None or first.size == 0:
        return Ranked(first[:count], _ranks(scores, positives))
    head = first[:top]
    values, seconds, crash = again.rerank(query, gallery[head])
    if crash:
        return Ranked(first[:0], (), seconds, crash)
    ordered = np.concatenate([head[np.lexsort((right[head], -values))], first[top:]])
    # The reranked images by their new scores come first, and all others follow by the old ones.
    new = np.full(len(scores), np.nan)
    new[head] = values
    rest = scores.copy()
    rest[head] = np.nan
    behind = tuple(rank + len(head) for rank in _ranks(rest, positives))
    return Ranked(ordered[:count], (*_ranks(new, positives), *behind), seconds)


def nearest(scores: Array, count: int, last: Mask) -> Indices:
    """The indices of the ``count`` largest finite scores (G,), best first.

    Of equal scores those that are ``last`` (G,) come last; others are in the order of the indices.
    """
    known = np.flatnonzero(np.isfinite(scores))
    if len(known) > count > 0:
        threshold = np.partition(scores[known], len(known) - count)[len(known) - count]
        known = known[scores[known] >= threshold]
    return known[np.lexsort((last[known], -scores[known]))][:count].astype(np.int64)


def _ranks(scores: Array, positives: Indices) -> tuple[int, ...]:
    of_positives = scores[positives]
    at_least = count_at_least(scores[np.isfinite(scores)], sorted_finite(of_positives))
    return tuple(int(r) + 1 for r in ranks_of_positives(of_positives, at_least) if r != NEVER)


def _answer(task: RetrievalTask, q: int, queries: Described, ranked: Ranked) -> QueryAnswer:
    message = queries.messages[q] or ranked.crash
    if message:
        status = "error"
    elif not np.isfinite(queries.values[q]).all():
        status, message = "failed", "no descriptor"
    elif ranked.first.size == 0:
        status, message = "failed", "nothing in the gallery has a descriptor"
    else:
        status = "ok"
    return QueryAnswer(
        query=task.queries[q].key,
        group=task.groups[q] if task.groups else "",
        status=status,
        positives=int(task.relevance.starts[q + 1] - task.relevance.starts[q]),
        ranks=ranked.ranks,
        seconds=float(queries.seconds[q]) + ranked.seconds,
        message=message,
    )
