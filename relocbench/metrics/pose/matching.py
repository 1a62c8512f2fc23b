"""Matching quality: how often a per-pixel Gauss-Newton walks to the true pixel.

For each ground-truth correspondence the solver starts a known offset away from the true query pixel and ends
somewhere. The metric is the share that ends within a threshold, over all starts and by the length of the
start offset.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relocbench.metrics.pose.failure_policy import infinite_where_failed

THRESHOLDS_PX: tuple[float, ...] = (1, 3)
OFFSET_EDGES_PX: tuple[float, ...] = (0, 1, 2, 4, 8, 16)
_DIGITS = 6
"""a start meant to be 8 px off in some direction is 8 px off up to rounding, and so is the end of who does not move"""


@dataclass(frozen=True)
class OffsetShare:
    """The correspondences whose start was between ``low_px`` (excluded) and ``high_px`` (included) off."""

    low_px: float
    high_px: float
    count: int
    share: Mapping[str, float | None]
    """by name ``match@1px``; None when there is no such start"""


@dataclass(frozen=True)
class MatchingQuality:
    """Shares 0..1 of ground-truth correspondences found again."""

    count: int
    share: Mapping[str, float]
    """by name ``match@1px``, over all starts"""
    start_share: Mapping[str, float]
    """the same for the starts, as of a solver that does not move: read the shares against it"""
    by_offset: tuple[OffsetShare, ...]


def matching_quality(
    end_px: ArrayLike,
    truth_px: ArrayLike,
    start_offset_px: ArrayLike,
    *,
    thresholds_px: Sequence[float] = THRESHOLDS_PX,
    offset_edges_px: Sequence[float] = OFFSET_EDGES_PX,
) -> MatchingQuality:
    """Shares of correspondences that end within each threshold of the truth.

    Args:
        end_px: (N, 2) where the solver ended; NaN where it failed or left the image, which counts as
            not found.
        truth_px: (N, 2) the true query pixels.
        start_offset_px: (N, 2) start minus truth, or (N,) its length.
        thresholds_px: distances that count as found, the threshold itself included.
        offset_edges_px: ascending edges of the start offsets' groups; a start on an edge belongs below it.

    Raises:
        ValueError: the shapes do not fit, there are no correspondences, or a start offset lies outside
            the edges.
    """
    end, truth = np.asarray(end_px, dtype=np.float64), np.asarray(truth_px, dtype=np.float64)
    start = np.asarray(start_offset_px, dtype=np.float64)
    start = np.linalg.norm(start, axis=-1) if start.ndim == 2 else start
    n = len(truth)
    if n == 0 or truth.shape != (n, 2) or end.shape != (n, 2) or start.shape != (n,):
        raise ValueError("matching needs end_px and truth_px (N, 2) and start_offset_px (N, 2) or (N,), N >= 1")
    start = np.round(start, _DIGITS)
    if not np.isfinite(truth).all() or not np.all((start >= offset_edges_px[0]) & (start <= offset_edges_px[-1])):
        raise ValueError(f"start offsets must lie in {offset_edges_px[0]}..{offset_edges_px[-1]} px, truth be finite")
    answered: NDArray[np.bool_] = np.all(np.isfinite(end), axis=1)
    distance = np.round(np.linalg.norm(np.where(answered[:, None], end, 0) - truth, axis=-1), _DIGITS)
    distance = infinite_where_failed(distance, answered)

    names = {f"match@{t:g}px": t for t in thresholds_px}
    groups = []
    for low, high in itertools.pairwise(offset_edges_px):
        inside = (start > low) & (start <= high)
        if low == offset_edges_px[0]:
            inside |= start == low
        count = int(inside.sum())
        share = {k: float(np.mean(distance[inside] <= t)) if count else None for k, t in names.items()}
        groups.append(OffsetShare(float(low), float(high), count, share))
    return MatchingQuality(
        count=n,
        share={k: float(np.mean(distance <= t)) for k, t in names.items()},
        start_share={k: float(np.mean(start <= t)) for k, t in names.items()},
        by_offset=tuple(groups),
    )
