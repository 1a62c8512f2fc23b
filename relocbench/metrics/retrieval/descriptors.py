"""Ranking by the dot product of descriptors, block by block, with results that are the same to the last bit.

In floating point a dot product depends on the order of its additions, hence on the size of the block, on the number of
threads and on the image's place in the gallery: two copies of one image can score differently, and near ties fall
either way. Here every number is first rounded to a grid, fine enough for what descriptors hold and coarse enough that
float64 adds up dot products without rounding. With ``|a_q| <= 4/3 2^26`` and ``|b_g| <= 4/3 2^26`` for integer vectors
every partial sum is at most ``|a_q| |b_g| <= 16/9 2^52 < 2^53`` (Cauchy-Schwarz). For vectors of norm 1 a step of the
grid is 2^-26 = 1.5e-8, and a dot product is off by some 1e-8: a tenth of what a float32 product of 2048 numbers is.

Ranks need few of these exact products: a float32 product decides most comparisons, and the exact one is computed only
where it does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.arrays import Array, Indices, Mask
from relocbench.metrics.retrieval.counting import Scaled, Thresholds, exact_products
from relocbench.metrics.retrieval.ranking import NEVER, Ranking, ranks_of_positives, sorted_finite
from relocbench.metrics.retrieval.relevance import Relevance

QUERY_BLOCK = 1024
GALLERY_BLOCK = 2048
_BITS = 26
_LARGEST_EXPONENT = 1000
_SINGLE_EXPONENT = 100
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
    of_queries, of_gallery = _checked(query, "query"), _checked(gallery, "gallery")
    if of_queries.shape[1] != of_gallery.shape[1]:
        raise ValueError(f"descriptors must have one length, got {of_queries.shape[1]} and {of_gallery.shape[1]}")
    if (len(of_queries), len(of_gallery)) != (relevance.queries, relevance.gallery):
        raise ValueError(
            f"expected {relevance.queries} query and {relevance.gallery} gallery descriptors, "
            f"got {len(of_queries)} and {len(of_gallery)}"
        )
    if query_block < 1 or gallery_block < 1:
        raise ValueError(f"blocks must hold at least one row, got {query_block} and {gallery_block}")

    query_norms, gallery_norms = _norms(of_queries), _norms(of_gallery)
    live = np.flatnonzero(~relevance.junk & np.isfinite(gallery_norms))
    scale = float(_scales(np.array([gallery_norms[live].max(initial=0.0)]))[0])
    known = np.zeros(relevance.gallery, dtype=bool)
    known[live] = True
    position = np.full(len(relevance.indices), NEVER)
    answered = np.isfinite(query_norms) & (live.size > 0)
    for rows in _blocks(np.flatnonzero(answered & (relevance.positives > 0)), query_block):
        scales = _scales(query_norms[rows])
        grid, norms = _on_grid(of_queries[rows], scales[:, None]), query_norms[rows] * scales
        scores = _scores_of_positives(grid, [relevance.of(q) for q in rows], of_gallery, known, scale, gallery_block)
        at_least = Thresholds([sorted_finite(s) for s in scores])
        for columns in _blocks(live, gallery_block):
            _compare(grid, norms, _scaled(of_gallery[columns], scale), gallery_norms[columns] * scale, at_least)
        for k, q in enumerate(rows):
            position[relevance.starts[q] : relevance.starts[q + 1]] = ranks_of_positives(scores[k], at_least.counts(k))
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
    of_queries, of_gallery = _checked(query, "query"), _checked(gallery, "gallery")
    if of_queries.shape[1] != of_gallery.shape[1]:
        raise ValueError(f"descriptors must have one length, got {of_queries.shape[1]} and {of_gallery.shape[1]}")
    if block < 1 or gallery_block < 1:
        raise ValueError(f"blocks must hold at least one row, got {block} and {gallery_block}")
    query_norms, gallery_norms = _norms(of_queries), _norms(of_gallery)
    live = np.flatnonzero(np.isfinite(gallery_norms))
    scale = float(_scales(np.array([gallery_norms[live].max(initial=0.0)]))[0])
    for start in range(0, len(of_queries), block):
        rows = slice(start, min(start + block, len(of_queries)))
        scores = np.full((rows.stop - start, len(of_gallery)), np.nan)
        known = np.flatnonzero(np.isfinite(query_norms[rows]))
        a = _on_grid(of_queries[rows][known], _scales(query_norms[rows][known])[:, None])
        for columns in _blocks(live, gallery_block):
            scores[np.ix_(known, columns)] = a @ _on_grid(of_gallery[columns], scale).T
        yield rows, scores


def _compare(grid: Array, norms: Array, gallery: Scaled, gallery_norms: Array, at_least: Thresholds) -> None:
    """Count images of the gallery (G, D), scaled to the grid, that reach the thresholds of queries (Q, D) on the grid.

    Where float32 leaves too many products undecided, as where all descriptors are alike, all are computed exactly.
    """
    products = grid.astype(np.float32) @ gallery.astype(np.float32, copy=False).T
    most = int(_UNDECIDED * products.size) + 1
    pairs = at_least.count_decided(products, norms, gallery_norms, grid.shape[1], most)
    if pairs is not None:
        at_least.count_pairs(pairs, grid, gallery)
    else:
        at_least.count_exact(grid @ np.rint(gallery, dtype=np.float64).T)


def _scaled(rows: NDArray[Any], scale: float) -> Scaled:
    """Rows (n, D) times a power of two: in float32 where that is exact or the loss is far below 1, else in float64."""
    exact = rows.dtype in (np.float16, np.float32) and 2.0**-_SINGLE_EXPONENT < scale < 2.0**_SINGLE_EXPONENT
    kind = np.float32 if exact else np.float64
    scaled: Scaled = np.multiply(rows, kind(scale), dtype=kind, order="C")
    return scaled


def _scores_of_positives(
    grid: Array, positives: Sequence[Indices], gallery: NDArray[Any], known: Mask, scale: float, block: int
) -> list[Array]:
    """The exact scores of each query's positives, NaN where the descriptor is not finite.

    Args:
        grid: (Q, D) queries on the grid.
        positives: the gallery indices of each query's positives.
        block: rows of the gallery that are in memory at a time.
    """
    images, of = np.concatenate(positives), np.repeat(np.arange(len(grid)), [len(mine) for mine in positives])
    scores = np.full(len(images), np.nan)
    for chunk in _blocks(np.flatnonzero(known[images]), block):
        needed, row = np.unique(images[chunk], return_inverse=True)  # many queries may share a positive
        scores[chunk] = exact_products(np.column_stack([of[chunk], row]), grid, _scaled(gallery[needed], scale))
    return np.split(scores, np.cumsum([len(mine) for mine in positives])[:-1])


def _on_grid(rows: NDArray[Any], scale: float | Array) -> Array:
    """Rows (n, D) times ``scale``, rounded to integers, as float64."""
    grid = np.array(rows, dtype=np.float64, order="C")
    grid *= scale
    return np.rint(grid, out=grid)


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


def _checked(descriptors: ArrayLike, name: str) -> NDArray[Any]:
    d = np.asanyarray(descriptors)
    if d.ndim != 2 or 0 in d.shape or d.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} descriptors must be a non-empty (N, D) array of real numbers, got {d.dtype} {d.shape}"
        )
    return d
