"""Relevance: which gallery images are right for which query, by labels, by lists, or by where both were taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices, Mask

JUNK_LABEL = -1
"""gallery images with this label are removed before ranking: they count neither as right nor as wrong"""
PLACE_RADIUS_M = 25.0
_DIGITS = 9
"""Headings are rounded to 1e-9 degrees, so that one that is meant to be 40 degrees off is within 40 degrees."""


@dataclass(frozen=True, eq=False)
class Relevance:
    """The positives of Q queries in a gallery of G images. A junk image is a positive of no query."""

    starts: Indices
    """(Q + 1,) the positives of query q are ``indices[starts[q] : starts[q + 1]]``"""
    indices: Indices
    """(M,) gallery indices, ascending for each query"""
    junk: Mask
    """(G,) the images that are removed from the gallery before ranking"""

    @property
    def queries(self) -> int:
        return len(self.starts) - 1

    @property
    def gallery(self) -> int:
        """G, the size of the gallery, junk included."""
        return len(self.junk)

    @property
    def positives(self) -> Indices:
        """(Q,) the number of positives of each query."""
        return np.diff(self.starts)

    def of(self, query: int) -> Indices:
        """The gallery indices of one query's positives."""
        return self.indices[self.starts[query] : self.starts[query + 1]]


def relevance_from_labels(
    query_labels: ArrayLike, gallery_labels: ArrayLike, *, junk_label: int | None = JUNK_LABEL
) -> Relevance:
    """Relevance by labels: a query's positives are the gallery images with its label.

    Args:
        query_labels: (Q,) integers. A query whose label is the junk label has no positives.
        gallery_labels: (G,) integers.
        junk_label: None where there is no junk.

    Raises:
        ValueError: not one-dimensional integers, or none at all.
    """
    of_queries, of_gallery = _labels(query_labels, "query_labels"), _labels(gallery_labels, "gallery_labels")
    order = np.argsort(of_gallery, kind="stable")
    sorted_labels = of_gallery[order]
    first = np.searchsorted(sorted_labels, of_queries, side="left")
    last = np.searchsorted(sorted_labels, of_queries, side="right")
    junk = np.zeros(len(of_gallery), dtype=bool) if junk_label is None else of_gallery == junk_label
    counts = last - first
    starts = _starts(counts)
    within = np.arange(starts[-1]) - np.repeat(starts[:-1], counts)
    return _without_junk(counts, order[np.repeat(first, counts) + within], junk)


def relevance_from_lists(positives: Sequence[ArrayLike], gallery: int, *, junk: ArrayLike | None = None) -> Relevance:
    """Relevance by lists of positives.

    Args:
        positives: Q lists of gallery indices, in any order; an empty one for a query without positives.
        gallery: G, the number of images in the gallery.
        junk: (G,) bool; None where there is no junk.

    Raises:
        ValueError: an index outside the gallery or twice in one list, or shapes that do not fit.
    """
    lists = [np.sort(np.asarray(p, dtype=np.int64).ravel()) for p in positives]
    for query, of_query in enumerate(lists):
        if of_query.size and (of_query[0] < 0 or of_query[-1] >= gallery or np.any(np.diff(of_query) == 0)):
            raise ValueError(f"positives of query {query} must be distinct indices in 0..{gallery - 1}")
    taken_out = np.zeros(gallery, dtype=bool) if junk is None else np.asarray(junk, dtype=bool)
    if taken_out.shape != (gallery,) or gallery < 1 or not lists:
        raise ValueError(f"a gallery of {gallery} images needs junk ({gallery},) and at least one query")
    return _without_junk(np.array([len(p) for p in lists]), np.concatenate(lists), taken_out)


def relevance_within(
    query_m: ArrayLike,
    gallery_m: ArrayLike,
    radius_m: float = PLACE_RADIUS_M,
    *,
    query_heading_rad: ArrayLike | None = None,
    gallery_heading_rad: ArrayLike | None = None,
    heading_limit_deg: float | None = None,
) -> Relevance:
    """Relevance for place recognition: positives lie within a radius of the query and, optionally, face the same way.

    Args:
        query_m: (Q, 2) or (Q, 3) positions; the distance is over all columns given.
        gallery_m: (G, 2) or (G, 3), the same columns.
        radius_m: radius, inclusive.
        query_heading_rad, gallery_heading_rad: (Q,) and (G,), about one axis, modulo a full turn.
        heading_limit_deg: the largest angle between the headings, inclusive; None for no limit.

    Raises:
        ValueError: the shapes do not fit, a number is not finite, or a limit without headings.
    """
    query, gallery = _positions(query_m, "query_m"), _positions(gallery_m, "gallery_m")
    if query.shape[1] != gallery.shape[1]:
        raise ValueError(f"positions must have the same columns, got {query.shape[1]} and {gallery.shape[1]}")
    if not radius_m >= 0:
        raise ValueError(f"the radius must be >= 0 m, got {radius_m}")
    headings = None
    if heading_limit_deg is not None:
        if not heading_limit_deg >= 0:
            raise ValueError(f"the heading limit must be >= 0 degrees, got {heading_limit_deg}")
        headings = (
            _headings(query_heading_rad, len(query), "query_heading_rad"),
            _headings(gallery_heading_rad, len(gallery), "gallery_heading_rad"),
        )
    # Only a strip of the gallery can be within the radius: it is found by one sorted coordinate.
    order = np.argsort(gallery[:, 0], kind="stable")
    x = gallery[order, 0]
    margin = radius_m * (1 + 1e-9) + 1e-9 * max(1.0, float(np.abs(x).max()))
    first = np.searchsorted(x, query[:, 0] - margin, side="left")
    last = np.searchsorted(x, query[:, 0] + margin, side="right")
    found = []
    for q in range(len(query)):
        strip = order[first[q] : last[q]]
        distance = np.linalg.norm(gallery[strip] - query[q], axis=1)
        near = strip[np.round(distance, _DIGITS) <= radius_m]  # on a grid, many lie at the radius
        if headings is not None and heading_limit_deg is not None:
            near = near[angle_between_deg(headings[0][q], headings[1][near]) <= heading_limit_deg]
        found.append(near)
    return relevance_from_lists(found, len(gallery))


def angle_between_deg(heading_rad: ArrayLike, other_rad: ArrayLike) -> Array:
    """The angle between two headings about one axis, 0..180 degrees."""
    turn = np.asarray(heading_rad, dtype=np.float64) - np.asarray(other_rad, dtype=np.float64)
    degrees: Array = np.rad2deg(np.abs(np.arctan2(np.sin(turn), np.cos(turn)))).astype(np.float64)
    return np.round(degrees, _DIGITS)


def _without_junk(counts: Indices, indices: Indices, junk: Mask) -> Relevance:
    queries = np.repeat(np.arange(len(counts)), counts)
    kept = ~junk[indices]
    left = np.bincount(queries[kept], minlength=len(counts))
    return Relevance(_starts(left), np.asarray(indices[kept], dtype=np.int64), junk)


def _starts(counts: Indices) -> Indices:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _labels(labels: ArrayLike, name: str) -> Indices:
    array = np.asarray(labels)
    if array.ndim != 1 or array.size == 0 or array.dtype.kind not in "iu":
        raise ValueError(f"{name} must be a non-empty (N,) array of integers, got {array.dtype} {array.shape}")
    return array.astype(np.int64)


def _positions(positions: ArrayLike, name: str) -> Array:
    p = np.asarray(positions, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] not in (2, 3) or len(p) == 0 or not np.isfinite(p).all():
        raise ValueError(f"{name} must be (N, 2) or (N, 3) finite metres, N >= 1, got {p.shape}")
    return p


def _headings(headings: ArrayLike | None, count: int, name: str) -> Array:
    if headings is None:
        raise ValueError(f"a heading limit needs {name}")
    h = np.asarray(headings, dtype=np.float64)
    if h.shape != (count,) or not np.isfinite(h).all():
        raise ValueError(f"{name} must be ({count},) finite radians, got {h.shape}")
    return h
