"""Choosing between several guesses of a pose: each is followed along the road, and must hold all the way.

At one place a wrong pose may look as good as the right one, or better. Predicted by both odometries over tens of metres
of road, a wrong one meets a gap, a crossing or a facade that is not there. Two drives along different parts of a street
whose facades repeat meet none of these. The pose that is chosen is therefore compared with every other that holds, and
with those that are shifted along the street until facades lie on facades again: of what only one of the two explains,
it must explain nearly all. If it does not, no pose is chosen. Lamps and trees that decide between poses a few metres
apart may themselves repeat in a longer period, beyond what two drives have in common. Where a shifted pose holds all
the way, something else must therefore say roughly where the drives are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, run_icp
from relocbench.datasets.groundtruth.registration.global_registration import SAME_M, distinct, pose_difference
from relocbench.datasets.groundtruth.registration.submap_pair import (
    Guess,
    PreparedDrive,
    RegisterOptions,
    predict,
    predict_in_reference,
    register,
)
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions, alternatives, fit, shifted_poses
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.datasets.groundtruth.verification.verification import explained_by_one
from relocbench.geometry import invert

_MOST_VARIED = 8
"""guesses that alternatives are made of"""
_COARSE = IcpOptions(scale_error_sigma=0.0)
_RIVALS_M = 12.0
"""how far along the street rivals of a pose are looked for, more than facades repeat in"""
CONFIRMED_M = 4.0
"""how near GNSS must put a pose on a street that repeats itself: in five of six drives whose GNSS is off by 1.5 m in
each direction it does, and a longer period of lamps or trees is more than twice as far"""
_SETTLED_APART_M = 0.5
"""poses after a coarse registration that differ by no more are one"""


@dataclass(frozen=True)
class HypothesisOptions:
    """Options that decide between several guesses of a pose."""

    follow_m: float = 50.0
    """length of road over which each hypothesis is followed"""
    step_m: float = 10.0
    """distance between the nodes at which it is registered"""
    most_followed: int = 5
    """number of hypotheses that are followed, the most plausible ones"""
    most_tried: int = 10
    """number of guesses that are registered to the end, those that fit best"""
    coarsely_tried: int = 16
    """number of guesses that are registered coarsely, to see how well they fit"""
    least_share: float = 0.75
    """share of the best fit that a guess must reach to be registered to the end"""
    poor_fit: float = 0.6
    """a fit below this is probably wrong: of right poses 0.7 to 0.9 of the surfaces fit"""
    few_tried: int = 2
    """number of guesses that are registered to the end if the best fit is poor, for the reason"""
    share: float = 0.7
    """share of the nodes at which a hypothesis must be trusted"""
    decisive: float = 0.75
    """the choice stays open if a rival holds and of the structure that only one of the two explains, less than this
    share is explained by the chosen one. On the training and validation districts it was 0.81 to 0.97 for right poses
    among repeating facades. Each wrong one had a rival against which it was at most 0.61"""
    least_decisive: float = 0.01
    """the same if less than this share of what was seen from both is explained by the chosen one alone"""
    margin: float = 0.03
    """the same if nothing can be seen from both, and the plausibility of the rival is lower by less than this"""
    least_m: float = 20.0
    """least length of road over which a hypothesis holds, or 0.7 of what it could be followed on the shorter drive; two
    drives that meet for less have too little in common"""
    nearest_m: float = 10.0
    """a hypothesis is followed no further than where the nearest reference node is this far away"""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The hypothesis that holds, or the reason why none does."""

    best: Registration | None
    reason: str = ""
    ambiguous: bool = False
    """whether several hold, so that searching further cannot help"""


def plausibility(evidence: Evidence) -> float:
    """A number to compare hypotheses by: 1 for perfect evidence, -1 for missing evidence.

    The smaller overlap less twice the larger share of violations.
    """
    values = (evidence.overlap_ref, evidence.overlap_query, evidence.violations_ref, evidence.violations_query)
    if not np.isfinite(values).all():
        return -1.0
    return float(min(values[:2]) - 2 * max(values[2:]))


@dataclass(frozen=True, eq=False)
class SettledGuess:
    """A guess after a coarse registration."""

    guess: Guess
    fit: float
    """share of both submaps' surfaces that lie near one of the other's, the mean of both"""


def settle(ref: PreparedDrive, query: PreparedDrive, guess: Guess, shift: ShiftOptions) -> SettledGuess:
    """Register a guess coarsely: a tenth of the work of a whole registration tells how well it will fit."""
    r, q, T = guess
    a, b = ref.at(r).planes, query.at(q).planes
    T = run_icp(a, b, T, _COARSE, levels=[0]).T_ref_query
    return SettledGuess((r, q, T), (fit(a, b, T, shift) + fit(b, a, invert(T), shift)) / 2)


def promising_guesses(
    ref: PreparedDrive, query: PreparedDrive, guesses: Sequence[Guess], options: HypothesisOptions
) -> list[Guess]:
    """The guesses that may be right, each registered coarsely, the best first; those that end at one pose are one."""
    shift = ShiftOptions()
    settled = [settle(ref, query, guess, shift) for guess in guesses[: options.coarsely_tried]]
    settled.sort(key=lambda one: -one.fit)
    settled = [settled[row] for row in distinct(_in_reference(ref, [one.guess for one in settled]), _SETTLED_APART_M)]
    best = settled[0].fit if settled else 0.0
    most = options.most_tried if best >= options.poor_fit else options.few_tried
    return [one.guess for one in settled if one.fit >= options.least_share * best][:most]


def with_alternatives(
    ref: PreparedDrive, query: PreparedDrive, guesses: Sequence[Guess], shift: ShiftOptions, most: int
) -> list[Guess]:
    """Guesses and their distinct alternatives, best fit first; at most ``most``.

    Of many guesses, alternatives are made of those that fit best.
    """
    if len(guesses) > _MOST_VARIED:
        settled = [settle(ref, query, guess, shift) for guess in guesses]
        guesses = [one.guess for one in sorted(settled, key=lambda one: -one.fit)[:_MOST_VARIED]]
    ranked: list[tuple[float, int, Guess]] = []
    for r, q in dict.fromkeys(g[:2] for g in guesses):
        a, b = ref.at(r).planes, query.at(q).planes
        own = [alt for *at, T in guesses if tuple(at) == (r, q) for alt in alternatives(a, b, T, shift)]
        for k in distinct(own, shift.apart_m / 2):
            ranked.append((-fit(a, b, own[k], shift), len(ranked), (r, q, own[k])))
    return [guess for _, _, guess in sorted(ranked, key=lambda entry: entry[:2])[:most]]


def choose_hypothesis(
    ref: PreparedDrive,
    query: PreparedDrive,
    guesses: Sequence[Guess],
    options: HypothesisOptions,
    register_options: RegisterOptions,
    shift: ShiftOptions | None = None,
    possible: Callable[[Guess], bool] = lambda guess: True,
    confirmed: Callable[[Guess], bool] = lambda guess: True,
) -> SearchResult:
    """The registration of the guess that holds over ``follow_m`` of road, or the reason why none does.

    The reason is that of the most plausible guess, or that two poses cannot be told apart.

    Args:
        shift: how far along the street rivals of the chosen pose are looked for; None: only the guesses are its rivals.
        possible: whether a rival is possible, by what else is known of the drives.
        confirmed: whether what else is known puts a pose within :data:`CONFIRMED_M`, as it must on a street that
            repeats itself.
    """
    promising = promising_guesses(ref, query, guesses, options)
    tried = [register(ref, query, (r, q), T, register_options) for r, q, T in promising]
    tried.sort(key=lambda registration: -plausibility(registration.evidence))
    trusted = [registration for registration in tried if registration.trusted]
    rows = distinct(_query_poses(ref, trusted))[: options.most_followed]
    candidates = [trusted[row] for row in rows]
    if not candidates:
        return SearchResult(None, tried[0].reason if tried else "no guess of where it could be")
    followed = [(*follow(ref, query, start, options, register_options), start) for start in candidates]
    surviving = sorted(((score, n) for n, (score, *_) in enumerate(followed) if score is not None), key=lambda s: -s[0])
    if not surviving:
        return SearchResult(None, f"no hypothesis of {len(candidates)} holds over {options.follow_m:.0f} m of road")
    _, along, best = followed[surviving[0][1]]
    covered = float(np.ptp(query.nodes.travelled_m[[one.query for one in along]]))
    reachable = (
        _reachable_m(ref.nodes, best.ref, options.step_m),
        _reachable_m(query.nodes, best.query, options.step_m),
    )
    least = min(options.least_m, 0.7 * min(reachable))
    if covered < least:
        return SearchResult(None, f"too little in common: {covered:.0f} m of road, at least {least:.0f} m needed")
    rivals = [followed[n][2] for _, n in surviving[1:]]
    shifted = [] if shift is None else _shifted(ref, query, best, shift, possible, register_options)
    rivals += shifted
    for rival in rivals:
        if not (_is_better(ref, query, [best], rival, options, register_options)
                or _is_better(ref, query, along, rival, options, register_options)):  # fmt: skip
            one, other = _query_poses(ref, [best, rival])
            apart = float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
            reason = f"ambiguous: two poses {apart:.1f} m apart hold over {options.follow_m:.0f} m of road"
            return SearchResult(None, reason, ambiguous=True)
    if not confirmed((best.ref, best.query, best.T_ref_query)):
        for rival in shifted:
            if follow(ref, query, rival, options, register_options)[0] is not None:
                period = pose_difference(best.T_ref_query, rival.T_ref_query)[0]
                reason = f"ambiguous: the street repeats itself every {period:.1f} m, and no GNSS puts the drives there"
                return SearchResult(None, reason, ambiguous=True)
    return SearchResult(best)


def _shifted(
    ref: PreparedDrive,
    query: PreparedDrive,
    start: Registration,
    shift: ShiftOptions,
    possible: Callable[[Guess], bool],
    register_options: RegisterOptions,
) -> list[Registration]:
    """Trusted registrations of a pair of nodes at poses shifted along the street, without the pose itself."""
    pair = start.ref, start.query
    # Both sides near the pose: of all shifts, those that fit best may be on the side that free space refutes.
    shift = replace(shift, reach_m=min(shift.reach_m, _RIVALS_M), most=round(2 * _RIVALS_M / shift.apart_m))
    shifts = shifted_poses(ref.at(pair[0]).planes, query.at(pair[1]).planes, start.T_ref_query, shift)
    out = [start]
    for T in shifts:
        if pose_difference(start.T_ref_query, T)[0] > SAME_M and possible((*pair, T)):
            registration = register(ref, query, pair, T, register_options)
            if registration.trusted and possible((*pair, registration.T_ref_query)):
                out.append(registration)
    return [out[row] for row in distinct([one.T_ref_query for one in out])[1:]]


def _is_better(
    ref: PreparedDrive,
    query: PreparedDrive,
    along: Sequence[Registration],
    rival: Registration,
    options: HypothesisOptions,
    register_options: RegisterOptions,
) -> bool:
    """Whether the evidence along the road is decidedly for a hypothesis and against its rival.

    Args:
        along: registrations of the hypothesis along the road.
        rival: a registration of the rival; it is registered beside each of the others, from the nearest before.
    """
    ours = theirs = everything = 0.0
    known = [rival]
    for one in sorted(along, key=lambda one: abs(one.query - rival.query)):
        pair, nearest = (one.ref, one.query), min(known, key=lambda other: abs(other.query - one.query))
        T = predict(nearest, ref.nodes, query.nodes, pair)
        if pair != (nearest.ref, nearest.query):
            refined = register(ref, query, pair, T, register_options, levels=(1, 2))
            if pose_difference(T, refined.T_ref_query)[0] <= SAME_M:
                T = refined.T_ref_query
                known.append(refined)
        only_one, only_other, seen = explained_by_one(ref.at(one.ref), query.at(one.query), one.T_ref_query, T)
        ours, theirs, everything = ours + only_one, theirs + only_other, everything + seen
    if everything == 0:
        return plausibility(along[0].evidence) - plausibility(rival.evidence) >= options.margin
    return ours >= max(options.decisive * (ours + theirs), options.least_decisive * everything)


def nearest_node(ref: PreparedDrive, T_odom_query: Array, among: Indices) -> tuple[int, float]:
    """The reference node nearest to a pose in the reference's odometry, of those given, and its distance."""
    apart = np.linalg.norm(ref.nodes.T_odom_node[among, :3, 3] - T_odom_query[:3, 3], axis=1)
    return int(among[int(np.argmin(apart))]), float(apart.min())


def follow(
    ref: PreparedDrive,
    query: PreparedDrive,
    start: Registration,
    options: HypothesisOptions,
    register_options: RegisterOptions,
) -> tuple[float | None, list[Registration]]:
    """Mean plausibility of a hypothesis along the road, or None if it does not hold, and its registrations that do.

    It is followed forward, and what is missing to ``follow_m`` backward.
    """
    scores, trusted = [plausibility(start.evidence)], [start]
    missing, segment = options.follow_m, query.nodes.segments()
    beside = np.flatnonzero(ref.nodes.segments() == ref.nodes.segments()[start.ref])
    for sign in (1, -1):
        known, last = start, float(query.nodes.travelled_m[start.query])
        for node in range(start.query + sign, len(query) if sign > 0 else -1, sign):
            driven = abs(float(query.nodes.travelled_m[node]) - last)
            if missing <= 0 or segment[node] != segment[start.query]:
                break
            if driven < options.step_m:
                continue
            last, missing = float(query.nodes.travelled_m[node]), missing - driven
            r, apart = nearest_node(ref, predict_in_reference(known, ref.nodes, query.nodes, node), beside)
            if apart > options.nearest_m:
                break
            predicted = predict(known, ref.nodes, query.nodes, (r, node))
            registration = register(ref, query, (r, node), predicted, register_options)
            scores.append(plausibility(registration.evidence))
            metres, degrees = pose_difference(predicted, registration.T_ref_query)
            if registration.trusted and metres <= 0.5 + 0.05 * driven and degrees <= 2 + 0.1 * driven:
                trusted.append(registration)
                known = registration
    return float(np.mean(scores)) if len(trusted) >= options.share * len(scores) else None, trusted


def _reachable_m(nodes: Nodes, start: int, step_m: float) -> float:
    """Length of road, in whole steps, over which a hypothesis that starts at a node of a drive could be followed."""
    along = nodes.travelled_m[nodes.segments() == nodes.segments()[start]] - nodes.travelled_m[start]
    return step_m * float(along.max() // step_m + -along.min() // step_m)


def _query_poses(ref: PreparedDrive, registrations: Sequence[Registration]) -> list[Array]:
    return _in_reference(ref, [(f.ref, f.query, f.T_ref_query) for f in registrations])


def _in_reference(ref: PreparedDrive, guesses: Sequence[Guess]) -> list[Array]:
    """Poses (4, 4) of query nodes in the reference's odometry."""
    return [ref.nodes.T_odom_node[r] @ T for r, _, T in guesses]
