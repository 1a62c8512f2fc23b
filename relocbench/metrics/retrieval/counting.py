"""How many images score at least as much as a positive: from float32 products, and exactly where those cannot decide.

A float32 product of n numbers is off by at most ``n u / (1 - n u)`` times the product of the norms, with u = 2^-24,
whatever the order of its additions (Higham, "Accuracy and Stability of Numerical Algorithms", 2002, section 3.1).
A product that is closer to a threshold than that leaves the comparison undecided.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array, Floats, Indices

Scaled = Floats | Array

_UNIT = 2.0**-24
_ROUNDINGS = 4
"""roundings beyond the additions: of the factors to float32, and one to spare for the arithmetic of the bound itself"""
_MOST_ROUNDINGS = 2**20


class Thresholds:
    """Score thresholds of several queries, and a count of the products that reach each.

    Args:
        of_queries: one ascending array for each of Q queries.
    """

    def __init__(self, of_queries: Sequence[Array]) -> None:
        self._starts = np.cumsum([0, *map(len, of_queries)], dtype=np.int64)
        self._values = np.concatenate(of_queries) if len(of_queries) else np.zeros(0)
        self._reached = np.zeros(len(self._values), dtype=np.int64)

    def counts(self, query: int) -> Indices:
        """(n,) how many of the counted products are >= each threshold of a query."""
        highest_reached = self._reached[self._starts[query] : self._starts[query + 1]]
        return np.cumsum(highest_reached[::-1])[::-1]

    def count_exact(self, products: Array) -> None:
        """Count products (Q, G) that are known exactly."""
        from relocbench.metrics.retrieval import kernels as retrieval_kernels

        nobody = np.zeros((0, 2), dtype=np.int64)
        zeros = np.zeros(len(products)), np.zeros(products.shape[1]), 0.0, 0.0, 0.0
        retrieval_kernels.count_decided(products, *zeros, self._values, self._starts, self._reached, nobody)

    def count_decided(
        self, products: Floats, query_norms: Array, gallery_norms: Array, length: int, most: int
    ) -> Indices | None:
        """Count float32 products (Q, G), except those that are too close to a threshold to be decided.

        Args:
            query_norms: (Q,) norms of the query vectors.
            gallery_norms: (G,) norms of the gallery vectors.
            length: numbers in a vector.
            most: the largest acceptable number of undecided products.

        Returns:
            (N, 2) query and gallery index of each undecided product; None where there are more than ``most``, in
            which case nothing is counted.
        """
        from relocbench.metrics.retrieval import kernels as retrieval_kernels

        relative, absolute = error_bound(length)
        if not np.isfinite(relative):
            return None
        reached, pairs = np.zeros_like(self._reached), np.empty((most, 2), dtype=np.int64)
        bound = query_norms, gallery_norms, relative, absolute, float(np.sqrt(length))
        found = retrieval_kernels.count_decided(products, *bound, self._values, self._starts, reached, pairs)
        if found < 0:
            return None
        self._reached += reached
        return pairs[:found]

    def count_pairs(self, pairs: Indices, query: Array, gallery: Scaled) -> None:
        """Compute single products exactly and count them.

        Args:
            pairs: (N, 2) query and gallery index.
            query: (Q, D) integers.
            gallery: (G, D), rounded to integers here.
        """
        from relocbench.metrics.retrieval import kernels as retrieval_kernels

        retrieval_kernels.count_pairs(pairs, query, gallery, self._values, self._starts, self._reached)


def error_bound(length: int) -> tuple[float, float]:
    """A bound on the difference between a float32 product and that of the vectors rounded to integers.

    Args:
        length: n, numbers in a vector.

    Returns:
        ``relative`` and ``absolute``: the product of vectors with norms a and b is off by at most
        ``relative a b + absolute (a + b + sqrt(n))``, from its additions and from rounding each factor by up to a
        half. Infinity where n is so large that float32 decides nothing.
    """
    if length > _MOST_ROUNDINGS:
        return np.inf, np.inf
    roundings = (length + _ROUNDINGS) * _UNIT
    return roundings / (1.0 - roundings), 0.5 * np.sqrt(length)


def exact_products(pairs: Indices, query: Array, gallery: Scaled) -> Array:
    """(N,) exact products of pairs (N, 2): integer rows of ``query`` (Q, D), and rows of ``gallery`` (G, D) rounded."""
    from relocbench.metrics.retrieval import kernels as retrieval_kernels

    products: Array = retrieval_kernels.exact_products(pairs, query, gallery)
    return products
