"""Is a registration right? Evidence for and against it, and a verdict with the reason in words.

That clouds fit is no proof: on periodic streets the best fit may be 25 m off. What counts is evidence of different
kinds, both ways: surfaces seen again, nothing standing where the other saw through, details that face along the
street, and how well each direction is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from relocbench.datasets.groundtruth.submaps.free_space import BeamVotes
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.geometry import apply, invert, robust_sigma

Array = NDArray[np.float64]

_SIGMA_M, _DRIFT_PER_M = 0.02, 0.01
"""of a distance from a plane near the nodes, and by how much a metre of odometry adds to it"""
_COSINE = 0.8
_LEVEL, _REACH_M = 1, 0.35
"""planes among which a piece of surface is looked for, and how near it must be"""
_FINE, _FINE_REACH_M, _NEARBY_M = 2, 0.25, 0.3
"""planes among which details are looked for, and where any surface at all counts as nearby"""
_SAME_PLACE_M = 2.5
"""what was measured from so near to where the other drive's sensors were, it could see as well; less than a lane, since
from the next lane, and facing the other way, other flanks are hidden"""
_AGREES = 2.5
"""standard deviations within which a point lies in a plane"""


@dataclass(frozen=True)
class Thresholds:
    """What a registration must show.

    Chosen on drives through the training district (Sunny against Overcast, Rain, Snow and Night, and the street of
    repeating facades, Sunny against Snow): each query node at its true place, at places slid by 2 to 30 m, turned by
    2, 4 and 180 degrees and on other streets, all refined and then judged. Right poses had an overlap of 0.88 and more
    and violations of 0.04 and less; wrong ones overlaps of up to 0.89, the highest a single period away among
    repeating facades. The limits leave room for scenes that change more. They alone do not tell such neighbours
    apart: the comparison of hypotheses over a stretch of road does.
    """

    least_seen: float = 0.08
    """share of the structure that the other drive's beams reached or passed: below, there is too little to judge"""
    least_overlap: float = 0.75
    most_violations: float = 0.12
    least_detail: float = 0.45
    most_residual_m: float = 0.05
    most_sigma_m: float = 0.3
    """along the weakest direction"""
    most_sigma_deg: float = 0.5


@dataclass(frozen=True)
class _OneWay:
    overlap: float
    seen: float
    violations: float


def gather_evidence(ref: PreparedSubmap, query: PreparedSubmap, T_ref_query: Array, information: Array) -> Evidence:
    """What two submaps say of a pose.

    Args:
        information: (6, 6) of the pose, as :class:`relocbench.datasets.groundtruth.icp.icp.Refined` has it.
    """
    T_query_ref = invert(T_ref_query)
    of_ref = _one_way(ref, query, T_query_ref)
    of_query = _one_way(query, ref, T_ref_query)
    detail_ref, residual_ref = _details(ref.planes, query.planes, T_query_ref)
    detail_query, residual_query = _details(query.planes, ref.planes, T_ref_query)
    sigma, direction, sigma_deg = weakest(information, T_ref_query)
    return Evidence(
        overlap_ref=of_ref.overlap,
        overlap_query=of_query.overlap,
        residual_ref_m=residual_ref,
        residual_query_m=residual_query,
        violations_ref=of_ref.violations,
        violations_query=of_query.violations,
        weakest_sigma_m=sigma,
        weakest_direction=direction,
        weakest_sigma_deg=sigma_deg,
        seen_ref=of_ref.seen,
        seen_query=of_query.seen,
        detail_ref=detail_ref,
        detail_query=detail_query,
    )


def _one_way(this: PreparedSubmap, other: PreparedSubmap, T_other_this: Array) -> _OneWay:
    """This submap's pieces of surface by the other's beams and planes."""
    patches = this.space.patches
    votes: BeamVotes = this.space.votes_of(other.space.beams, invert(T_other_this))
    planes = other.planes.level(_LEVEL)
    there, facing = apply(T_other_this, patches.middle), patches.normals @ T_other_this[:3, :3].T
    match = planes.nearest(there, facing, _REACH_M, _COSINE)
    found = match >= 0
    residual = np.einsum("vi,vi->v", planes.normals[match], there - planes.points[match])
    spread = np.hypot(_SIGMA_M, _DRIFT_PER_M * planes.lever_lengths_m[match])
    found &= np.abs(residual) <= 2 * _AGREES * spread
    met = found | (votes.through + votes.reached > 0)
    sensor_positions = apply(invert(T_other_this), other.space.sensor_positions)
    same_place = cKDTree(sensor_positions).query(patches.origins, distance_upper_bound=_SAME_PLACE_M)[0] < _SAME_PLACE_M
    could_see, everything = float(patches.weights[met | same_place].sum()), float(patches.weights.sum())
    return _OneWay(
        overlap=float(patches.weights[found].sum()) / could_see if could_see > 0 else float("nan"),
        seen=float(patches.weights[met].sum()) / everything if everything > 0 else 0.0,
        violations=votes.violations(found),
    )


def _details(this: PlaneMap, other: PlaneMap, T_other_this: Array) -> tuple[float, float]:
    """Share of this submap's sampled planes that agree with the other, and the robust sigma of their distances."""
    sample, planes = this.sample(_FINE), other.level(_FINE)
    there, facing = apply(T_other_this, sample.points), sample.normals @ T_other_this[:3, :3].T
    nearby = planes.nearest(there, np.zeros_like(there), _NEARBY_M) >= 0
    match = planes.nearest(there, facing, _FINE_REACH_M, _COSINE)
    rows = np.flatnonzero(match >= 0)
    if not len(rows):
        return (0.0 if nearby.any() else float("nan")), float("nan")
    match = match[rows]
    residual = np.einsum("ni,ni->n", planes.normals[match], there[rows] - planes.points[match])
    away = np.hypot(sample.lever_lengths_m[rows], planes.lever_lengths_m[match])
    standard = residual / np.hypot(1.0, _DRIFT_PER_M / _SIGMA_M * away)
    agree = np.abs(standard) <= _AGREES * _SIGMA_M
    sigma = robust_sigma(standard, 1 / (1 + np.square(_DRIFT_PER_M / _SIGMA_M * away)))
    return float(np.count_nonzero(agree) / np.count_nonzero(nearby)), sigma


def weakest(information: Array, T_ref_query: Array) -> tuple[float, tuple[float, float, float], float]:
    """Sigma in metres along the direction known least, that direction in the reference's axes, and sigma in degrees."""
    if not np.isfinite(information).all() or np.linalg.eigvalsh(information)[0] <= 0:
        return float("inf"), (float("nan"),) * 3, float("inf")
    covariance = np.linalg.inv(information)
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    x, y, z = (float(v) for v in T_ref_query[:3, :3] @ vectors[:, -1])
    sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1])))
    return float(np.sqrt(values[-1])), (x, y, z), sigma_deg


def verdict(evidence: Evidence, thresholds: Thresholds | None = None) -> str:
    """Why a pose is not trusted; empty if it is. What is missing counts against it."""
    t = thresholds or Thresholds()
    e = evidence
    sides = (("reference", "query", e.seen_ref, e.overlap_ref, e.violations_ref, e.detail_ref, e.residual_ref_m),
             ("query", "reference", e.seen_query, e.overlap_query, e.violations_query, e.detail_query,
              e.residual_query_m))  # fmt: skip
    for this, other, seen, *_ in sides:
        if not seen >= t.least_seen:
            return f"too little in common: the {other}'s beams met {_percent(seen)} of the {this}'s walls"
    for this, other, _, _, violations, *_ in sides:
        if not violations <= t.most_violations:
            return f"free space: {_percent(violations)} of the {this}'s walls stand where the {other} saw through"
    for this, other, _, overlap, *_ in sides:
        if not overlap >= t.least_overlap:
            return f"overlap {_percent(overlap)}: of the {this}'s walls that the {other} could see"
    for this, other, _, _, _, detail, _ in sides:
        if not detail >= t.least_detail:
            return f"details: {_percent(detail)} of the {this}'s surfaces of all directions lie in one of the {other}'s"
    for this, other, *_, residual in sides:
        if not residual <= t.most_residual_m:
            return f"residual: the {this}'s points lie {residual:.3f} m off the {other}'s planes"
    if not e.weakest_sigma_m <= t.most_sigma_m:
        return f"weak {_direction(e.weakest_direction)}: {e.weakest_sigma_m:.1f} m"
    if not e.weakest_sigma_deg <= t.most_sigma_deg:
        return f"weak rotation: {e.weakest_sigma_deg:.1f} deg"
    return ""


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "nothing"


def _direction(direction: tuple[float, float, float]) -> str:
    if not np.isfinite(direction).all():
        return "in every direction"
    return ("along the street", "across the street", "in height")[int(np.argmax(np.abs(direction)))]
