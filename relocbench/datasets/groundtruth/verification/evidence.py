"""One drive registered against another at one place, and everything that speaks for and against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """What two submaps say of a pose. Shares are of thinned, steady points; ``nan`` where nothing could be judged."""

    overlap_ref: float
    """share of the reference's structure, of what the query could have seen, that the query has as well"""
    overlap_query: float
    """the same the other way round"""
    residual_ref_m: float
    """robust standard deviation of the distances from reference points to the query's planes"""
    residual_query_m: float
    violations_ref: float
    """share of the reference's structure, of what the query's beams reached or passed, that they went through"""
    violations_query: float
    weakest_sigma_m: float
    """standard deviation along the direction that is known least"""
    weakest_direction: tuple[float, float, float]
    """of the reference node's axes"""
    weakest_sigma_deg: float
    seen_ref: float = float("nan")
    """share of the reference's structure that the query's beams reached or passed: how much there was to judge"""
    seen_query: float = float("nan")
    detail_ref: float = float("nan")
    """of the reference's planes with the query's surface nearby, drawn evenly over directions, the share that lies in
    a plane of the query: recesses, poles and corners count as much as long walls"""
    detail_query: float = float("nan")


@dataclass(frozen=True, eq=False)
class Registration:
    """The query's node seen from the reference's node."""

    ref: int
    """node of the reference drive"""
    query: int
    """node of the query drive"""
    T_ref_query: Array
    """(4, 4) node to node"""
    information: Array
    """(6, 6) of the twist xi = (rho, phi) in ``T_ref_query @ se3_exp(xi)``, metres and radians"""
    evidence: Evidence
    reason: str = ""
    """why it is not trusted; empty if it is"""

    @property
    def trusted(self) -> bool:
        return not self.reason
