"""Drives that fit each other only if one of them is stretched: the scale of one of the odometries is wrong.

A submap along odometry that is 8 % too long is 8 % too long, and no pose puts it onto the other drive's. That two
drives do not fit each other is a poor reason to be told if the cause can be found: where no registration holds, the
query's submaps are stretched by several factors, and registered again. The result names the cause; no pose comes from
it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

from relocbench.datasets.groundtruth.odometry.length import LengthRatio
from relocbench.datasets.groundtruth.registration.hypotheses import (
    HypothesisOptions,
    SearchResult,
    choose_hypothesis,
    follow,
    plausibility,
    with_alternatives,
)
from relocbench.datasets.groundtruth.registration.lengths import ratio_of_lengths
from relocbench.datasets.groundtruth.registration.submap_pair import Guess, PreparedDrive, RegisterOptions
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions
from relocbench.datasets.groundtruth.verification.evidence import Registration

_PERCENT = (-12, -10, -8, -6, -4, 0, 4, 6, 8, 10, 12)
"""stretches of the query's odometry that are tried; smaller ones are estimated with the poses"""
_MOST_TRIED = 4
"""guesses that are registered with each of them, those that fit best"""


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
        guesses: of its pose; called when they are needed first.
        remember: called with every piece of work that takes long and a key that identifies it.
    """
    once = cache(guesses)
    few = replace(hypotheses, most_tried=_MOST_TRIED)
    closely = replace(few, step_m=4.0)

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
    along = follow(ref, stretched(percent), best, closely, register_options)[1]
    return ratio_of_lengths(sorted(along, key=lambda one: one.query), ref.nodes, query.nodes)
