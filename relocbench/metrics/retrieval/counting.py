"""How many images score at least as much as a positive: from float32 products where they decide, exactly where not.

A float32 product of n numbers is off by at most ``n u / (1 - n u)`` times the product of the norms, with u = 2^-24,
in whatever order it is added up (Higham, "Accuracy and Stability of Numerical Algorithms", 2002, section 3.1). Where
it is nearer to a threshold than that, it decides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Scaled = NDArray[np.float32] | NDArray[np.float64]
Indices = NDArray[np.int64]

_UNIT = 2.0**-24
_ROUNDINGS = 4
"""of factors to float32, and a spare one for the bound's own arithmetic"""
_MOST_ROUNDINGS = 2**20


class Thresholds:
    """Thresholds of some queries, and how many products reach each.

    Args:
        of_queries: Q arrays, each ascending.
    """

    def __init__(self, of_queries: Sequence[Array]) -> None:
        self._starts = np.cumsum([0, *map(len, of_queries)], dtype=np.int64)
        self._values = np.concatenate(of_queries) if len(of_queries) else np.zeros(0)
        self._reached = np.zeros(len(self._values), dtype=np.int64)

    def counts(self, query: int) -> Indices:
        """(n,) how many of the products that were counted are >= each threshold of a query."""
        highest_reached = self._reached[self._starts[query] : self._starts[query + 1]]
        return np.cumsum(highest_reached[::-1])[::-1]

    def count_exact(self, products: Array) -> None:
        """Count products (Q, G) that are exact."""
        from relocbench.metrics.retrieval import kernels as retrieval_kernels

        nobody = np.zeros((0, 2), dtype=np.int64)
        zeros = np.zeros(len(products)), np.zeros(products.shape[1]), 0.0, 0.0, 0.0
        retrieval_kernels.count_decided(products, *zeros, self._values, self._starts, self._reached, nobody)

    def count_decided(
        self, products: NDArray[np.float32], query_norms: Array, gallery_norms: Array, length: int, most: int
    ) -> Indices | None:
        """Count float32 products (Q, G), but those that are too near to a threshold.

        Args:
            query_norms: (Q,), of the vectors whose products they are.
            gallery_norms: (G,).
            length: numbers in a vector.
            most: so many may be too near.

        Returns:
            (N, 2) query and gallery image of those; None where they are more, and nothing is counted then.
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
        """Count single products, which are computed exactly.

        Args:
            pairs: (N, 2) query and gallery image.
            query: (Q, D) integers.
            gallery: (G, D), which is rounded to integers.
        """
        from relocbench.metrics.retrieval import kernels as retrieval_kernels

        retrieval_kernels.count_pairs(pairs, query, gallery, self._values, self._starts, self._reached)


def error_bound(length: int) -> tuple[float, float]:
    """How far a float32 product is from that of the vectors rounded to integers.

    Args:
        length: n, numbers in a vector.

    Returns:
        ``relative`` and ``absolute``: the product of vectors with norms a and b is off by at most
        ``relative a b + absolute (a + b + sqrt(n))``, by its additions and as each factor is rounded by up to a half.
        Infinity where float32 tells nothing.
    """
    if length > _MOST_ROUNDINGS:
        return np.inf, np.inf
    roundings = (length + _ROUNDINGS) * _UNIT
    return roundings / (1.0 - roundings), 0.5 * np.sqrt(length)


def exact_products(pairs: Indices, query: Array, gallery: Scaled) -> Array:
    """Products (N,) of pairs (N, 2) of integers (Q, D) and of rows (G, D), which are rounded to integers."""
    from relocbench.metrics.retrieval import kernels as retrieval_kernels

    products: Array = retrieval_kernels.exact_products(pairs, query, gallery)
    return products
