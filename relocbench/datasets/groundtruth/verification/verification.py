"""Verification of a registration: the evidence for and against it, and the verdict with the reason in words.

A good fit of the clouds is no proof: on periodic streets the best fit may be 25 m off. The verdict needs evidence of
several kinds, from both sides: surfaces that both measured, free space, details that face along the street, and the
uncertainty in each direction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import ge, le
from typing import Literal, NamedTuple

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.submaps.free_space import BeamVotes
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.geometry import apply, invert, robust_sigma

_SIGMA_M, _DRIFT_PER_M = 0.02, 0.01
"""standard deviation of a distance from a plane near the nodes, and its growth with the lever arm"""
_COSINE = 0.8
"""cosine of the largest angle between the normals of a match"""
_LEVEL, _REACH_M = 1, 0.35
"""level of the planes that surface patches are matched to, and the largest distance of a match"""
_FINE, _FINE_REACH_M, _NEARBY_M = 2, 0.25, 0.3
"""level of the planes that details are matched to, the largest distance of a match, and that of any surface"""
_AGREES = 2.5
"""number of standard deviations within which a point lies in a plane"""


@dataclass(frozen=True)
class Thresholds:
    """Limits on the evidence for a registration that is trusted.

    They were chosen on drives through the training district (Sunny against Overcast, Rain, Snow and Night, and the
    street of repeating facades, Sunny against Snow): each query node was placed at its true pose, shifted by 2 to 30 m,
    turned by 2, 4 and 180 degrees, and on other streets, then registered by ICP and verified. Right poses had an
    overlap of at least 0.88 and violations of at most 0.04; wrong ones had overlaps of up to 0.89, the highest one
    period away among repeating facades. The limits leave room for scenes that change more. They alone cannot reject a
    shift by one period; following each hypothesis along the road can.
    """

    least_seen: float = 0.08
    """least :attr:`Evidence.seen_ref`: below it there is too little to compare"""
    least_overlap: float = 0.75
    most_violations: float = 0.12
    least_detail: float = 0.45
    most_residual_m: float = 0.05
    most_sigma_m: float = 0.3
    """largest standard deviation of the position along its least certain direction"""
    most_sigma_deg: float = 0.5


def verification_evidence(
    ref: PreparedSubmap, query: PreparedSubmap, T_ref_query: Array, information: Array
) -> Evidence:
    """The evidence for and against a pose of two submaps.

    Args:
        information: (6, 6) of the pose, as in :class:`relocbench.datasets.groundtruth.icp.icp.IcpResult`.
    """
    T_query_ref = invert(T_ref_query)
    overlap_ref, seen_ref, violations_ref = _one_way(ref, query, T_query_ref)
    overlap_query, seen_query, violations_query = _one_way(query, ref, T_ref_query)
    detail_ref, residual_ref = _details(ref.planes, query.planes, T_query_ref)
    detail_query, residual_query = _details(query.planes, ref.planes, T_ref_query)
    sigma, direction, sigma_deg = weakest(information, T_ref_query)
    return Evidence(
        overlap_ref=overlap_ref,
        overlap_query=overlap_query,
        residual_ref_m=residual_ref,
        residual_query_m=residual_query,
        violations_ref=violations_ref,
        violations_query=violations_query,
        weakest_sigma_m=sigma,
        weakest_direction=direction,
        weakest_sigma_deg=sigma_deg,
        seen_ref=seen_ref,
        seen_query=seen_query,
        detail_ref=detail_ref,
        detail_query=detail_query,
    )


@dataclass(frozen=True, eq=False)
class Compared:
    """What became of this submap's V surface patches when they were looked for in another."""

    found: Mask
    """(V,) the other measured a surface there"""
    met: Mask
    """(V,) found, or reached or passed by the other's beams"""
    expected: Mask
    """(V,) met, or measured from where the other could see them too"""
    votes: BeamVotes


def compare_patches(this: PreparedSubmap, other: PreparedSubmap, T_other_this: Array) -> Compared:
    """Look for this submap's surface patches among the planes and beams of another."""
    patches = this.space.patches
    votes = this.space.votes_of(other.space.beams, invert(T_other_this))
    planes = other.planes.level(_LEVEL)
    middle, facing = apply(T_other_this, patches.middle), patches.normals @ T_other_this[:3, :3].T
    match = planes.nearest(middle, facing, _REACH_M, _COSINE)
    found = match >= 0
    residual = np.einsum("vi,vi->v", planes.normals[match], middle - planes.points[match])
    spread = np.hypot(_SIGMA_M, _DRIFT_PER_M * planes.lever_lengths_m[match])
    found &= np.abs(residual) <= 2 * _AGREES * spread
    met = found | (votes.through + votes.reached > 0)
    return Compared(found, met, met | other.space.could_see(patches, invert(T_other_this)), votes)


def explained_by_one(
    ref: PreparedSubmap, query: PreparedSubmap, T_one: Array, T_other: Array
) -> tuple[float, float, float]:
    """How much structure of both submaps only one of two poses ``T_ref_query`` (4, 4) explains, only the other, and how
    much there is.

    What both poses explain, such as a facade that repeats itself, and what neither does say nothing of which is right
    (McNemar, Psychometrika 1947). The sums are of the weights of patches that the other drive met at both poses: beyond
    the ends of its submap it measured nothing, and that says nothing.
    """
    one = other = everything = 0.0
    sides = (query, ref, T_one, T_other), (ref, query, invert(T_one), invert(T_other))
    for this, that, T_first, T_second in sides:
        a, b = compare_patches(this, that, T_first), compare_patches(this, that, T_second)
        weights = np.where(a.met & b.met, this.space.patches.weights, 0.0)
        one += float(weights[a.found & ~b.found].sum())
        other += float(weights[b.found & ~a.found].sum())
        everything += float(weights.sum())
    return one, other, everything


def _one_way(this: PreparedSubmap, other: PreparedSubmap, T_other_this: Array) -> tuple[float, float, float]:
    """Overlap, share seen, and violations of this submap's patches by the beams and planes of the other."""
    compared = compare_patches(this, other, T_other_this)
    weights = this.space.patches.weights
    expected, everything = float(weights[compared.expected].sum()), float(weights.sum())
    overlap = float(weights[compared.found].sum()) / expected if expected > 0 else float("nan")
    seen = float(weights[compared.met].sum()) / everything if everything > 0 else 0.0
    return overlap, seen, compared.votes.violations(compared.found)


def _details(this: PlaneMap, other: PlaneMap, T_other_this: Array) -> tuple[float, float]:
    """Share of this submap's sampled planes that lie in planes of the other, and the robust sigma of the distances."""
    sample, planes = this.sample(_FINE), other.level(_FINE)
    moved, facing = apply(T_other_this, sample.points), sample.normals @ T_other_this[:3, :3].T
    nearby = planes.nearest(moved, np.zeros_like(moved), _NEARBY_M) >= 0
    match = planes.nearest(moved, facing, _FINE_REACH_M, _COSINE)
    rows = np.flatnonzero(match >= 0)
    if not len(rows):
        return (0.0 if nearby.any() else float("nan")), float("nan")
    match = match[rows]
    residual = np.einsum("ni,ni->n", planes.normals[match], moved[rows] - planes.points[match])
    away = np.hypot(sample.lever_lengths_m[rows], planes.lever_lengths_m[match])
    standard = residual / np.hypot(1.0, _DRIFT_PER_M / _SIGMA_M * away)
    agree = np.abs(standard) <= _AGREES * _SIGMA_M
    sigma = robust_sigma(standard, 1 / (1 + np.square(_DRIFT_PER_M / _SIGMA_M * away)))
    return float(np.count_nonzero(agree) / np.count_nonzero(nearby)), sigma


def weakest(information: Array, T_ref_query: Array) -> tuple[float, tuple[float, float, float], float]:
    """Sigma in metres along the least certain direction, that direction in the reference's frame, and the largest sigma
    of rotation in degrees; infinite if the information matrix is singular."""
    if not np.isfinite(information).all() or np.linalg.eigvalsh(information)[0] <= 0:
        return float("inf"), (float("nan"),) * 3, float("inf")
    covariance = np.linalg.inv(information)
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    x, y, z = (float(v) for v in T_ref_query[:3, :3] @ vectors[:, -1])
    sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1])))
    return float(np.sqrt(values[-1])), (x, y, z), sigma_deg


Test = Literal["seen", "violations", "overlap", "detail", "residual", "position", "rotation"]


class Fault(NamedTuple):
    """Evidence that is outside its limit."""

    test: Test
    of_query: bool
    """whether it is the query's surfaces that fail the test, rather than the reference's"""
    value: float
    """a share, metres, or degrees; nan if nothing could be measured"""


def first_fault(evidence: Evidence, thresholds: Thresholds) -> Fault | None:
    """The first evidence outside its limit, in the order of :class:`Fault`; missing evidence (nan) is outside."""
    e, t = evidence, thresholds
    tests: tuple[tuple[Test, float, float, float, Callable[[float, float], bool]], ...] = (
        ("seen", e.seen_ref, e.seen_query, t.least_seen, ge),
        ("violations", e.violations_ref, e.violations_query, t.most_violations, le),
        ("overlap", e.overlap_ref, e.overlap_query, t.least_overlap, ge),
        ("detail", e.detail_ref, e.detail_query, t.least_detail, ge),
        ("residual", e.residual_ref_m, e.residual_query_m, t.most_residual_m, le),
    )
    for test, of_ref, of_query, limit, holds in tests:
        for is_query, value in ((False, of_ref), (True, of_query)):
            if not holds(value, limit):
                return Fault(test, is_query, value)
    if not e.weakest_sigma_m <= t.most_sigma_m:
        return Fault("position", True, e.weakest_sigma_m)
    if not e.weakest_sigma_deg <= t.most_sigma_deg:
        return Fault("rotation", True, e.weakest_sigma_deg)
    return None


def verdict(evidence: Evidence, thresholds: Thresholds | None = None) -> str:
    """Why a pose is not trusted; empty if it is trusted. Missing evidence (nan) counts against it."""
    fault = first_fault(evidence, thresholds or Thresholds())
    if fault is None:
        return ""
    this, other = ("query", "reference") if fault.of_query else ("reference", "query")
    share = percent(fault.value)
    return {
        "seen": f"too little in common: the {other}'s beams met {share} of the {this}'s walls",
        "violations": f"free space: {share} of the {this}'s walls stand where the {other} saw through",
        "overlap": f"overlap {share}: of the {this}'s walls that the {other} could see",
        "detail": f"details: {share} of the {this}'s surfaces of all directions lie in one of the {other}'s",
        "residual": f"residual: the {this}'s points lie {fault.value:.3f} m off the {other}'s planes",
        "position": f"weak {_direction(evidence.weakest_direction)}: {fault.value:.1f} m",
        "rotation": f"weak rotation: {fault.value:.1f} deg",
    }[fault.test]


def percent(share: float) -> str:
    """A share in words."""
    return f"{100 * share:.0f} %" if np.isfinite(share) else "nothing"


def _direction(direction: tuple[float, float, float]) -> str:
    if not np.isfinite(direction).all():
        return "in every direction"
    return ("along the street", "across the street", "in height")[int(np.argmax(np.abs(direction)))]
