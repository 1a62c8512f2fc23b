"""Pairing of queries and keyframes whose distances follow a given distribution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import gamma

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.pairs.posed_frames import PosedFrames, pair_of
from relocbench.geometry import rotation_angle

_SHAPE = 4.0
"""shape of the gamma distribution, which gives a standard deviation of half its mean"""
_BOUNDS_M = (1.0, 2.0, 5.0)
"""bounds between the groups by distance"""


@dataclass(frozen=True)
class DistanceSpread:
    """Distribution of distances between keyframes and queries: a gamma distribution truncated at ``max_m``."""

    mean_m: float = 1.6
    max_m: float = 10.0
    max_angle_deg: float = 30.0

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw distances (count,) in metres."""
        law = gamma(_SHAPE, scale=self.mean_m / _SHAPE)
        return np.asarray(law.ppf(rng.uniform(0.0, law.cdf(self.max_m), size=count)))


def drawn_pairs(
    reference: PosedFrames,
    query: PosedFrames,
    spread: DistanceSpread,
    rng: np.random.Generator,
    *,
    same_traversal: bool,
) -> list[Pair]:
    """Pair each query frame with the keyframe whose distance is closest to a drawn one.

    Keyframes farther than ``max_m`` or turned by more than ``max_angle_deg`` are excluded and, within the same
    traversal, the frame itself. Queries without a keyframe have no pair. The truth is exact: its sigma is 0.
    """
    rows = np.array(reference.keyframe_rows, dtype=np.int64)
    T_world_keys = reference.T_world_cam[rows]
    pairs = []
    for q, wanted in enumerate(spread.draw(len(query.timestamps), rng)):
        T_world_query = query.T_world_cam[q]
        distance = np.linalg.norm(T_world_keys[:, :3, 3] - T_world_query[:3, 3], axis=1)
        near = np.nonzero(distance <= spread.max_m)[0]
        if same_traversal:
            near = near[rows[near] != q]
        turned = T_world_query[:3, :3].T @ T_world_keys[near, :3, :3]
        near = near[np.degrees(rotation_angle(turned)) <= spread.max_angle_deg]
        if not near.size:
            continue
        best = near[np.argmin(np.abs(distance[near] - wanted))]
        pair = pair_of(reference, int(rows[best]), query, q)
        pair = replace(pair, group=group_of(float(distance[best])), source="rendered poses")
        pairs.append(replace(pair, sigma_translation_m=0.0, sigma_rotation_deg=0.0))
    return pairs


def group_of(distance_m: float) -> str:
    """The group of a distance: ``under_1m``, ``1_to_2m``, ``2_to_5m`` or ``over_5m``."""
    low, middle, high = _BOUNDS_M
    if distance_m < low:
        return f"under_{low:g}m"
    if distance_m < middle:
        return f"{low:g}_to_{middle:g}m"
    return f"{middle:g}_to_{high:g}m" if distance_m < high else f"over_{high:g}m"
