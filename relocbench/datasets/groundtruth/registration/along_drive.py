"""Registration of one drive against another, node after node.

The first pair is found by place recognition, as is the next one after the track is lost. All others are predicted by
both odometries from the last trusted registration, registered by ICP, and verified. Every query node that is tried gets
a registration, which is trusted or states why it is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.odometry.length import LARGEST_STRETCH, LengthRatio
from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions, pose_difference
from relocbench.datasets.groundtruth.registration.hypotheses import (
    CONFIRMED_M,
    HypothesisOptions,
    SearchResult,
    choose_hypothesis,
    nearest_node,
    with_alternatives,
)
from relocbench.datasets.groundtruth.registration.lengths import (
    length_mismatch_message,
    may_hold_by_chance,
    ratio_of_lengths,
    stretch_of_query,
)
from relocbench.datasets.groundtruth.registration.place_recognition import MapPrior, guesses_of_node
from relocbench.datasets.groundtruth.registration.submap_pair import (
    Guess,
    PreparedDrive,
    RegisterOptions,
    Window,
    nodes_every,
    predict,
    predict_in_reference,
    register,
    unregistered,
)
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions
from relocbench.datasets.groundtruth.verification.evidence import Registration

_PLACES = (0.5, 0.25)
"""parts of the drive at which a stretch of its odometry is looked for"""

_SEARCHES = 4
"""parts of the drive, at the beginning of each of which it is searched for without GNSS if nothing holds where GNSS is:
most of such drives do not meet at all, and a search along the whole reference takes a minute and more"""

_THOROUGHLY = 4
"""of searches that fail one after another, so many have one with coarser features, which costs three times as much"""

Remember = Callable[[str, Callable[[], SearchResult]], SearchResult]
"""(key, work) -> the result of the work, done now or earlier"""


@dataclass(frozen=True)
class DriveRegistrationOptions:
    """Options of the registration of a whole drive."""

    step_m: float = 4.0
    """distance between the query nodes that are registered"""
    nearest_m: float = 8.0
    """largest distance between the two nodes of a pair: nodes further apart show different places"""
    position_error: float = 0.03
    """standard deviation of the predicted position, as a share of the distance driven since the last trusted
    registration"""
    turn_error_deg_per_m: float = 0.05
    """standard deviation of the predicted rotation, for each metre driven since the last trusted registration"""
    slack_m: float = 0.4
    """error of position that the distortion of a submap may add"""
    slack_deg: float = 1.5
    """error of rotation that it may add"""
    far_m: float = 24.0
    """distance driven since the last trusted registration beyond which poses shifted along the street are tried too"""
    lost_m: float = 150.0
    """distance driven beyond which odometry is not good enough: the track is lost, and place recognition is used"""
    retry_m: float = 25.0
    """distance driven after which a search that failed is repeated"""
    retry_later_m: float = 50.0
    """the same after several that failed one after another"""
    register: RegisterOptions = field(default_factory=RegisterOptions)
    hypotheses: HypothesisOptions = field(default_factory=HypothesisOptions)
    search: GlobalOptions = field(default_factory=GlobalOptions)
    shift: ShiftOptions = field(default_factory=ShiftOptions)


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
    remember: Remember = lambda key, work: work(),
    explain: Callable[[], str] = lambda: "",
) -> list[Registration]:
    """Register the query's nodes, about ``step_m`` apart. Returns the registrations in the order of the drive.

    Args:
        prior: poses of both drives' nodes on a map, good to metres.
        first: (reference node, query node, ``T_ref_query``) given by hand; it is verified like any other guess and
            ignored if it does not hold.
        say: called with messages for the user, such as that ``first`` does not hold.
        remember: called with every piece of work that takes long and a key that identifies it; it does the work, or
            returns the result of an earlier run.
        explain: called if nothing holds; returns the reason if it finds one, in words.
    """
    ref, query = PreparedDrive(window_ref, nodes_ref), PreparedDrive(window_query, nodes_query)
    options = options or DriveRegistrationOptions()
    registration = _DriveRegistration(ref, query, prior, options, say, remember)
    registrations = registration.run(first)
    if not any(one.trusted for one in registrations) and (cause := explain()):
        say(cause)
        return [replace(one, reason=cause) for one in registrations]
    if prior is not None and not any(one.trusted for one in registrations):
        say("nothing holds where GNSS puts the drives; they are searched for each other without GNSS")
        apart = float(nodes_query.travelled_m[-1]) / _SEARCHES
        rarely = replace(options, retry_m=max(options.retry_m, apart))
        alone = _DriveRegistration(
            ref, query, None, rarely, say, lambda key, work: remember(f"{key} without GNSS", work)
        )
        anew = alone.run(None)
        if any(one.trusted for one in anew):
            say("the drives were found without GNSS, which is wrong for one of them")
            registration, registrations = alone, anew
        else:
            say("they were not found without GNSS either")
    ratio = ratio_of_lengths(registrations, nodes_ref, nodes_query)
    certain = ratio is not None and ratio.exceeds(LARGEST_STRETCH)
    suspected = ratio is not None and abs(ratio.ratio - 1) > LARGEST_STRETCH
    if not certain and (suspected or may_hold_by_chance(registrations, options.step_m)):
        ratio = registration.ratio_of_lengths()
    if ratio is None or not ratio.exceeds(LARGEST_STRETCH):
        return registrations
    mismatch = length_mismatch_message(ratio)
    say(mismatch)
    return [replace(one, reason=mismatch) for one in registrations]


@dataclass(frozen=True, eq=False)
class _DriveRegistration:
    ref: PreparedDrive
    query: PreparedDrive
    prior: MapPrior | None
    options: DriveRegistrationOptions
    say: Callable[[str], None]
    remember: Remember
    registered: dict[int, Registration] = field(default_factory=dict)
    """query node -> its registration"""

    def run(self, first: Guess | None) -> list[Registration]:
        steps = nodes_every(self.query.nodes, self.options.step_m)
        start = None if first is None else self._from_given_pose(first)
        searched, failed, reason = -np.inf, 0, "no registration to follow on"
        if start is not None:
            nearest = min(range(len(steps)), key=lambda i: abs(steps[i] - start.query))
            self._along(steps[nearest:], start)
            self._along(steps[:nearest][::-1], start)
        segment = self.query.nodes.segments()
        for i, node in enumerate(steps):
            travelled = float(self.query.nodes.travelled_m[node])
            if i and segment[node] != segment[steps[i - 1]]:
                # A search before a gap says nothing about the place after it.
                searched = -np.inf
            if node in self.registered and self.registered[node].trusted:
                continue
            if not self._is_lost(node):
                continue
            wait = self.options.retry_m
            if failed > 1:
                wait = max(wait, self.options.retry_later_m)
            if travelled - searched >= wait:
                searched = travelled
                thorough = failed % _THOROUGHLY == 0
                result = self.remember(f"search {node}", partial(self._search, node, thorough))
                failed = 0 if result.best is not None else failed + 1
                if result.best is not None:
                    self._along(steps[i:], result.best)
                    self._along(steps[:i][::-1], result.best)
                    continue
                reason = result.reason
            self.registered[node] = self._unregistered(node, reason)
        for node in steps:
            if node not in self.registered:
                self.registered[node] = self._unregistered(node, reason)
        return [self.registered[node] for node in steps]

    def _from_given_pose(self, first: Guess) -> Registration | None:
        work = partial(self._best_of, [first], self.options.shift, self._possible)
        result = self.remember(f"given {first[0]} {first[1]}", work)
        if result.best is None:
            self.say(
                f"the given pose of query node {first[1]} at reference node {first[0]} does not hold "
                f"({result.reason}); place recognition is used instead"
            )
        return result.best

    def _is_lost(self, node: int) -> bool:
        """Whether every trusted registration is too far away along the drive to predict the node's pose by odometry."""
        segment = self.query.nodes.segments()
        trusted = [
            q for q, registration in self.registered.items() if registration.trusted and segment[q] == segment[node]
        ]
        travelled = self.query.nodes.travelled_m
        return all(abs(travelled[node] - travelled[q]) > self.options.lost_m for q in trusted)

    def _along(self, steps: list[int], start: Registration) -> None:
        """Register node after node until the segment ends, the track is lost, or a node is trusted already."""
        known, travelled, segment = start, self.query.nodes.travelled_m, self.query.nodes.segments()
        for node in steps:
            if segment[node] != segment[start.query]:
                break
            before = self.registered.get(node)
            if before is not None and before.trusted:
                break
            driven = abs(float(travelled[node] - travelled[known.query]))
            if driven > self.options.lost_m:
                break
            work = partial(self._next_result, known, node, driven)
            registration = self.remember(f"node {node} after {known.query}", work).best
            assert registration is not None
            self.registered[node] = registration
            if registration.trusted:
                known = registration

    def _next_result(self, known: Registration, node: int, driven: float) -> SearchResult:
        return SearchResult(self._next(known, node, driven))

    def _next(self, known: Registration, node: int, driven: float) -> Registration:
        """The registration of a node, predicted from a known one ``driven`` metres away."""
        o = self.options
        pose = predict_in_reference(known, self.ref.nodes, self.query.nodes, node)
        # Where the reference passes a place twice, only nodes of the same pass count: its odometry closes no loops.
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
        if result.trusted or driven <= o.far_m:
            return result
        shift = ShiftOptions(reach_m=2 + 3 * o.position_error * driven, apart_m=1.0)
        starts = with_alternatives(self.ref, self.query, [(r, node, predicted)], shift, 4)
        limited = [s for s in starts if self._allowed(s[2], predicted, driven)]
        if not limited:
            return result
        best = self._best_of(limited, shift, lambda guess: self._allowed(guess[2], predicted, driven)).best
        return self._consistent(best, predicted, driven) if best is not None else result

    def _allowed(self, T_ref_query: Array, predicted: Array, driven: float) -> bool:
        """Whether a pose is within three standard deviations of the prediction."""
        o = self.options
        metres, degrees = pose_difference(predicted, T_ref_query)
        near = metres <= o.slack_m + 3 * o.position_error * driven
        return near and degrees <= o.slack_deg + 3 * o.turn_error_deg_per_m * driven

    def _consistent(self, registration: Registration, predicted: Array, driven: float) -> Registration:
        """The registration, no longer trusted if it contradicts both odometries."""
        if not registration.trusted or self._allowed(registration.T_ref_query, predicted, driven):
            return registration
        metres, degrees = pose_difference(predicted, registration.T_ref_query)
        reason = (
            f"odometry: {metres:.1f} m and {degrees:.1f} deg from where both drives' odometries put it "
            f"after {driven:.0f} m"
        )
        return replace(registration, reason=reason)

    def ratio_of_lengths(self) -> LengthRatio | None:
        """How many times as long as the reference's the query's odometry is, if this is why nothing holds."""
        o, search = self.options, self.options.search
        for node in dict.fromkeys(int(k * len(self.query)) for k in _PLACES):
            guesses = partial(self._guesses, node, search)
            within = (o.shift, o.hypotheses, o.register)
            ratio = stretch_of_query(self.ref, self.query, node, guesses, *within, self.remember)
            if ratio is not None:
                return ratio
        return None

    def _guesses(self, node: int, search: GlobalOptions) -> list[Guess]:
        return guesses_of_node(self.ref, self.query, self.prior, node, search)

    def _search(self, node: int, thorough: bool = True) -> SearchResult:
        """Place recognition, with further searches while no guess holds; the reason is that of the first search.

        Args:
            thorough: whether to search further.
        """
        failed: SearchResult | None = None
        for search in self.options.search.attempts()[: None if thorough else 1]:
            guesses = self._guesses(node, search)
            if not guesses and self.prior is not None:
                return SearchResult(None, "the reference did not come by, as far as the prior tells")
            result = self._choose(guesses)
            if result.best is not None or result.ambiguous:
                return result
            failed = failed or result
        assert failed is not None
        return failed

    def _choose(self, candidates: list[Guess]) -> SearchResult:
        o = self.options
        starts = with_alternatives(self.ref, self.query, candidates, o.shift, 4 * o.hypotheses.most_tried)
        return self._best_of([s for s in starts if self._possible(s)], o.shift, self._possible, self._confirmed)

    def _possible(self, guess: Guess) -> bool:
        return self.prior is None or self.prior.allows(*guess)

    def _confirmed(self, guess: Guess) -> bool:
        if self.prior is None:
            return False
        ref, query, T_ref_query = guess
        off = T_ref_query[:2, 3] - self.prior.between(ref, query).T_ref_query[:2, 3]
        return bool(np.linalg.norm(off) <= CONFIRMED_M)

    def _best_of(
        self,
        guesses: list[Guess],
        shift: ShiftOptions,
        possible: Callable[[Guess], bool],
        confirmed: Callable[[Guess], bool] = lambda guess: True,
    ) -> SearchResult:
        o = self.options
        return choose_hypothesis(self.ref, self.query, guesses, o.hypotheses, o.register, shift, possible, confirmed)

    def _unregistered(self, node: int, reason: str) -> Registration:
        nearest = -1 if self.prior is None else self.prior.nearest(node)
        return unregistered((nearest, node), np.full((4, 4), np.nan), f"not found: {reason}")
