"""Retrieval metrics by their formulas: recall at K, average precision, reciprocal rank.

For a query with n positives, at the 0-based positions r_0 < r_1 < ... of the ranking without junk:

- ``R@K``: 1 where r_0 < K.
- ``R@top1%``: 1 where r_0 <= round(0.01 G), as the authors of University-1652 index their cumulative match
  curve (Zheng, Wei and Yang, ACM MM 2020); G counts the whole gallery.
- ``AP``: ``1/n sum_i 1/2 (old_i + (i+1)/(r_i+1))`` with ``old_i = i/r_i``, 1 where r_i = 0: trapezoids under
  precision against recall (Philbin et al., the Oxford buildings benchmark, CVPR 2007).
- ``AP_rectangle``: ``1/n sum_i (i+1)/(r_i+1)``, which others call AP; it is never smaller than ``AP``.
- ``MRR``: ``1/(r_0+1)``.

A positive that was not retrieved adds 0 but counts in n. A query without positives has the value 0 in every metric.
With a single positive AP = (R@1 + MRR) / 2.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices, Mask
from relocbench.errors import ConfigError, DatasetError
from relocbench.metrics.retrieval.ranking import NEVER, Ranking

RETRIEVAL_METRICS: tuple[str, ...] = ("R@1", "R@5", "R@10", "R@top1%", "AP", "AP_rectangle", "MRR")
"""metrics of label sets such as University-1652, in the order in which tables show them"""
PLACE_METRICS: tuple[str, ...] = ("R@1", "R@5", "R@10", "R@20")
"""metrics of place recognition"""
_RECALL = re.compile(r"R@([1-9][0-9]*)")


class Denominator(StrEnum):
    """The queries that a mean is taken over."""

    ALL = "all queries"
    """a query without positives counts as not found"""
    WITH_POSITIVES = "queries with positives"


def recall_depth(metric: str) -> int | None:
    """The K of a metric ``R@K``; None for other metrics."""
    recall = _RECALL.fullmatch(metric)
    return None if recall is None else int(recall[1])


def unknown_metric(metric: str) -> ConfigError:
    """The error for a name that no metric has."""
    return ConfigError(f"unknown retrieval metric '{metric}'; expected R@K, R@top1%, AP, AP_rectangle or MRR")


@dataclass(frozen=True, eq=False)
class RetrievalScores:
    """The scores of each of Q queries, 0..1, in the order of the queries."""

    first: Indices
    """(Q,) 0-based position of the first positive; :data:`NEVER` where none was retrieved"""
    average_precision: Array
    """(Q,) average precision by trapezoids"""
    average_precision_rectangle: Array
    """(Q,) average precision by rectangles"""
    positives: Indices
    """(Q,) number of positives of each query, retrieved or not"""
    answered: Mask
    """(Q,) False where nothing at all was retrieved"""
    gallery: int
    """G, the size of the gallery, junk included"""

    def __len__(self) -> int:
        return len(self.first)

    @property
    def top1_index(self) -> int:
        """The 0-based position of ``R@top1%``."""
        return round(0.01 * self.gallery)

    def per_query(self, metric: str) -> Array:
        """(Q,) values of a metric, 0..1, whose plain mean over all queries is the metric.

        Raises:
            ConfigError: no metric has that name.
        """
        k = recall_depth(metric)
        if k is not None:
            out: Array = ((self.first != NEVER) & (self.first < k)).astype(np.float64)
            return out
        match metric:
            case "R@top1%":
                return (self.first <= self.top1_index).astype(np.float64)
            case "AP":
                return self.average_precision
            case "AP_rectangle":
                return self.average_precision_rectangle
            case "MRR":
                return np.where(self.first == NEVER, 0.0, 1.0 / (np.minimum(self.first, NEVER - 1) + 1.0))
        raise unknown_metric(metric)


@dataclass(frozen=True)
class RetrievalSummary:
    """The metrics of one retriever on one query set, with the number of queries that they average over."""

    queries: int
    """number of all queries"""
    without_positives: int
    unanswered: int
    """queries for which nothing at all was retrieved, whether or not they have positives"""
    denominator: Denominator
    counted: int
    """number of queries that each mean is over"""
    gallery: int
    """number of images, junk included"""
    values: Mapping[str, float]
    """by metric name, 0..1"""

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def to_dict(self) -> dict[str, Any]:
        """The counts, the denominator by name and every metric as one flat mapping."""
        counts = {"queries": self.queries, "without_positives": self.without_positives, "unanswered": self.unanswered}
        over = {"denominator": str(self.denominator), "counted": self.counted, "gallery": self.gallery}
        return {**counts, **over, **self.values}


def score_retrieval(ranking: Ranking) -> RetrievalScores:
    """Score every query from the positions of its positives."""
    n = ranking.positives
    query = np.repeat(np.arange(ranking.queries), n)
    i = np.arange(len(query)) - ranking.starts[:-1][query]
    found = ranking.position != NEVER
    query, i, r = query[found], i[found], ranking.position[found]
    precision = (i + 1) / (r + 1)
    before = np.where(r > 0, i / np.maximum(r, 1), 1.0)
    first = np.full(ranking.queries, NEVER)
    some = n > 0
    first[some] = ranking.position[ranking.starts[:-1][some]]

    def mean_over_positives(values: Array) -> Array:
        total = np.bincount(query, weights=values, minlength=ranking.queries).astype(np.float64)
        return total / np.maximum(n, 1)

    return RetrievalScores(
        first=first,
        average_precision=mean_over_positives((before + precision) / 2),
        average_precision_rectangle=mean_over_positives(precision),
        positives=n,
        answered=ranking.answered,
        gallery=ranking.gallery,
    )


def summarize_retrieval(
    scores: RetrievalScores,
    metrics: Sequence[str] = RETRIEVAL_METRICS,
    *,
    denominator: Denominator = Denominator.ALL,
) -> RetrievalSummary:
    """The mean of each metric over the queries.

    Args:
        scores: of every query.
        metrics: names from the module's list, or R@K for any K.
        denominator: whether means are over all queries or over those that have positives.

    Raises:
        ConfigError: an unknown metric.
        DatasetError: there is no query to take a mean over.
    """
    counted = np.ones(len(scores), dtype=bool) if denominator is Denominator.ALL else scores.positives > 0
    if not counted.any():
        raise DatasetError(f"none of {len(scores)} queries has a positive in the gallery; expected at least one")
    return RetrievalSummary(
        queries=len(scores),
        without_positives=int(np.sum(scores.positives == 0)),
        unanswered=int(np.sum(~scores.answered)),
        denominator=denominator,
        counted=int(counted.sum()),
        gallery=scores.gallery,
        values={name: float(np.mean(scores.per_query(name)[counted])) for name in metrics},
    )


def per_group(values: ArrayLike, groups: ArrayLike) -> Array:
    """One value for each group of queries, whose plain mean is the mean over all queries, for intervals.

    Queries of one building or one place are not independent, but groups are:
    ``mean_interval([per_group(scores.per_query("AP"), labels)], independent=True)``. Queries along a drive need no
    groups: intervals count how many independent ones they are worth.

    Args:
        values: (Q,) a metric's values.
        groups: (Q,) the group of each query, by number or name.

    Returns:
        (H,) ``H / Q`` times the sum over each group, in the order of the sorted groups.

    Raises:
        ValueError: the shapes do not fit.
    """
    v, g = np.asarray(values, dtype=np.float64), np.asarray(groups)
    if v.ndim != 1 or v.size == 0 or v.shape != g.shape:
        raise ValueError(f"values and groups must be non-empty (Q,) arrays of one length, got {v.shape} and {g.shape}")
    names, of_group = np.unique(g, return_inverse=True)
    return np.bincount(of_group, weights=v).astype(np.float64) * (len(names) / len(v))
