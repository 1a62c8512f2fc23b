"""One drive registered against another, node after node.

The first pair, and whatever follows a loss, is searched for; all others are predicted by both odometries from the last
trusted one, refined, and judged. Nothing is passed over in silence: every node of the query that was tried comes out,
trusted or with the reason why not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions
from relocbench.datasets.groundtruth.registration.hypotheses import (
    Guess,
    HypothesisOptions,
    SearchResult,
    choose_hypothesis,
    nearest_node,
    with_alternatives,
)
from relocbench.datasets.groundtruth.registration.place_recognition import (
    MapPrior,
    guesses_by_features,
    guesses_by_prior,
)
from relocbench.datasets.groundtruth.registration.submap_pair import (
    PreparedDrive,
    RegisterOptions,
    Window,
    predict,
    register,
    unregistered,
)
from relocbench.datasets.groundtruth.verification.alternatives import SlideOptions
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.geometry import invert, rotation_angle

Array = NDArray[np.float64]
Remember = Callable[[str, Callable[[], SearchResult]], SearchResult]


@dataclass(frozen=True)
class DriveRegistrationOptions:
    """Options of the registration of a whole drive."""

    step_m: float = 4.0
    """between the nodes of the query that are registered"""
    nearest_m: float = 8.0
    """a reference node further away than this sees another place"""
    position_error: float = 0.03
    """share of the way since the last trusted registration by which both odometries may be wrong together"""
    turn_error_deg_per_m: float = 0.05
    slack_m: float = 0.4
    """what a submap's own distortion may add"""
    slack_deg: float = 1.5
    far_m: float = 12.0
    """after so much driving since the last trusted registration, starts along the street are tried as well"""
    lost_m: float = 150.0
    """after so much, odometry is not good enough any more: the place is searched for again"""
    retry_m: float = 25.0
    """a search that failed is repeated after so much"""
    register: RegisterOptions = field(default_factory=RegisterOptions)
    hypotheses: HypothesisOptions = field(default_factory=HypothesisOptions)
    search: GlobalOptions = field(default_factory=GlobalOptions)
    slide: SlideOptions = field(default_factory=SlideOptions)


def register_along(
    window_ref: Window,
    window_query: Window,
    nodes_ref: Nodes,
    nodes_query: Nodes,
    prior: MapPrior | None = None,
    options: DriveRegistrationOptions | None = None,
    *,
    first: Guess | None = None,
    say: Callable[[str], None] = lambda message: None,
    remember: Remember = lambda asked, work: work(),
) -> list[Registration]:
    """Registrations of the query's nodes, about ``step_m`` apart, in order of the drive.

    Args:
        prior: where both drives' nodes are on a map, to within metres.
        first: (reference node, query node, ``T_ref_query``) given by hand; judged like any other guess, and passed over
            if it does not hold.
        say: is told what a person should know, such as that ``first`` is wrong.
        remember: is handed every piece of work that takes long, with words that tell it from others; it does it, or
            gives back what came of it before.
    """
    work = _DriveRegistration(
        PreparedDrive(window_ref, nodes_ref), PreparedDrive(window_query, nodes_query), prior, options, say, remember
    )
    return work.run(first)


class _DriveRegistration:
    def __init__(
        self,
        ref: PreparedDrive,
        query: PreparedDrive,
        prior: MapPrior | None,
        options: DriveRegistrationOptions | None,
        say: Callable[[str], None],
        remember: Remember,
    ) -> None:
        self.ref, self.query, self.prior = ref, query, prior
        self.options = options or DriveRegistrationOptions()
        self.say = say
        self.remember = remember
        self.found: dict[int, Registration] = {}

    def run(self, first: Guess | None) -> list[Registration]:
        steps = self.query.every(self.options.step_m)
        start = None if first is None else self._given(first)
        searched, reason = -np.inf, "no registration to follow on"
        if start is not None:
            nearest = min(range(len(steps)), key=lambda i: abs(steps[i] - start.query))
            self._along(steps[nearest:], start)
            self._along(steps[:nearest][::-1], start)
        segment = self.query.nodes.segments()
        for i, node in enumerate(steps):
            travelled = float(self.query.nodes.travelled_m[node])
            if i and segment[node] != segment[steps[i - 1]]:
                # Beyond a gap nothing is known from before it.
                searched = -np.inf
            if node in self.found and self.found[node].trusted:
                continue
            if not self._is_lost(node):
                continue
            if travelled - searched >= self.options.retry_m:
                searched = travelled
                outcome = self.remember(f"search {node}", partial(self._search, node))
                if outcome.best is not None:
                    self._along(steps[i:], outcome.best)
                    self._along(steps[:i][::-1], outcome.best)
                    continue
                reason = outcome.reason
            self.found[node] = self._unfound((self._closest(node), node), f"not found: {reason}")
        for node in steps:
            if node not in self.found:
                self.found[node] = self._unfound((self._closest(node), node), f"not found: {reason}")
        return [self.found[node] for node in steps]

    def _given(self, first: Guess) -> Registration | None:
        work = partial(choose_hypothesis, self.ref, self.query, [first], self.options.hypotheses, self.options.register)
        outcome = self.remember(f"given {first[0]} {first[1]}", work)
        if outcome.best is None:
            self.say(
                f"the given pose of query node {first[1]} at reference node {first[0]} does not hold "
                f"({outcome.reason}); the place is searched for instead"
            )
        return outcome.best

    def _is_lost(self, node: int) -> bool:
        """No trusted registration is so near along the drive that odometry still knows the place."""
        segment = self.query.nodes.segments()
        trusted = [q for q, found in self.found.items() if found.trusted and segment[q] == segment[node]]
        travelled = self.query.nodes.travelled_m
        return all(abs(travelled[node] - travelled[q]) > self.options.lost_m for q in trusted)

    def _along(self, steps: list[int], start: Registration) -> None:
        """Node after node, until the drive ends, the track is lost for good, or trusted registrations are met."""
        known, travelled, segment = start, self.query.nodes.travelled_m, self.query.nodes.segments()
        for node in steps:
            if segment[node] != segment[start.query]:
                break
            before = self.found.get(node)
            if before is not None and before.trusted:
                break
            driven = abs(float(travelled[node] - travelled[known.query]))
            if driven > self.options.lost_m:
                break
            asked = f"node {node} after {known.query}"
            found = self.remember(asked, partial(self._next_outcome, known, node, driven)).best
            assert found is not None
            self.found[node] = found
            if found.trusted:
                known = found

    def _next_outcome(self, known: Registration, node: int, driven: float) -> SearchResult:
        return SearchResult(self._next(known, node, driven))

    def _next(self, known: Registration, node: int, driven: float) -> Registration:
        o = self.options
        pose = self.ref.nodes.T_odom_node[known.ref] @ known.T_ref_query
        pose = pose @ invert(self.query.nodes.T_odom_node[known.query]) @ self.query.nodes.T_odom_node[node]
        # A reference that comes by twice is followed where it was: its odometry closes no loops.
        reach = o.lost_m + 3 * o.nearest_m
        travelled, segment = self.ref.nodes.travelled_m, self.ref.nodes.segments()
        around = np.flatnonzero((np.abs(travelled - travelled[known.ref]) <= reach) & (segment == segment[known.ref]))
        r, apart = nearest_node(self.ref, pose, around)
        predicted = predict(known, self.ref.nodes, self.query.nodes, (r, node))
        if apart > o.nearest_m + o.position_error * driven:
            return unregistered(
                (r, node), predicted, f"the reference did not come by: its nearest node is {apart:.0f} m away"
            )
        near = register(self.ref, self.query, (r, node), predicted, o.register, levels=None if driven > 6 else (1, 2))
        result = self._consistent(near, predicted, driven)
        if result.trusted or driven < o.far_m:
            return result
        slide = SlideOptions(reach_m=2 + 3 * o.position_error * driven, apart_m=1.0)
        starts = with_alternatives(self.ref, self.query, [(r, node, predicted)], slide, 4)
        limited = [s for s in starts if self._allowed(s[2], predicted, driven)]
        if driven <= 2 * o.far_m or not limited:
            return result
        outcome: SearchResult = choose_hypothesis(self.ref, self.query, limited, o.hypotheses, o.register)
        return self._consistent(outcome.best, predicted, driven) if outcome.best is not None else result

    def _allowed(self, T_ref_query: Array, predicted: Array, driven: float) -> bool:
        o = self.options
        apart = invert(predicted) @ T_ref_query
        turned = float(np.degrees(rotation_angle(apart[:3, :3])))
        near = np.linalg.norm(apart[:3, 3]) <= o.slack_m + 3 * o.position_error * driven
        return bool(near and turned <= o.slack_deg + 3 * o.turn_error_deg_per_m * driven)

    def _consistent(self, found: Registration, predicted: Array, driven: float) -> Registration:
        """A trusted registration that both odometries contradict is not trusted."""
        if not found.trusted or self._allowed(found.T_ref_query, predicted, driven):
            return found
        apart = invert(predicted) @ found.T_ref_query
        metres, degrees = np.linalg.norm(apart[:3, 3]), np.degrees(rotation_angle(apart[:3, :3]))
        reason = (
            f"odometry: {metres:.1f} m and {degrees:.1f} deg from where both drives' odometries put it "
            f"after {driven:.0f} m"
        )
        return Registration(found.ref, found.query, found.T_ref_query, found.information, found.evidence, reason)

    def _search(self, node: int) -> SearchResult:
        """What holds of the guesses of one search after the other; the first one's reason if nothing does."""
        failed: SearchResult | None = None
        for search in self.options.search.attempts():
            if self.prior is not None:
                found = guesses_by_prior(self.ref, self.query, self.prior, node, search)
                if not found:
                    return SearchResult(None, "the reference did not come by, as far as the prior tells")
            else:
                found = guesses_by_features(self.ref, self.query, node, search)
            outcome = self._settled(found)
            if outcome.best is not None or outcome.ambiguous:
                return outcome
            failed = failed or outcome
        assert failed is not None
        return failed

    def _settled(self, found: list[Guess]) -> SearchResult:
        o, limit = self.options, self.prior
        starts = with_alternatives(self.ref, self.query, found, o.slide, 4 * o.hypotheses.tried)
        if limit is not None:
            starts = [s for s in starts if limit.allows(*s)]
        return choose_hypothesis(self.ref, self.query, starts, o.hypotheses, o.register)

    def _closest(self, node: int) -> int:
        return -1 if self.prior is None else self.prior.nearest(node)

    def _unfound(self, pair: tuple[int, int], reason: str) -> Registration:
        return unregistered(pair, np.full((4, 4), np.nan), reason)
