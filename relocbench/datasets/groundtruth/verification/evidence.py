"""A registration of one submap against another, and the evidence for and against it."""

from __future__ import annotations

from dataclasses import dataclass

from relocbench.arrays import Array


@dataclass(frozen=True)
class Evidence:
    """Evidence for and against the relative pose of two submaps; ``nan`` where nothing could be measured.

    Shares are of surface patches or planes of static points.
    """

    overlap_ref: float
    """share of the reference's structure that the query could have seen which the query measured as well"""
    overlap_query: float
    """the same, with the roles exchanged"""
    residual_ref_m: float
    """robust standard deviation of the distances from the reference's points to the query's planes"""
    residual_query_m: float
    """the same, with the roles exchanged"""
    violations_ref: float
    """share of the reference's structure reached or passed by the query's beams that the beams went through"""
    violations_query: float
    """the same, with the roles exchanged"""
    weakest_sigma_m: float
    """standard deviation of the position along its least certain direction"""
    weakest_direction: tuple[float, float, float]
    """that direction, in the reference node's frame"""
    weakest_sigma_deg: float
    """standard deviation of the rotation about its least certain axis"""
    seen_ref: float = float("nan")
    """share of the reference's structure that the query measured, or that its beams reached or passed"""
    seen_query: float = float("nan")
    """the same, with the roles exchanged"""
    detail_ref: float = float("nan")
    """share, of the reference's planes near any surface of the query, that lie in a plane of the query; planes are
    sampled evenly over directions, so that recesses, poles and corners count as much as long walls"""
    detail_query: float = float("nan")
    """the same, with the roles exchanged"""


@dataclass(frozen=True, eq=False)
class Registration:
    """The pose of a node of the query relative to a node of the reference, whether or not it is trusted."""

    ref: int
    """node of the reference drive"""
    query: int
    """node of the query drive"""
    T_ref_query: Array
    """(4, 4) node to node"""
    information: Array
    """(6, 6) information matrix of xi = (rho, phi) in ``T_ref_query @ se3_exp(xi)``, metres and radians"""
    evidence: Evidence
    reason: str = ""
    """why it is not trusted; empty if it is"""

    @property
    def trusted(self) -> bool:
        return not self.reason
