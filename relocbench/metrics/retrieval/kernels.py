"""The compiled loops of :mod:`relocbench.metrics.retrieval.counting`, imported only when something is ranked."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Floats, Indices
from relocbench.kernels import njit

Scaled = Floats | Array


@njit(cache=True)
def count_decided(
    products: Scaled,
    query_norms: Array,
    gallery_norms: Array,
    relative: float,
    absolute: float,
    root: float,
    thresholds: Array,
    starts: Indices,
    reached: Indices,
    undecided: Indices,
) -> int:
    """Add 1 to ``reached`` (M,) at the highest threshold that each product certainly reaches.

    Returns the number of products too close to a threshold, listed in ``undecided``; -1 if that has too few rows.
    """
    found, longest = 0, np.max(gallery_norms)
    for q in range(products.shape[0]):
        begin, end = starts[q], starts[q + 1]
        if begin == end:
            continue
        mine = thresholds[begin:end]
        slope, rest = relative * query_norms[q] + absolute, absolute * (query_norms[q] + root)
        far_below = mine[0] - slope * longest - rest
        for g in range(products.shape[1]):
            product = np.float64(products[q, g])
            if product < far_below:
                continue
            off = slope * gallery_norms[g] + rest
            surely = np.searchsorted(mine, product - off, side="right")
            if surely < np.searchsorted(mine, product + off, side="right"):
                if found == len(undecided):
                    return -1
                undecided[found, 0], undecided[found, 1] = q, g
                found += 1
            elif surely:
                reached[begin + surely - 1] += 1
    return found


@njit(cache=True, fastmath={"reassoc", "contract"})
def _exact_product(query: Array, row: Scaled) -> float:
    """The product of integer vectors whose partial sums are exact in float64: the order of additions is irrelevant."""
    total = 0.0
    for i in range(len(query)):
        total += query[i] * np.rint(np.float64(row[i]))
    return total


@njit(cache=True)
def exact_products(pairs: Indices, query: Array, gallery: Scaled) -> Array:
    """(N,) exact products of pairs (N, 2): integer rows of ``query`` (Q, D), and rows of ``gallery`` (G, D) rounded."""
    products = np.empty(len(pairs))
    for n in range(len(pairs)):
        products[n] = _exact_product(query[pairs[n, 0]], gallery[pairs[n, 1]])
    return products


@njit(cache=True)
def count_pairs(
    pairs: Indices, query: Array, gallery: Scaled, thresholds: Array, starts: Indices, reached: Indices
) -> None:
    for n in range(len(pairs)):
        q, g = pairs[n, 0], pairs[n, 1]
        begin, end = starts[q], starts[q + 1]
        count = np.searchsorted(thresholds[begin:end], _exact_product(query[q], gallery[g]), side="right")
        if count:
            reached[begin + count - 1] += 1
