"""Matching quality: how often a per-pixel Gauss-Newton converges to the true pixel.

For each ground-truth correspondence the solver starts at a known offset from the true query pixel. The metric is the
share of solutions that end within a threshold of the truth, over all starts and by the length of the start offset.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Mask
from relocbench.metrics.pose.failure_policy import infinite_where_failed

THRESHOLDS_PX: tuple[float, ...] = (1, 3)
"""distances within which a correspondence is found, inclusive"""
OFFSET_EDGES_PX: tuple[float, ...] = (0, 1, 2, 4, 8, 16)
"""of the groups of start offsets; a start on an edge belongs to the group below"""
_DIGITS = 6
"""Distances are rounded to 1e-6 px, so that a start drawn 8 px from the truth lies in the group up to 8 px."""


@dataclass(frozen=True)
class OffsetShare:
    """The correspondences whose start was more than ``low_px`` and at most ``high_px`` from the truth."""

    low_px: float
    high_px: float
    count: int
    share: Mapping[str, float | None]
    """by name such as ``match@1px``; None where no start lies in this range"""


@dataclass(frozen=True)
class MatchingQuality:
    """Shares, 0..1, of ground-truth correspondences that a method found again."""

    count: int
    share: Mapping[str, float]
    """by name such as ``match@1px``, over all starts"""
    start_share: Mapping[str, float]
    """the shares of the start pixels themselves, which a solver that does not move would get: a trivial baseline"""
    by_offset: tuple[OffsetShare, ...]


def matching_quality(end_px: ArrayLike, truth_px: ArrayLike, start_offset_px: ArrayLike) -> MatchingQuality:
    """Shares of correspondences that end within each threshold of the truth.

    Args:
        end_px: (N, 2) where the solver ended; NaN where it failed or left the image, which counts as not found.
        truth_px: (N, 2) the true query pixels.
        start_offset_px: (N, 2) start minus truth, or (N,) its length.

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
    if not np.isfinite(truth).all() or not np.all((start >= OFFSET_EDGES_PX[0]) & (start <= OFFSET_EDGES_PX[-1])):
        raise ValueError(
            f"start offsets must lie in {OFFSET_EDGES_PX[0]}..{OFFSET_EDGES_PX[-1]} px and true pixels be finite"
        )
    answered: Mask = np.all(np.isfinite(end), axis=1)
    distance = np.round(np.linalg.norm(np.where(answered[:, None], end, 0) - truth, axis=-1), _DIGITS)
    distance = infinite_where_failed(distance, answered)

    names = {f"match@{t:g}px": t for t in THRESHOLDS_PX}
    groups = []
    for low, high in itertools.pairwise(OFFSET_EDGES_PX):
        inside = (start > low) & (start <= high)
        if low == OFFSET_EDGES_PX[0]:
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
