"""Drives that fit each other only if one of them is stretched: the scale of one of the odometries is wrong.

A submap along odometry that is 8 % too long is 8 % too long, and no pose puts it onto the other drive's. That two
drives do not fit each other is a poor reason to be told if the cause can be found: where no registration holds, the
query's submaps are stretched by several factors, and registered again. Where some hold, the distances between them tell
the ratio. The result names the cause; no pose comes from it, since two drives tell the ratio of their scales, but not
which of them is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.registration.hypotheses import (
    HypothesisOptions,
    SearchResult,
    choose_hypothesis,
    follow,
    plausibility,
    with_alternatives,
)
from relocbench.datasets.groundtruth.registration.submap_pair import Guess, PreparedDrive, RegisterOptions
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions
from relocbench.datasets.groundtruth.verification.evidence import Registration

LARGEST_STRETCH = 0.04
"""largest error of the odometry's scale: submaps that are stretched more do not fit those of other drives"""
_PERCENT = (-12, -10, -8, -6, -4, 0, 4, 6, 8, 10, 12)
"""stretches of the query's odometry that are tried; smaller ones are estimated with the poses"""
_MOST_TRIED = 4
"""guesses that are registered with each of them, those that fit best"""
_APART_M = (20.0, 80.0)
"""metres driven between two registrations whose distance is compared"""
_TOLD = "the odometry is about"
_FEWEST = 3
"""distances that tell a ratio"""


def stretch_of_query(
    ref: PreparedDrive,
    query: PreparedDrive,
    node: int,
    guesses: Callable[[], Sequence[Guess]],
    shift: ShiftOptions,
    hypotheses: HypothesisOptions,
    register_options: RegisterOptions,
    remember: Callable[[str, Callable[[], SearchResult]], SearchResult],
) -> float | None:
    """How many times as long as the reference's the query's odometry is; None if no stretch makes them fit.

    Args:
        node: of the query.
        guesses: of its pose; called when they are needed first.
        remember: called with every piece of work that takes long and a key that identifies it.
    """
    once = cache(guesses)
    few = replace(hypotheses, most_tried=_MOST_TRIED)

    def stretched(percent: int) -> PreparedDrive:
        return query.stretched(1 / (1 + percent / 100))

    def tried(percent: int) -> SearchResult:
        drive = stretched(percent)
        starts = with_alternatives(ref, drive, once(), shift, few.most_tried)
        return choose_hypothesis(ref, drive, starts, few, register_options)

    fits: list[tuple[float, int, Registration]] = []
    for percent in _PERCENT:
        found = remember(f"stretch {node} by {percent}", partial(tried, percent)).best
        if found is not None:
            fits.append((plausibility(found.evidence), percent, found))
    _, percent, best = max(fits, key=lambda fit: fit[:2], default=(0.0, 0, None))
    if best is None or percent == 0:
        return None
    along = follow(ref, stretched(percent), best, few, register_options)[1]
    ratio = ratio_of_lengths(along, ref.nodes, query.nodes)
    return 1 + percent / 100 if ratio is None else ratio


def ratio_of_lengths(registrations: Sequence[Registration], ref: Nodes, query: Nodes) -> float | None:
    """How many times as long as the reference's the query's odometry is, by the distances between registrations.

    It is the median over all pairs of registrations that are 20 to 80 m of road apart; None if there are fewer than
    three.
    """
    chosen = [one for one in registrations if one.trusted]
    if len(chosen) < _FEWEST:
        return None
    r, q = (np.array([getattr(one, side) for one in chosen]) for side in ("ref", "query"))
    T_ref_query = np.array([one.T_ref_query for one in chosen])
    by_ref = (ref.T_odom_node[r] @ T_ref_query)[:, :3, 3]
    by_query = query.T_odom_node[q, :3, 3]
    a, b = np.triu_indices(len(chosen), 1)
    driven = np.abs(query.travelled_m[q[a]] - query.travelled_m[q[b]])
    usable = (driven >= _APART_M[0]) & (driven <= _APART_M[1])
    usable &= (ref.segments()[r[a]] == ref.segments()[r[b]]) & (query.segments()[q[a]] == query.segments()[q[b]])
    usable &= np.abs(ref.travelled_m[r[a]] - ref.travelled_m[r[b]]) <= 2 * _APART_M[1]
    longer, shorter = (np.linalg.norm(p[a] - p[b], axis=1)[usable] for p in (by_query, by_ref))
    known = np.minimum(longer, shorter) >= _APART_M[0] / 2
    if known.sum() < _FEWEST:
        return None
    return float(np.median(longer[known] / shorter[known]))


def told_of_stretch(ratio: float) -> str:
    """The words about odometry that is ``ratio`` times as long as the reference's."""
    by = f"{100 * abs(ratio - 1):.0f} % {'longer' if ratio > 1 else 'shorter'}"
    return f"{_TOLD} {by} than the reference's, so that the scale of one of them is wrong"


def is_stretched(registrations: Sequence[Registration]) -> bool:
    """Whether registrations were refused for the ratio of lengths."""
    return any(one.reason.startswith(_TOLD) for one in registrations)
