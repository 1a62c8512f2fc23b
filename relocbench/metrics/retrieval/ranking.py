"""The positions of a query's positives in the ranking of the gallery, from scores or from ranked lists.

Ties: among equal scores, images that are not positives come first. The rule does not depend on the order of the
gallery, and a method that scores all images equally gains nothing by it.

Failures: an image without a finite score for a query is not retrieved by it. It has no position and precedes no other
image; a positive that is not retrieved still counts among those to be found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.arrays import Indices, Mask
from relocbench.errors import PredictionError
from relocbench.metrics.retrieval.relevance import Relevance

NEVER = np.iinfo(np.int64).max
"""the position of a positive that was not retrieved"""


@dataclass(frozen=True, eq=False)
class Ranking:
    """The 0-based positions of each query's positives in the gallery without junk."""

    starts: Indices
    """(Q + 1,) the positions of query q are ``position[starts[q] : starts[q + 1]]``"""
    position: Indices
    """(M,) ascending for each query; :data:`NEVER` where not retrieved"""
    answered: Mask
    """(Q,) False where nothing at all was retrieved"""
    gallery: int
    """G, junk included"""

    @property
    def queries(self) -> int:
        return len(self.answered)

    @property
    def positives(self) -> Indices:
        """(Q,) the number of positives of each query, retrieved or not."""
        return np.diff(self.starts)

    def of(self, query: int) -> Indices:
        """The positions of one query's positives."""
        return self.position[self.starts[query] : self.starts[query + 1]]


def rank_scores(scores: ArrayLike, relevance: Relevance) -> Ranking:
    """Compute the positions of positives from a matrix of similarities that a method computed itself.

    Args:
        scores: (Q, G), higher is nearer (negate distances); a memory-mapped matrix is read row by row.
        relevance: of these queries in this gallery.

    Raises:
        ValueError: the shapes do not fit.
    """
    matrix = np.asanyarray(scores)
    if matrix.shape != (relevance.queries, relevance.gallery):
        raise ValueError(f"scores must be ({relevance.queries}, {relevance.gallery}), got {matrix.shape}")
    live = np.flatnonzero(~relevance.junk)
    position = np.full(len(relevance.indices), NEVER)
    answered = np.zeros(relevance.queries, dtype=bool)
    for query, row in enumerate(matrix):
        kept = row[live]
        kept = kept[np.isfinite(kept)]
        answered[query] = kept.size > 0
        of_positives = row[relevance.of(query)]
        span = slice(relevance.starts[query], relevance.starts[query + 1])
        position[span] = ranks_of_positives(of_positives, count_at_least(kept, sorted_finite(of_positives)))
    return Ranking(relevance.starts, position, answered, relevance.gallery)


def rank_lists(lists: Sequence[ArrayLike], relevance: Relevance) -> Ranking:
    """Compute the positions of positives from lists of gallery indices, best first, which may be incomplete.

    Args:
        lists: one for each of Q queries; an empty one is a query without an answer. Junk in a list is ignored.
        relevance: of these queries in this gallery.

    Raises:
        PredictionError: a list holds an index that the gallery does not have, or one twice.
        ValueError: the number of lists is not the number of queries.
    """
    if len(lists) != relevance.queries:
        raise ValueError(f"expected {relevance.queries} ranked lists, one a query, got {len(lists)}")
    position = np.full(len(relevance.indices), NEVER)
    answered = np.zeros(relevance.queries, dtype=bool)
    place = np.full(relevance.gallery, NEVER)
    for query, listed in enumerate(lists):
        ranked = _checked_list(listed, query, relevance.gallery)
        ranked = ranked[~relevance.junk[ranked]]
        answered[query] = ranked.size > 0
        place[ranked] = np.arange(len(ranked))
        position[relevance.starts[query] : relevance.starts[query + 1]] = np.sort(place[relevance.of(query)])
        place[ranked] = NEVER
    return Ranking(relevance.starts, position, answered, relevance.gallery)


def sorted_finite(scores: NDArray[Any]) -> NDArray[Any]:
    """The finite values of scores (n,), ascending."""
    return np.sort(scores[np.isfinite(scores)])


def count_at_least(scores: NDArray[Any], thresholds: NDArray[Any]) -> Indices:
    """The number of scores (N,) that are >= each of the ascending thresholds (n,).

    Only the scores above the lowest threshold are sorted, and none for a single threshold.
    """
    if thresholds.size == 0:
        return np.zeros(0, dtype=np.int64)
    above = scores >= thresholds[0]
    if thresholds.size == 1:
        return np.array([np.count_nonzero(above)], dtype=np.int64)
    kept = np.sort(scores[above])
    return (len(kept) - np.searchsorted(kept, thresholds, side="left")).astype(np.int64)


def ranks_of_positives(scores: NDArray[Any], at_least: Indices) -> Indices:
    """The ascending positions of a query's positives.

    Args:
        scores: (n,) of the positives; the m finite ones are retrieved.
        at_least: (m,) the number of images in the gallery without junk, positives included, that score at least as
            much as each of ``sorted_finite(scores)``.

    Returns:
        (n,) the i-th best positive comes after i positives and after all other images that score at least as much;
        :data:`NEVER` for the n - m positives that were not retrieved.
    """
    retrieved = sorted_finite(scores)
    m = len(retrieved)
    others = at_least - (m - np.searchsorted(retrieved, retrieved, side="left"))
    position = np.full(len(scores), NEVER)
    position[:m] = np.arange(m) + others[::-1]
    return position


def _checked_list(listed: ArrayLike, query: int, gallery: int) -> Indices:
    ranked = np.asarray(listed)
    if ranked.size == 0:
        return np.zeros(0, dtype=np.int64)
    if ranked.ndim != 1 or ranked.dtype.kind not in "iu":
        raise PredictionError(f"ranked list of query {query} must hold gallery indices, got {ranked.dtype}")
    outside = ranked[(ranked < 0) | (ranked >= gallery)]
    if outside.size:
        raise PredictionError(f"ranked list of query {query} holds {outside[0]}; expected 0..{gallery - 1}")
    index, times = np.unique(ranked, return_counts=True)
    if np.any(times > 1):
        raise PredictionError(f"ranked list of query {query} holds {index[times > 1][0]} twice; expected each once")
    return ranked.astype(np.int64)
