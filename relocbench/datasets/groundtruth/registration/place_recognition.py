"""Where in the reference could a node of the query be? By a map that both drives know, or by looking everywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.registration.global_registration import (
    Features,
    GlobalOptions,
    Prior,
    describe,
    guesses,
)
from relocbench.datasets.groundtruth.registration.submap_pair import PreparedDrive
from relocbench.geometry import invert

Array = NDArray[np.float64]
Guess = tuple[int, int, Array]

_PLACES_M = 25.0
"""between the places of the reference that are looked at"""


@dataclass(frozen=True, eq=False)
class MapPrior:
    """Where the nodes of both drives are on a map, each drive with errors of its own."""

    T_map_ref: Array
    """(K, 4, 4) of the reference's nodes, NaN where not known"""
    T_map_query: Array
    """(L, 4, 4) of the query's nodes, NaN where not known"""
    sigma_m: float = 10.0
    """of each drive's position"""
    sigma_heading_deg: float = 5.0
    """of each drive's heading; 60 and more: not known"""

    def between(self, ref: int, query: int) -> Prior:
        """What it says of a pair of nodes."""
        T_ref_query = invert(self.T_map_ref[ref]) @ self.T_map_query[query]
        return Prior(T_ref_query, float(np.sqrt(2) * self.sigma_m), float(np.sqrt(2) * self.sigma_heading_deg))

    def allows(self, ref: int, query: int, T_ref_query: Array) -> bool:
        """Whether a pose of a pair is within three standard deviations."""
        return self.between(ref, query).allows(T_ref_query)

    def nearest(self, query: int) -> int:
        """The reference's node that lies nearest to a query's node, -1 where nothing is known."""
        apart = np.linalg.norm(self.T_map_ref[:, :3, 3] - self.T_map_query[query, :3, 3], axis=1)
        return int(np.nanargmin(apart)) if np.isfinite(apart).any() else -1


def guesses_by_prior(
    ref: PreparedDrive, query: PreparedDrive, prior: MapPrior, node: int, options: GlobalOptions
) -> list[Guess]:
    """The prior itself and what features say within its limits, at the nearest node of the reference; none if that is
    too far away for both to be the same place."""
    r = prior.nearest(node)
    if r < 0:
        return guesses_by_features(ref, query, node, options)
    limits = prior.between(r, node)
    if float(np.linalg.norm(limits.T_ref_query[:3, 3])) > 3 * limits.sigma_m:
        return []
    a, b = describe(ref.at(r).submap, options), describe(query.at(node).submap, options)
    return [(r, node, T) for T in [_levelled(limits.T_ref_query), *guesses(a, b, limits, options)]]


def guesses_by_features(ref: PreparedDrive, query: PreparedDrive, node: int, options: GlobalOptions) -> list[Guess]:
    """What features say at places all along the reference: minutes for kilometres, so give a prior if there is one."""
    features: Features = describe(query.at(node).submap, options)
    once = replace(options, seeds=options.seeds[:1])
    found: list[Guess] = []
    for r in ref.every(_PLACES_M):
        found += [(r, node, T) for T in guesses(describe(ref.at(r).submap, options), features, None, once)]
    return found


def _levelled(T_ref_query: Array) -> Array:
    """Both nodes stand on the road: heights of GNSS are worse than that."""
    T = np.array(T_ref_query)
    T[2, 3] = 0.0
    return T
