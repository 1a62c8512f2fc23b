"""Place recognition: guesses of where in the reference a node of the query is, from GNSS or from features alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.registration.global_registration import (
    GlobalOptions,
    Prior,
    guesses,
)
from relocbench.datasets.groundtruth.registration.submap_pair import Guess, PreparedDrive, nodes_every
from relocbench.geometry import invert

_PLACES_M = 25.0
"""distance between the nodes of the reference that features are compared at"""


@dataclass(frozen=True, eq=False)
class MapPrior:
    """Poses of the nodes of both drives on a map, by GNSS; each drive has errors of its own."""

    T_map_ref: Array
    """(K, 4, 4) of the reference's nodes, nan where unknown"""
    T_map_query: Array
    """(L, 4, 4) of the query's nodes, nan where unknown"""
    sigma_m: float = 10.0
    """standard deviation of the position of each drive"""
    sigma_heading_deg: float = 5.0
    """standard deviation of the heading of each drive; from 60 on it counts as unknown"""

    def between(self, ref: int, query: int) -> Prior:
        """The prior for the relative pose of a pair of nodes."""
        T_ref_query = invert(self.T_map_ref[ref]) @ self.T_map_query[query]
        return Prior(T_ref_query, float(np.sqrt(2) * self.sigma_m), float(np.sqrt(2) * self.sigma_heading_deg))

    def allows(self, ref: int, query: int, T_ref_query: Array) -> bool:
        """Whether the relative pose of a pair of nodes is within three standard deviations."""
        return self.between(ref, query).allows(T_ref_query)

    def nearest(self, query: int) -> int:
        """The reference node nearest to a query node; -1 if no position is known."""
        apart = np.linalg.norm(self.T_map_ref[:, :3, 3] - self.T_map_query[query, :3, 3], axis=1)
        return int(np.nanargmin(apart)) if np.isfinite(apart).any() else -1


def guesses_of_node(
    ref: PreparedDrive, query: PreparedDrive, prior: MapPrior | None, node: int, options: GlobalOptions
) -> list[Guess]:
    """The prior itself and the guesses by features within its limits, at the nearest reference node; none if that node
    is too far away to show the same place. Without a prior of the node, those all along the reference."""
    r = prior.nearest(node) if prior is not None else -1
    if prior is None or r < 0:
        return guesses_by_features(ref, query, node, options)
    limits = prior.between(r, node)
    if float(np.linalg.norm(limits.T_ref_query[:3, 3])) > 3 * limits.sigma_m:
        return []
    a, b = ref.features(r, options), query.features(node, options)
    return [(r, node, T) for T in [_levelled(limits.T_ref_query), *guesses(a, b, limits, options)]]


def guesses_by_features(ref: PreparedDrive, query: PreparedDrive, node: int, options: GlobalOptions) -> list[Guess]:
    """Guesses by features at nodes all along the reference. This takes minutes for kilometres of road."""
    features = query.features(node, options)
    once = replace(options, seeds=options.seeds[:1])
    candidates: list[Guess] = []
    for r in nodes_every(ref.nodes, _PLACES_M):
        candidates += [(r, node, T) for T in guesses(ref.features(r, options), features, None, once)]
    return candidates


def _levelled(T_ref_query: Array) -> Array:
    """The pose without its height: both nodes are on the road, and the height of GNSS is less accurate than that."""
    T = np.array(T_ref_query)
    T[2, 3] = 0.0
    return T
