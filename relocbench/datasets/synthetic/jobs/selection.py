"""Which of the planned pairs a rendered pair set keeps: those of a tier, some of many, not on the repeating street."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.pairs.correspondences import PairCorrespondences
from relocbench.datasets.pairs.measures import PairMeasures
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.metrics.pose.tiers import TIERS, Tier, tiers

REPEATING = "repeating_street"
"""the group of the pairs on the street whose houses repeat themselves"""
_STREET_M = 9.0
"""half the width of a street from house to house, at least"""
_MARGIN = 0.02
"""by which share the measures of a pair may change without changing its tier: on another processor they do, a little"""


@dataclass(frozen=True)
class Selection:
    """What a pair set keeps of the pairs that were drawn."""

    tier: Tier | None = None
    most: int | None = None
    """pairs, evenly along the drive; None for all"""

    @property
    def keeps_all(self) -> bool:
        return self.tier is None and self.most is None

    def of(self, pairs: Sequence[Pair], found: Mapping[PairKey, PairCorrespondences]) -> list[Pair]:
        """The pairs that are kept, in their order.

        Args:
            found: by the key of a pair, what was measured of it.
        """
        kept = list(pairs)
        if self.tier is not None:
            tiers_of = clear_tiers(pairs, [found[pair.key].measures for pair in pairs])
            kept = [pair for pair, tier in zip(pairs, tiers_of, strict=True) if tier == TIERS.index(self.tier)]
        if self.most is not None and len(kept) > self.most:
            by_time = sorted(kept, key=lambda pair: pair.query_timestamp_ns)
            rows = np.linspace(0, len(by_time) - 1, self.most).round().astype(int)
            keys = {by_time[row].key for row in rows}
            kept = [pair for pair in kept if pair.key in keys]
        return kept


def clear_tiers(pairs: Sequence[Pair], measures: Sequence[PairMeasures]) -> Indices:
    """The tier (N,) of pairs as an index into :data:`TIERS`; -1 where it is not known, or too close to a limit."""

    def with_margin(by: float) -> Indices:
        columns = [
            _column([m.overlap for m in measures]) / by,
            _column([m.overlap_query for m in measures]) / by,
            _column([m.scale_change for m in measures]) ** by,
            _column([pair.angle_deg for pair in pairs]) * by,
            _column([m.depth_error for m in measures]) * by,
        ]
        return tiers(*columns)

    easier, harder = with_margin(1 - _MARGIN), with_margin(1 + _MARGIN)
    return np.where(easier == harder, easier, -1)


def _column(values: Sequence[float | None]) -> Array:
    return np.array(values, dtype=np.float64)


def on_repeating_street(place: DistrictSpec, T_world_cam: Array) -> Mask:
    """Which cameras (N, 4, 4) stand on the street whose houses repeat themselves."""
    district = scenes.district(place)
    corners = district.network.nodes[district.network.nodes_of(district.periodic.street)][:, :2]
    start, along = corners[:-1], np.diff(corners, axis=0)
    offset = T_world_cam[:, None, :2, 3] - start
    share = np.clip(np.sum(offset * along, axis=2) / np.sum(along * along, axis=1), 0, 1)
    away = np.linalg.norm(offset - share[..., None] * along, axis=2)
    return np.asarray(away.min(axis=1) <= _STREET_M)


def sorted_by_street(pairs: Sequence[Pair], repeats: Mapping[int, bool], *, avoid: bool) -> list[Pair]:
    """The pairs with those on the repeating street left out (``avoid``), or in a group of their own.

    Args:
        repeats: by time of a keyframe or query, whether its camera stands there.
    """
    there = [repeats[p.ref_timestamp_ns] or repeats[p.query_timestamp_ns] for p in pairs]
    if avoid:
        return [pair for pair, is_there in zip(pairs, there, strict=True) if not is_there]
    return [replace(p, group=REPEATING) if is_there else p for p, is_there in zip(pairs, there, strict=True)]
