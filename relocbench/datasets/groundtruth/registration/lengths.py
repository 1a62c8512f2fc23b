"""The lengths of two drives by their odometries, compared by the registrations between them.

Two drives tell the ratio of the scales of their odometries, but not which of them is wrong. Beyond a few per cent their
submaps do not fit each other: one along odometry that is 8 % too long is 8 % too long, and no pose puts it onto the
other drive's. Where no registration holds for this reason, the query's submaps are stretched by several factors, and
registered again. The result names the cause; no pose comes from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.stats import theilslopes

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.odometry.length import LengthRatio
from relocbench.datasets.groundtruth.registration.hypotheses import (
    HypothesisOptions,
    SearchResult,
    choose_hypothesis,
    follow,
    plausibility,
    settle,
    with_alternatives,
)
from relocbench.datasets.groundtruth.registration.submap_pair import Guess, PreparedDrive, RegisterOptions
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.geometry import invert

_FAR_M = 30.0
"""metres that the query drove between registrations that follow each other, and half of what the reference drove"""
_FEWEST = 8
"""registrations that tell a ratio"""
_MOST = 2000
"""registrations that are compared with each other"""
_DOUBT = 0.002
"""probability that the true ratio is outside the margin"""
_FEW = 0.6
"""share of trusted registrations below which they may hold by chance"""
_SHORT_M = 60.0
"""registered length of road, a submap's, below which they may"""
_PERCENT = (-12, -8, -4, 0, 4, 8, 12)
"""stretches of the query's odometry that are tried; what is between them is estimated with the poses"""
_MOST_SETTLED = 3
"""guesses that are registered coarsely with each of them, those that fit best"""
_MOST_STRETCHES = 3
"""stretches with which they are registered to the end, those that fit best"""
_PREFIX = "the odometry is about"


def ratio_of_lengths(registrations: Sequence[Registration], ref: Nodes, query: Nodes) -> LengthRatio | None:
    """How many times as long as the reference's the query's odometry is, by the registrations along the road.

    The way of the query from one registration to the next is measured by both odometries, in the direction that the
    query drove, so that neither drift of the heading nor noise makes it longer. The ratio is the slope of one way over
    the other by Theil and Sen: the median over all pairs of registrations, of which some may be wrong.

    Returns:
        the ratio and its margin; None if fewer than eight registrations follow each other, or the query stands still.
    """
    way_ref, way_query = _ways(registrations, ref, query)
    if len(way_query) < _FEWEST or not np.ptp(way_query) > 0:
        return None
    every = -(-len(way_query) // _MOST)
    slope, _, low, high = theilslopes(way_ref[::every], way_query[::every], alpha=1 - _DOUBT)
    if not low > 0:
        return None
    return LengthRatio(float(1 / slope), float(max(1 / low - 1 / slope, 1 / slope - 1 / high)))


def _ways(registrations: Sequence[Registration], ref: Nodes, query: Nodes) -> tuple[Array, Array]:
    """(M,), (M,) the query's way up to each of the most registrations that follow each other, by both odometries."""
    of_ref, of_query = ref.segments(), query.segments()
    best: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
    ways: list[tuple[float, float]] = []
    before: Registration | None = None
    for now in (one for one in registrations if one.trusted):
        connected = (
            before is not None
            and of_ref[before.ref] == of_ref[now.ref]
            and of_query[before.query] == of_query[now.query]
            and abs(query.travelled_m[now.query] - query.travelled_m[before.query]) <= _FAR_M
            # On another lap of the reference, the drift of a whole lap would count as way.
            and abs(ref.travelled_m[now.ref] - ref.travelled_m[before.ref]) <= 2 * _FAR_M
        )
        if before is None or not connected:
            ways = [(0.0, 0.0)]
        else:
            by_query = invert(query.T_odom_node[before.query]) @ query.T_odom_node[now.query]
            T_odom_before, T_odom_now = (ref.T_odom_node[one.ref] @ one.T_ref_query for one in (before, now))
            by_ref = invert(T_odom_before) @ T_odom_now
            driven = float(np.linalg.norm(by_query[:3, 3]))
            along = float(by_ref[:3, 3] @ by_query[:3, 3]) / driven if driven > 0 else 0.0
            ways.append((ways[-1][0] + along, ways[-1][1] + driven))
        if len(ways) > len(best[0]):
            best = tuple(np.array(ways).T)
        before = now
    return best


def may_hold_by_chance(registrations: list[Registration], step_m: float) -> bool:
    """Whether few registrations are trusted of those whose submaps were compared, or little road of the whole drive.

    Some hold by chance in spite of a stretch. A place that fits by chance may lead off the reference's road at once,
    where nothing is compared.

    Args:
        step_m: distance between the nodes that are registered.
    """
    trusted = sum(one.trusted for one in registrations)
    compared = sum(bool(np.isfinite(one.evidence.overlap_query)) for one in registrations)
    return trusted < _FEW * max(compared, 1) or (trusted * step_m < _SHORT_M and trusted < _FEW * len(registrations))


def length_mismatch_message(ratio: LengthRatio) -> str:
    """The words about odometry that is longer or shorter than the reference's."""
    return f"{_PREFIX} {ratio.words(0)} than the reference's, so that the scale of one of them is wrong"


def is_stretched(registrations: Sequence[Registration]) -> bool:
    """Whether registrations were refused for the ratio of lengths."""
    return any(one.reason.startswith(_PREFIX) for one in registrations)


def stretch_of_query(
    ref: PreparedDrive,
    query: PreparedDrive,
    node: int,
    guesses: Callable[[], Sequence[Guess]],
    shift: ShiftOptions,
    hypotheses: HypothesisOptions,
    register_options: RegisterOptions,
    remember: Callable[[str, Callable[[], SearchResult]], SearchResult],
) -> LengthRatio | None:
    """How many times as long as the reference's the query's odometry is; None if no stretch makes them fit.

    Args:
        node: of the query.
        guesses: makes guesses of its pose.
        remember: called with every piece of work that takes long and a key that identifies it.
    """
    starts = with_alternatives(ref, query, guesses(), shift, _MOST_SETTLED)
    closely = replace(hypotheses, step_m=4.0)

    def stretched(percent: int) -> PreparedDrive:
        return query.stretched(1 / (1 + percent / 100))

    def tried(percent: int) -> SearchResult:
        return choose_hypothesis(ref, stretched(percent), starts, hypotheses, register_options)

    how_well: list[tuple[float, int]] = []
    for percent in _PERCENT if starts else ():
        drive = stretched(percent)
        how_well.append((max(settle(ref, drive, guess, shift).fit for guess in starts), percent))
    promising = [percent for fit, percent in sorted(how_well, reverse=True) if fit >= hypotheses.poor_fit]
    fits: list[tuple[float, int, Registration]] = []
    for percent in promising[:_MOST_STRETCHES]:
        registration = remember(f"stretch {node} by {percent}", partial(tried, percent)).best
        if registration is not None:
            fits.append((plausibility(registration.evidence), percent, registration))
    _, percent, best = max(fits, key=lambda fit: fit[:2], default=(0.0, 0, None))
    if best is None or percent == 0:
        return None
    along = follow(ref, stretched(percent), best, closely, register_options)[1]
    return ratio_of_lengths(sorted(along, key=lambda one: one.query), ref.nodes, query.nodes)
