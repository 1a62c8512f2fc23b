"""Ranking by the dot product of descriptors, block by block, with results that are the same to the last bit.

In floating point a dot product depends on the order of its additions, hence on the size of the block, on the number of
threads and on the image's place in the gallery: two copies of one image can score differently, and near ties fall
either way. Here every number is first rounded to a grid, fine enough for what descriptors hold and coarse enough that
float64 adds up dot products without rounding. With ``|a_q| <= 4/3 2^26`` and ``|b_g| <= 4/3 2^26`` for integer vectors
every partial sum is at most ``|a_q| |b_g| <= 16/9 2^52 < 2^53`` (Cauchy-Schwarz). For vectors of norm 1 a step of the
grid is 2^-26 = 1.5e-8, and a dot product is off by some 1e-8: a tenth of what a float32 product of 2048 numbers is.

Ranks need few of these exact products: a float32 product of n numbers is off by at most ``n u / (1 - n u)`` times the
product of the norms, with u = 2^-24, whatever the order of its additions (Higham, "Accuracy and Stability of Numerical
Algorithms", 2002, section 3.1), and decides every comparison with a score that is farther away than that.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.arrays import Array, Floats, Indices
from relocbench.metrics.retrieval.ranking import NEVER, Ranking
from relocbench.metrics.retrieval.relevance import Relevance

Grid = Floats | Array
"""integers, as float32 where that holds them exactly"""

QUERY_BLOCK = 1024
GALLERY_BLOCK = 2048
_BITS = 26
_LARGEST_EXPONENT = 1000
_SINGLE_EXPONENT = 100
_UNIT = 2.0**-24
_ROUNDINGS = 4
"""roundings beyond the additions: of the factors to float32, and two to spare for the arithmetic of the bound itself"""
_PIECE = 256
"""numbers of two vectors that float32 multiplies and adds up at a time"""
_UNDECIDED = 0.1
"""share of all products; where float32 leaves more undecided, float64 matrix products beat single exact ones"""
_CACHED = 128
"""rows that fit a processor's cache while their norms are computed"""


def rank_descriptors(
    query: ArrayLike,
    gallery: ArrayLike,
    relevance: Relevance,
    *,
    query_block: int = QUERY_BLOCK,
    gallery_block: int = GALLERY_BLOCK,
) -> Ranking:
    """The positions of the positives when the gallery is ranked by descending dot product.

    Memory beyond the descriptors: at most ``8 (query_block D + gallery_block D + query_block gallery_block)`` bytes and
    about as much again while a block is rounded. Memory-mapped descriptors are read block by block.

    Args:
        query: (Q, D), any real type; divide by the norms beforehand for cosine similarity. A query whose descriptor
            is not finite retrieves nothing.
        gallery: (G, D). An image whose descriptor is not finite is never retrieved. The longest vector sets the grid:
            vectors that are many times shorter are resolved as many times less finely.
        relevance: of these queries in this gallery.
        query_block, gallery_block: rows in memory at a time. They do not change the result.

    Raises:
        ValueError: the shapes do not fit.
    """
    of_queries, of_gallery = _both_checked(query, gallery, query_block, gallery_block)
    if (len(of_queries), len(of_gallery)) != (relevance.queries, relevance.gallery):
        raise ValueError(
            f"expected {relevance.queries} query and {relevance.gallery} gallery descriptors, "
            f"got {len(of_queries)} and {len(of_gallery)}"
        )

    query_norms, gallery_norms = _norms(of_queries), _norms(of_gallery)
    live = np.flatnonzero(~relevance.junk & np.isfinite(gallery_norms))
    scale = float(_scales(np.array([gallery_norms[live].max(initial=0.0)]))[0])
    known = np.zeros(relevance.gallery, dtype=bool)
    known[live] = True
    position = np.full(len(relevance.indices), NEVER)
    answered = np.isfinite(query_norms) & (live.size > 0)
    for rows in _blocks(np.flatnonzero(answered & (relevance.positives > 0)), query_block):
        scales = _scales(query_norms[rows])
        grid, norms = _on_grid(of_queries, rows, scales[:, None]), query_norms[rows] * scales
        image = np.concatenate([relevance.of(q) for q in rows])
        owner = np.repeat(np.arange(len(rows)), relevance.positives[rows])
        owner, image = owner[known[image]], image[known[image]]
        scores = _exact_products(grid, owner, of_gallery, image, scale, gallery_block)
        order = np.lexsort((-scores, owner))
        others = _Others(scores[order], owner[order], len(rows))
        for columns in _blocks(live, gallery_block):
            others.count(grid, norms, _on_grid(of_gallery, columns, scale), gallery_norms[columns] * scale)
        number = np.arange(len(owner)) - np.searchsorted(owner, owner)
        position[relevance.starts[rows][owner] + number] = number + others.before()
    return Ranking(relevance.starts, position, answered, relevance.gallery)


def exact_scores(
    query: ArrayLike, gallery: ArrayLike, *, block: int = QUERY_BLOCK, gallery_block: int = GALLERY_BLOCK
) -> Iterator[tuple[slice, Array]]:
    """The whole similarity matrix, by blocks of queries, from the dot products that :func:`rank_descriptors` uses.

    Scores compare exactly within a row; each row has a scale of its own. Junk must be removed beforehand.

    Args:
        query: (Q, D), as in :func:`rank_descriptors`.
        gallery: (G, D).
        block: queries in a block; memory is ``8 block (G + D)`` bytes.
        gallery_block: rows of the gallery that are multiplied at a time.

    Yields:
        the slice of queries, and their scores (n, G); NaN where either descriptor is not finite.

    Raises:
        ValueError: the shapes do not fit.
    """
    of_queries, of_gallery = _both_checked(query, gallery, block, gallery_block)
    query_norms, gallery_norms = _norms(of_queries), _norms(of_gallery)
    live = np.flatnonzero(np.isfinite(gallery_norms))
    scale = float(_scales(np.array([gallery_norms[live].max(initial=0.0)]))[0])
    for start in range(0, len(of_queries), block):
        rows = slice(start, min(start + block, len(of_queries)))
        scores = np.full((rows.stop - start, len(of_gallery)), np.nan)
        known = np.flatnonzero(np.isfinite(query_norms[rows]))
        a = _on_grid(of_queries[rows], known, _scales(query_norms[rows][known])[:, None]).astype(np.float64)
        for columns in _blocks(live, gallery_block):
            scores[np.ix_(known, columns)] = a @ _on_grid(of_gallery, columns, scale).astype(np.float64).T
        yield rows, scores


class _Others:
    """The number of images other than a query's positives that score at least as much as each of these.

    Args:
        scores: (M,) exact scores of the positives, best first for each query.
        owner: (M,) the query of each, ascending.
        queries: Q.
    """

    def __init__(self, scores: Array, owner: Indices, queries: int) -> None:
        self._scores, self._owner = scores, owner
        self._starts = np.searchsorted(owner, np.arange(queries + 1))
        # An image is counted at the first score that it reaches; positives are counted too, hence taken off here.
        first = np.flatnonzero((np.diff(scores, prepend=np.inf) != 0) | (np.diff(owner, prepend=-1) != 0))
        self._reached = np.zeros(len(scores), dtype=np.int64)
        self._reached[first] = -np.diff(first, append=len(scores))

    def count(self, queries: Grid, query_norms: Array, gallery: Grid, gallery_norms: Array) -> None:
        """Count images of the gallery (G, D) with norms (G,) for queries (Q, D) with norms (Q,), all on the grid.

        Where float32 leaves too many products undecided, as where all descriptors are alike, all are computed exactly.
        """
        from relocbench.metrics.retrieval import kernels as retrieval_kernels

        products, error = _float32_products(queries, gallery)
        half = 0.5 * np.sqrt(queries.shape[1])  # the most that rounding to the grid adds to a norm
        off = error * (query_norms + half), gallery_norms + half
        reached, most = self._reached.copy(), int(_UNDECIDED * products.size) + 1
        if retrieval_kernels.count(products, *off, queries, gallery, self._scores, self._starts, reached, most):
            self._reached = reached
            return
        exact = queries.astype(np.float64) @ gallery.astype(np.float64).T
        off = np.zeros(len(query_norms)), np.zeros(len(gallery_norms))
        retrieval_kernels.count(exact, *off, queries, gallery, self._scores, self._starts, self._reached, 0)

    def before(self) -> Indices:
        """(M,) the number for each positive."""
        total = np.cumsum(self._reached)
        first = self._starts[self._owner]
        return np.asarray(total - (total[first] - self._reached[first]))


def _float32_products(queries: Grid, gallery: Grid) -> tuple[Floats, float]:
    """Products (Q, G) of (Q, D) and (G, D), and the most that they are off by, relative to the products of the norms.

    The error grows with the number of additions in a row, so that the sums of pieces are added up.
    """
    products, of_piece = np.zeros((2, len(queries), len(gallery)), dtype=np.float32)
    starts = range(0, queries.shape[1], _PIECE)
    for start in starts:
        a, b = (rows[:, start : start + _PIECE].astype(np.float32, copy=False) for rows in (queries, gallery))
        products += np.matmul(a, b.T, out=of_piece)
    roundings = (_PIECE + len(starts) + _ROUNDINGS) * _UNIT
    return products, roundings / (1.0 - roundings)


def _exact_products(
    queries: Grid, row: Indices, gallery: NDArray[Any], image: Indices, scale: float, block: int
) -> Array:
    """The exact products (M,) of queries on the grid and images of a gallery that is not.

    Args:
        row, image: (M,) each.
        block: products whose images are in memory at a time.
    """
    from relocbench.metrics.retrieval import kernels as retrieval_kernels

    products = np.empty(len(image))
    for part in _blocks(np.arange(len(image)), block):
        needed, place = np.unique(image[part], return_inverse=True)  # many queries may share a positive
        products[part] = retrieval_kernels.exact_products(row[part], place, queries, _on_grid(gallery, needed, scale))
    return products


def _on_grid(descriptors: NDArray[Any], rows: Indices, scale: float | Array) -> Grid:
    """Rows (n, D) of descriptors times powers of two, rounded to integers.

    Args:
        scale: one for all, or one for each row, (n, 1).
    """
    single = descriptors.dtype in (np.float16, np.float32) and bool(np.all(np.abs(np.log2(scale)) < _SINGLE_EXPONENT))
    kind = np.float32 if single else np.float64
    grid: Any = np.asarray(descriptors[rows], dtype=kind, order="C")
    grid *= np.asarray(scale, dtype=kind)
    return np.rint(grid, out=grid)  # type: ignore[no-any-return]


def _scales(norms: Array) -> Array:
    """Powers of two (n,) that scale finite norms into (2/3 2^26, 4/3 2^26]; norm 1 is far from either end."""
    exponents = _BITS - np.frexp(0.75 * norms)[1]
    out: Array = np.ldexp(1.0, np.clip(exponents, -_LARGEST_EXPONENT, _LARGEST_EXPONENT))
    return out


def _norms(rows: NDArray[Any]) -> Array:
    """(n,) norms as float64; NaN or inf where a row is not finite."""
    norms = np.empty(len(rows))
    for start in range(0, len(rows), _CACHED):
        chunk = np.array(rows[start : start + _CACHED], dtype=np.float64, order="C")
        with np.errstate(over="ignore", invalid="ignore"):
            norms[start : start + _CACHED] = np.sqrt(np.einsum("ij,ij->i", chunk, chunk))
    return norms


def _blocks(indices: Indices, block: int) -> Iterator[Indices]:
    for start in range(0, len(indices), block):
        yield indices[start : start + block]


def _both_checked(
    query: ArrayLike, gallery: ArrayLike, query_block: int, gallery_block: int
) -> tuple[NDArray[Any], NDArray[Any]]:
    of_queries, of_gallery = _checked(query, "query"), _checked(gallery, "gallery")
    if of_queries.shape[1] != of_gallery.shape[1]:
        raise ValueError(f"descriptors must have one length, got {of_queries.shape[1]} and {of_gallery.shape[1]}")
    if query_block < 1 or gallery_block < 1:
        raise ValueError(f"blocks must hold at least one row, got {query_block} and {gallery_block}")
    return of_queries, of_gallery


def _checked(descriptors: ArrayLike, name: str) -> NDArray[Any]:
    d = np.asanyarray(descriptors)
    if d.ndim != 2 or 0 in d.shape or d.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} descriptors must be a non-empty (N, D) array of real numbers, got {d.dtype} {d.shape}"
        )
    return d
