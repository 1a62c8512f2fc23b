"""The compiled loops of :mod:`relocbench.metrics.retrieval.descriptors`, imported only when something is ranked."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Floats, Indices
from relocbench.kernels import njit

Grid = Floats | Array


@njit(cache=True)
def count(
    products: Grid,
    query_off: Array,
    gallery_off: Array,
    queries: Grid,
    gallery: Grid,
    scores: Array,
    starts: Indices,
    reached: Indices,
    most: int,
) -> bool:
    """Add 1 to ``reached`` (M,) at the first of a query's descending scores that each product reaches.

    A product (q, g) is off by at most ``query_off[q] gallery_off[g]``; where that decides nothing it is computed
    exactly. False if that were more than ``most`` products.
    """
    undecided, farthest, near = 0, np.max(gallery_off), np.empty(len(gallery), dtype=np.int64)
    for q in range(len(products)):
        begin, end = starts[q], starts[q + 1]
        if begin == end:
            continue
        far_below = scores[end - 1] - query_off[q] * farthest
        found = 0
        for g in range(len(gallery)):  # without a branch, which would be guessed wrong too often
            near[found] = g
            found += products[q, g] >= far_below
        for g in near[:found]:
            product = np.float64(products[q, g])
            off = query_off[q] * gallery_off[g]
            k = _first_reached(scores, begin, end, product - off)
            if k > begin and scores[k - 1] <= product + off:
                undecided += 1
                if undecided > most:
                    return False
                k = _first_reached(scores, begin, end, _exact_product(queries[q], gallery[g]))
            if k < end:
                reached[k] += 1
    return True


@njit(cache=True)
def exact_products(row: Indices, image: Indices, queries: Grid, gallery: Grid) -> Array:
    """(M,) exact products of rows of ``queries`` (Q, D) and images of ``gallery`` (G, D), integers all."""
    products = np.empty(len(row))
    for n in range(len(row)):
        products[n] = _exact_product(queries[row[n]], gallery[image[n]])
    return products


@njit(cache=True, fastmath={"reassoc", "contract"})
def _exact_product(a: Grid, b: Grid) -> float:
    """The product of integer vectors whose partial sums are exact in float64: the order of additions is irrelevant."""
    total = 0.0
    for i in range(len(a)):
        total += np.float64(a[i]) * np.float64(b[i])
    return total


@njit(cache=True)
def _first_reached(scores: Array, begin: int, end: int, product: float) -> int:
    """The first of ``scores[begin:end]``, descending, that is not above the product; ``end`` if all are."""
    while begin < end:
        middle = (begin + end) // 2
        if scores[middle] > product:
            begin = middle + 1
        else:
            end = middle
    return begin
