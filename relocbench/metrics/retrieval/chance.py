"""The chance level: what a gallery in random order scores on average. A retriever below it has learnt nothing.

For a query with n positives in a gallery of G images (junk removed), all orders being equally likely:

- ``R@K``: ``1 - C(G - n, K) / C(G, K)``,
- ``MRR``: ``sum_r P(r_0 = r) / (r + 1)`` with ``P(r_0 = r) = n / (G - r) prod_{j < r} (1 - n / (G - j))``,
- ``AP``: position r holds a positive with probability n / G, and ``r (n - 1) / (G - 1)`` positives precede it on
  average; both variants of AP (trapezoids and rectangles) are linear in that number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array
from relocbench.metrics.retrieval.measures import recall_depth, unknown_metric
from relocbench.metrics.retrieval.relevance import Relevance


def chance_level(relevance: Relevance, metrics: Sequence[str]) -> dict[str, float]:
    """The expected value of each metric, 0..1, over all queries; a query without positives counts as not found.

    Raises:
        ConfigError: an unknown metric.
    """
    size = int(np.count_nonzero(~relevance.junk))
    counts, queries = np.unique(relevance.positives, return_counts=True)
    weights = queries / max(relevance.queries, 1)
    return {
        name: float(
            sum(w * _expected(name, int(n), size, relevance.gallery) for n, w in zip(counts, weights, strict=True))
        )
        for name in metrics
    }


def chance_recall(positives: Sequence[int], gallery: int, depths: Sequence[int]) -> list[float]:
    """The expected R@K, 0..1, at each depth K, over queries with so many positives among ``gallery`` images."""
    counts, queries = np.unique(np.asarray(positives, dtype=np.int64), return_counts=True)
    weights = queries / max(len(positives), 1)
    return [float(sum(w * _recall(int(n), gallery, k) for n, w in zip(counts, weights, strict=True))) for k in depths]


def _expected(metric: str, n: int, size: int, whole: int) -> float:
    """The expected metric of one query with n positives among ``size`` images; ``whole`` includes junk."""
    k = recall_depth(metric)
    if k is not None:
        return _recall(n, size, k)
    match metric:
        case "R@top1%":
            return _recall(n, size, round(0.01 * whole) + 1)
        case "MRR":
            return _reciprocal_rank(n, size)
        case "AP":
            return _average_precision(n, size, trapezoids=True)
        case "AP_rectangle":
            return _average_precision(n, size, trapezoids=False)
    raise unknown_metric(metric)


def _recall(n: int, size: int, k: int) -> float:
    if n == 0:
        return 0.0
    j = np.arange(min(k, size))
    return 1.0 - float(np.prod(np.maximum(size - n - j, 0) / (size - j)))


def _first_position(n: int, size: int) -> Array:
    """(size,) probability that the first positive is at each position."""
    r = np.arange(size)
    miss = np.maximum(size - n - r, 0) / (size - r)
    before = np.concatenate([[1.0], np.cumprod(miss)[:-1]])
    return np.asarray(before * n / (size - r) * (size - r >= n), dtype=np.float64)


def _reciprocal_rank(n: int, size: int) -> float:
    return 0.0 if n == 0 else float(np.sum(_first_position(n, size) / (np.arange(size) + 1.0)))


def _average_precision(n: int, size: int, *, trapezoids: bool) -> float:
    if n == 0:
        return 0.0
    r = np.arange(size, dtype=np.float64)
    before = r * (n - 1) / max(size - 1, 1)
    after = (before + 1) / (r + 1)
    if trapezoids:
        after = (after + np.where(r > 0, before / np.maximum(r, 1), 1.0)) / 2
    return float(np.mean(after))
