"""Tiers of difficulty: how hard a pair is to answer, whatever the method, the dataset or the weather.

A pair is as hard as the hardest of what can be measured at its true pose: the share of the image that both cameras see,
the change of scale, the angle between the cameras, and the error that the map states of its depth. How different the
two images look, which weather, light and season change, is a second axis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from relocbench.arrays import Array, Indices

Tier = Literal["easy", "medium", "hard", "extreme"]
TIERS: tuple[Tier, ...] = ("easy", "medium", "hard", "extreme")


@dataclass(frozen=True)
class Limits:
    """The most that a pair of a tier may demand."""

    least_overlap: float
    """of the two overlaps the smaller one"""
    most_scale_change: float
    most_angle_deg: float
    most_depth_error: float
    """sigma of a depth relative to the depth"""


LIMITS: dict[str, Limits] = {
    "easy": Limits(0.5, 1.15, 5.0, 0.015),
    "medium": Limits(0.2, 1.4, 25.0, 0.03),
    "hard": Limits(0.1, 1.8, 45.0, 0.06),
}
"""a pair beyond those of ``hard`` is ``extreme``: to give no answer may be right"""

MEASURES = ("overlap", "overlap_query", "scale_change", "angle_deg", "depth_error")
"""by which pairs are sorted, in the order of :func:`tiers`"""

LOOKS = ("alike", "changed", "different")
LEAST_SIMILARITY = {"alike": 0.8, "changed": 0.5}
"""the least correlation of patches; below both, images look ``different``"""


def tiers(overlap: Array, overlap_query: Array, scale_change: Array, angle_deg: Array, depth_error: Array) -> Indices:
    """The tier (N,) of pairs as an index into :data:`TIERS`; -1 where overlap, scale or angle are not known.

    Of a pair that shares something, every dataset knows the overlap seen from the query or the error of depth. Where
    both are missing, it was built when neither was measured, and its pairs have no tier.

    Args:
        overlap, overlap_query: (N,) shares of each image that the other camera sees; the second counts where known.
        scale_change: (N,) 1 or more; NaN counts as unknown, except where nothing is shared, which is ``extreme``.
        angle_deg: (N,) between the cameras.
        depth_error: (N,) relative; NaN, where the map states none, limits nothing.
    """
    shared = np.fmin(overlap, overlap_query)
    shared = np.where(np.isnan(overlap), np.nan, shared)
    out = np.full(len(shared), len(LIMITS), dtype=np.int64)
    for index, name in reversed(list(enumerate(LIMITS))):
        limits = LIMITS[name]
        inside = (shared >= limits.least_overlap) & (scale_change <= limits.most_scale_change)
        inside &= (angle_deg <= limits.most_angle_deg) & ~(depth_error > limits.most_depth_error)
        out[inside] = index
    before = np.isnan(overlap_query) & np.isnan(depth_error)
    unknown = np.isnan(shared) | np.isnan(angle_deg) | ((np.isnan(scale_change) | before) & (shared > 0))
    out[unknown] = -1
    return out


class Measured(Protocol):
    """A pair with its measures; None where one is not known."""

    @property
    def overlap(self) -> float | None: ...
    @property
    def overlap_query(self) -> float | None: ...
    @property
    def scale_change(self) -> float | None: ...
    @property
    def angle_deg(self) -> float | None: ...
    @property
    def depth_error(self) -> float | None: ...


def tiers_of(pairs: Iterable[Measured]) -> Indices:
    """The tier (N,) of pairs as :func:`tiers` has it."""
    rows = [[getattr(pair, name) for name in MEASURES] for pair in pairs]
    return tiers(*np.array(rows, dtype=np.float64).reshape(-1, len(MEASURES)).T)


def looks(similarity: Array) -> Indices:
    """How alike pairs look (N,), as an index into :data:`LOOKS`; -1 where that is not known."""
    bounds = list(LEAST_SIMILARITY.values())[::-1]
    out = len(bounds) - np.searchsorted(bounds, similarity, side="right")
    return np.where(np.isnan(similarity), -1, out).astype(np.int64)
