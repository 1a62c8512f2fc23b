"""The verdict on the pose of two clouds: which evidence it rests on, and why it is not trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from relocbench.datasets.groundtruth.clouds.distinct import Distinct
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.datasets.groundtruth.verification.verification import Thresholds, first_fault, percent

FreeSpaceKnown = Literal["both", "A", "B", "none"]
"""whose beams free space is judged by"""

WITH_FREE_SPACE = Thresholds()
INDOORS = Thresholds(least_seen=0.3, most_violations=0.06, least_overlap=0.8)
"""Limits for scenes without ground and with free space: rooms resemble each other more than streets do, and change
less. Right poses of simulated rooms had no violations and an overlap of 0.99, wrong ones violations from 0.08 on."""
CLUTTERED = Thresholds(least_seen=0.5, most_violations=0.04, least_overlap=0.6, least_detail=0.65)
"""Further limits for scenes without ground and with free space of which :data:`_CLUTTERED` agrees: of a depth camera,
much of what is far away is too noisy to be found again in the other view."""
WITHOUT_FREE_SPACE = Thresholds(least_seen=0.4, least_overlap=0.8, least_detail=0.6)
"""Limits where no beam tells what is empty: surfaces must agree better instead, and over more of both clouds."""
OUTDOORS = (
    Thresholds(most_violations=0.3, least_overlap=0.6, least_detail=0.8),
    Thresholds(least_seen=0.25, most_violations=0.3, least_overlap=0.3, least_detail=0.75),
)
"""Further limits for scenes with ground whose details agree far better than those of any wrong pose did (up to 0.67 on
simulated streets and real scans): with free space, for single scans in which all parked cars are others; without it,
for clouds that reach further than their points are dense. Rooms are not judged by them, since walls and floors of
different rooms have details that agree."""

_MISSED, _SPARE, _PRICE = 0.05, 0.15, 2.0
"""by how much a limit on a share may be missed at most if other shares make up for it, how much of what these have in
excess of their own limits counts, and how much of it each share that is missing takes. Near the limits, the
log-likelihood ratio of right and wrong poses is about linear in each share, twice as steep in violations, so that its
sum is judged."""
_SLACK = 0.08
"""by how much the limits on shares are wider for a pose that another one is compared with"""
_INDOORS, _CLUTTERED = Distinct(0.2, 0.6), Distinct(0.4, 0.45)
"""Least evidence besides three planes, for either limits indoors."""


@dataclass(frozen=True)
class Verdict:
    """Why a pose is not trusted, and what is known to judge it by."""

    reason: str
    """empty if the pose is trusted"""
    rests_on: str
    """the evidence in words"""
    slides: bool = False
    """whether all evidence holds, and only motions that the surfaces cannot tell are open"""


def free_space_known(a_sees: bool, b_sees: bool) -> FreeSpaceKnown:
    """Whose beams free space can be judged by."""
    if a_sees and b_sees:
        return "both"
    return "A" if a_sees else ("B" if b_sees else "none")


def judge(
    evidence: Evidence,
    scale: SceneScale,
    known: FreeSpaceKnown,
    distinct: Callable[[], Distinct] | None = None,
    open_motions: str = "",
) -> Verdict:
    """The verdict on enlarged evidence, with A as the reference and B as the query.

    Missing evidence counts against a pose, but for free space that no beam can tell of.

    Args:
        distinct: tells the evidence besides three planes, and is only called for poses that are not refused anyway;
            None outdoors, where both clouds have ground, which is no part of the evidence.
        open_motions: the motions that the surfaces cannot tell, in words; their sigma is no fault of the evidence, and
            no pose is trusted along them.
    """
    if open_motions:
        known_ones = replace(evidence, weakest_sigma_m=0.0, weakest_sigma_deg=0.0)
        held = judge(known_ones, scale, known, distinct)
        reason = f"{held.reason}; unobservable: {open_motions}" if held.reason else f"unobservable: {open_motions}"
        return Verdict(reason, held.rests_on, not held.reason)
    rests_on = {
        "both": "surfaces and free space of both clouds",
        "A": "surfaces of both clouds and free space seen by A; B's sensor is unknown",
        "B": "surfaces of both clouds and free space seen by B; A's sensor is unknown",
        "none": "surfaces of both clouds alone: free space could not be judged, since no sensor is known",
    }[known]
    if distinct is None:
        reason = _reason(evidence, scale, known, WITH_FREE_SPACE if known == "both" else WITHOUT_FREE_SPACE)
        if reason and not _reason(evidence, scale, known, OUTDOORS[0 if known == "both" else 1]):
            return Verdict("", f"{rests_on}; details that agree, though much else changed or was not measured twice")
        return Verdict(reason, rests_on)
    reason = _reason(evidence, scale, known, INDOORS if known == "both" else WITHOUT_FREE_SPACE)
    if not reason:
        return Verdict(_too_plain(distinct(), _INDOORS), rests_on)
    if known == "both" and not _reason(evidence, scale, known, CLUTTERED) and not _too_plain(distinct(), _CLUTTERED):
        return Verdict("", f"{rests_on}; many surfaces besides walls and a floor, though noise hides some of them")
    return Verdict(reason, rests_on)


def holds_nearly(evidence: Evidence, scale: SceneScale, known: FreeSpaceKnown, outdoors: bool) -> bool:
    """Whether a pose would be trusted by limits that are a little wider: it may be as good as one that is trusted.

    Of a cube's 24 poses, one may lie just inside a limit and the others just outside.
    """
    inside = (WITH_FREE_SPACE, *OUTDOORS[:1]) if outdoors else (INDOORS, CLUTTERED)
    without = (WITHOUT_FREE_SPACE, *OUTDOORS[1:]) if outdoors else (WITHOUT_FREE_SPACE,)
    limits = inside if known == "both" else without
    return any(first_fault(_as_known(evidence, known), _wider(t)) is None for t in limits)


def _wider(t: Thresholds) -> Thresholds:
    return replace(
        _missed(t, _SLACK),
        least_seen=0.8 * t.least_seen,
        most_residual_m=1.2 * t.most_residual_m,
        most_sigma_m=2 * t.most_sigma_m,
        most_sigma_deg=2 * t.most_sigma_deg,
    )


def _missed(t: Thresholds, by: float) -> Thresholds:
    """Limits on shares that are wider, on violations half as much."""
    return replace(
        t,
        least_overlap=t.least_overlap - by,
        most_violations=t.most_violations + by / 2,
        least_detail=t.least_detail - by,
    )


def _made_up_for(e: Evidence, known: FreeSpaceKnown, t: Thresholds) -> bool:
    """Whether shares that miss their limits a little are made up for by others that exceed theirs."""
    if first_fault(e, _missed(t, _MISSED)) is not None:
        return False
    margins = [
        min(e.overlap_ref, e.overlap_query) - t.least_overlap,
        min(e.detail_ref, e.detail_query) - t.least_detail,
    ]
    if known == "both":
        margins.append(2 * (t.most_violations - max(e.violations_ref, e.violations_query)))
    return sum(min(m, _SPARE) if m >= 0 else _PRICE * m for m in margins) >= 0


def _as_known(e: Evidence, known: FreeSpaceKnown) -> Evidence:
    """Evidence without the free space that no beam tells of; A's beams tell of violations of B's surfaces."""
    if known in ("A", "none"):
        e = replace(e, violations_ref=0.0)
    if known in ("B", "none"):
        e = replace(e, violations_query=0.0)
    return e


def _too_plain(distinct: Distinct, least: Distinct) -> str:
    if not distinct.share >= least.share:
        return f"plain: {percent(distinct.share)} of what agrees lies outside of three planes, which fit any corner"
    if not distinct.overlap >= least.overlap:
        share = percent(distinct.overlap)
        return f"overlap: outside of three planes the other cloud measured {share} of what it could see"
    return ""


def _reason(e: Evidence, scale: SceneScale, known: FreeSpaceKnown, t: Thresholds) -> str:
    e = _as_known(e, known)
    fault = first_fault(e, t)
    if fault is None or _made_up_for(e, known, t):
        return ""
    this, other = ("B", "A") if fault.of_query else ("A", "B")
    share, metres = percent(fault.value), fault.value / scale.factor
    return {
        "seen": f"too little in common: {other} measured or saw through {share} of {this}'s surfaces",
        "violations": f"free space: {share} of {this}'s surfaces are where {other} saw through",
        "overlap": f"overlap: {other} measured {share} of {this}'s surfaces that it could see",
        "detail": f"details: {share} of {this}'s surfaces of all directions lie in one of {other}'s",
        "residual": f"residual: {this}'s points lie {metres:.2g} m off {other}'s surfaces",
        "position": f"weak {_direction(e.weakest_direction)}: sigma {metres:.2g} m",
        "rotation": f"weak rotation: sigma {fault.value:.1f} deg",
    }[fault.test]


def _direction(direction: tuple[float, float, float]) -> str:
    if not np.isfinite(direction).all():
        return "in every direction"
    return f"along ({', '.join(f'{x:.2f}' for x in direction)}) of A"
