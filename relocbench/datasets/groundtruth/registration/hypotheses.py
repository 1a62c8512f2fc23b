"""Which of several guesses is right? Each is followed along a stretch of road, and must hold all the way.

At one place a wrong pose may look as good as the right one, or better. Over tens of metres of road, carried along by
both odometries, a wrong one meets a gap, a crossing or a front that is not there. If two survive, nobody can tell, and
that is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.registration.global_registration import distinct
from relocbench.datasets.groundtruth.registration.submap_pair import PreparedDrive, RegisterOptions, predict, register
from relocbench.datasets.groundtruth.verification.alternatives import SlideOptions, alternatives, fit
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.geometry import invert, rotation_angle

Array = NDArray[np.float64]
Guess = tuple[int, int, Array]
"""reference node, query node, ``T_ref_query``"""


@dataclass(frozen=True)
class HypothesisOptions:
    """Options that decide between several first guesses of a pose."""

    follow_m: float = 50.0
    """how far each is followed"""
    step_m: float = 10.0
    followed: int = 5
    """at most so many are followed, those that look best at first"""
    tried: int = 10
    """at most so many are refined and judged at all, those that fit best"""
    share: float = 0.7
    """of the places along the stretch where a hypothesis must be trusted"""
    margin: float = 0.03
    """a runner-up that survives and is no worse by more than this leaves the choice open"""
    same_m: float = 1.0
    same_deg: float = 4.0
    nearest_m: float = 10.0
    """places with no reference node nearer than this are not judged"""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The hypothesis that held, or why none did."""

    best: Registration | None
    reason: str = ""
    ambiguous: bool = False
    """several held: a further search can only hide that"""


def plausibility(evidence: Evidence) -> float:
    """One number for how well a pose holds, to compare hypotheses: 1 is perfect, and missing evidence is worst."""
    values = (evidence.overlap_ref, evidence.overlap_query, evidence.violations_ref, evidence.violations_query)
    if not np.isfinite(values).all():
        return -1.0
    return float(min(values[:2]) - 2 * max(values[2:]))


def with_alternatives(
    ref: PreparedDrive, query: PreparedDrive, guesses: Sequence[Guess], slide: SlideOptions, most: int
) -> list[Guess]:
    """Guesses, their slides and turned versions, each once, those that fit best first."""
    ranked: list[tuple[float, int, Guess]] = []
    for r, q in dict.fromkeys(g[:2] for g in guesses):
        a, b = ref.at(r).planes, query.at(q).planes
        own = [alt for *at, T in guesses if tuple(at) == (r, q) for alt in alternatives(a, b, T, slide)]
        for T in distinct(own, slide.apart_m / 2, 4.0):
            ranked.append((-fit(a, b, T, slide), len(ranked), (r, q, T)))
    return [guess for _, _, guess in sorted(ranked, key=lambda entry: entry[:2])[:most]]


def choose_hypothesis(
    ref: PreparedDrive,
    query: PreparedDrive,
    guesses: Sequence[Guess],
    options: HypothesisOptions,
    register_options: RegisterOptions,
) -> SearchResult:
    """The guess that holds over a stretch of road.

    Returns:
        its registration; or none, and the reason: that of the best guess, or that two cannot be told apart.
    """
    judged = [register(ref, query, (r, q), T, register_options) for r, q, T in guesses[: options.tried]]
    judged.sort(key=lambda found: -plausibility(found.evidence))
    hopeful = _apart(ref, [found for found in judged if found.trusted], options)[: options.followed]
    if not hopeful:
        return SearchResult(None, judged[0].reason if judged else "no guess of where it could be")
    followed = [(_follow(ref, query, found, options, register_options), found) for found in hopeful]
    alive = sorted(((score, n) for n, (score, _) in enumerate(followed) if score is not None), key=lambda s: -s[0])
    if not alive:
        return SearchResult(None, f"no hypothesis of {len(hopeful)} holds over {options.follow_m:.0f} m of road")
    best = followed[alive[0][1]][1]
    if len(alive) > 1 and alive[0][0] - alive[1][0] < options.margin:
        other = followed[alive[1][1]][1]
        apart = _difference(ref, best, other)
        reason = f"ambiguous: two poses {apart:.1f} m apart hold over {options.follow_m:.0f} m of road"
        return SearchResult(None, reason, ambiguous=True)
    return SearchResult(best)


def nearest_node(ref: PreparedDrive, T_odom_query: Array, among: NDArray[np.int64]) -> tuple[int, float]:
    """The reference's node nearest to a pose in its odometry, and the distance."""
    apart = np.linalg.norm(ref.nodes.T_odom_node[among, :3, 3] - T_odom_query[:3, 3], axis=1)
    return int(among[int(np.argmin(apart))]), float(apart.min())


def _follow(
    ref: PreparedDrive,
    query: PreparedDrive,
    start: Registration,
    options: HypothesisOptions,
    register_options: RegisterOptions,
) -> float | None:
    """Mean plausibility along the stretch, both ways if the drive begins or ends; None if it does not hold."""
    scores, trusted = [plausibility(start.evidence)], 1
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
            pose = ref.nodes.T_odom_node[known.ref] @ known.T_ref_query
            pose = pose @ invert(query.nodes.T_odom_node[known.query]) @ query.nodes.T_odom_node[node]
            r, apart = nearest_node(ref, pose, beside)
            if apart > options.nearest_m:
                break
            found = register(ref, query, (r, node), predict(known, ref.nodes, query.nodes, (r, node)), register_options)
            scores.append(plausibility(found.evidence))
            if found.trusted and _agrees(found, predict(known, ref.nodes, query.nodes, (r, node)), driven):
                trusted, known = trusted + 1, found
    return float(np.mean(scores)) if trusted >= options.share * len(scores) else None


def _agrees(found: Registration, predicted: Array, driven_m: float) -> bool:
    apart = invert(predicted) @ found.T_ref_query
    turned = float(np.degrees(rotation_angle(apart[:3, :3])))
    return bool(np.linalg.norm(apart[:3, 3]) <= 0.5 + 0.05 * driven_m and turned <= 2 + 0.1 * driven_m)


def _difference(ref: PreparedDrive, a: Registration, b: Registration) -> float:
    poses = [ref.nodes.T_odom_node[x.ref] @ x.T_ref_query for x in (a, b)]
    return float(np.linalg.norm(poses[0][:3, 3] - poses[1][:3, 3]))


def _apart(ref: PreparedDrive, found: Sequence[Registration], options: HypothesisOptions) -> list[Registration]:
    """One of each group that ended in the same place."""
    kept: list[Registration] = []
    for f in found:
        pose = ref.nodes.T_odom_node[f.ref] @ f.T_ref_query
        others = [invert(ref.nodes.T_odom_node[k.ref] @ k.T_ref_query) @ pose for k in kept]
        if all(
            np.linalg.norm(d[:3, 3]) > options.same_m or np.degrees(rotation_angle(d[:3, :3])) > options.same_deg
            for d in others
        ):
            kept.append(f)
    return kept
