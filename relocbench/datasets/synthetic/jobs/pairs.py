"""Pairing of queries and keyframes whose distances follow a given distribution."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import gamma

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.pairs.posed_frames import PosedFrames, pair_of
from relocbench.geometry import rotation_angle

_SHAPE = 4.0
"""shape of the gamma distribution, which gives a standard deviation of half its mean"""
_BOUNDS_M = (1.0, 2.0, 5.0)
"""bounds between the groups by distance"""


@dataclass(frozen=True)
class DistanceSpread:
    """Which distances and angles keyframes and queries have, and how distances are distributed.

    Distances follow a gamma distribution with the given mean, truncated at ``max_m``. With a least distance, they are
    spread evenly from there to ``max_m``.
    """

    mean_m: float = 1.6
    max_m: float = 10.0
    max_angle_deg: float = 30.0
    min_m: float = 0.0
    min_angle_deg: float = 0.0

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Draw distances (count,) in metres."""
        if self.min_m > 0:
            return rng.uniform(self.min_m, self.max_m, size=count)
        law = gamma(_SHAPE, scale=self.mean_m / _SHAPE)
        return np.asarray(law.ppf(rng.uniform(0.0, law.cdf(self.max_m), size=count)))

    def is_far_enough(self, distance_m: Array) -> Mask:
        """Which of the distances are within the bounds."""
        return np.asarray((distance_m >= self.min_m) & (distance_m <= self.max_m))

    def is_turned_enough(self, angle_deg: Array) -> Mask:
        """Which of the angles are within the bounds."""
        return np.asarray((angle_deg >= self.min_angle_deg) & (angle_deg <= self.max_angle_deg))

    def __str__(self) -> str:
        if not self.min_m and not self.min_angle_deg:
            return f"within --max-distance {self.max_m:g} m and --max-angle {self.max_angle_deg:g} deg"
        return (
            f"{self.min_m:g} to {self.max_m:g} m away and turned by {self.min_angle_deg:g} to "
            f"{self.max_angle_deg:g} deg (--min-distance, --max-distance, --min-angle, --max-angle)"
        )


def drawn_pairs(
    reference: PosedFrames,
    query: PosedFrames,
    spread: DistanceSpread,
    rng: np.random.Generator,
    *,
    same_traversal: bool,
) -> list[Pair]:
    """Pair each query frame with the keyframe whose distance is closest to a drawn one.

    Keyframes outside the bounds of distance and angle are excluded and, within the same traversal, the frame itself.
    Queries without a keyframe have no pair. The truth is exact: its sigma is 0.
    """
    pairs = []
    drawn = spread.draw(len(query.timestamps), rng)
    candidates = _keyframes_of_queries(reference, query, same_traversal=same_traversal)
    for q, (rows, distance, angle) in enumerate(candidates):
        near = np.nonzero(spread.is_far_enough(distance) & spread.is_turned_enough(angle))[0]
        if not near.size:
            continue
        best = near[np.argmin(np.abs(distance[near] - drawn[q]))]
        pair = pair_of(reference, int(rows[best]), query, q)
        pair = replace(pair, group=group_of(float(distance[best])), source="rendered poses")
        pairs.append(replace(pair, sigma_translation_m=0.0, sigma_rotation_deg=0.0))
    return pairs


def nearest_miss(
    sides: Iterable[tuple[PosedFrames, PosedFrames]], spread: DistanceSpread, *, same_traversal: bool
) -> str:
    """What comes closest to the bounds where no keyframe of any query is within them, for a message.

    Args:
        sides: keyframes and queries.
    """
    seen = [one for side in sides for one in _keyframes_of_queries(*side, same_traversal=same_traversal)]
    distance, angle = (np.concatenate([one[k] for one in seen]) for k in (1, 2))
    far = spread.is_far_enough(distance)
    if not far.any():
        closest = np.argmin(np.maximum(spread.min_m - distance, distance - spread.max_m))
        return f"the nearest to that is {distance[closest]:.3g} m away"
    if (far & spread.is_turned_enough(angle)).any():
        return "those that are see nothing of any query"
    turned = angle[far]
    closest = np.argmin(np.maximum(spread.min_angle_deg - turned, turned - spread.max_angle_deg))
    return f"of those at such a distance, the nearest to that is turned by {turned[closest]:.3g} deg"


def _keyframes_of_queries(
    reference: PosedFrames, query: PosedFrames, *, same_traversal: bool
) -> Iterator[tuple[Indices, Array, Array]]:
    """For each query: rows (K,) of the keyframes it could have, their distances (K,) in metres, angles in degrees."""
    keyframes = np.array(reference.keyframe_rows, dtype=np.int64)
    for q, T_world_query in enumerate(query.T_world_cam):
        rows = keyframes[keyframes != q] if same_traversal else keyframes
        T_world_keys = reference.T_world_cam[rows]
        distance = np.linalg.norm(T_world_keys[:, :3, 3] - T_world_query[:3, 3], axis=1)
        turned = T_world_query[:3, :3].T @ T_world_keys[:, :3, :3]
        yield rows, distance, np.degrees(rotation_angle(turned))


def group_of(distance_m: float) -> str:
    """The group of a distance: ``under_1m``, ``1_to_2m``, ``2_to_5m`` or ``over_5m``."""
    low, middle, high = _BOUNDS_M
    if distance_m < low:
        return f"under_{low:g}m"
    if distance_m < middle:
        return f"{low:g}_to_{middle:g}m"
    return f"{middle:g}_to_{high:g}m" if distance_m < high else f"over_{high:g}m"
