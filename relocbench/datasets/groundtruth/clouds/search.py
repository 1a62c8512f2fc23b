"""The pose of two clouds without a prediction: guesses, refined and verified, and their typical alternatives.

There is no drive along which a hypothesis could be followed. A pose is therefore only taken if none of its alternatives
(shifts along the scene's axes, turns about them, and the other guesses) is trusted as well and nearly as plausible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.alternatives import (
    MOST_BESIDE,
    SHIFT,
    alternatives_of,
    shifts_as_close,
)
from relocbench.datasets.groundtruth.clouds.distinct import Distinct, distinct_evidence
from relocbench.datasets.groundtruth.clouds.judging import WITH_FREE_SPACE, FreeSpaceKnown, Verdict, holds_nearly, judge
from relocbench.datasets.groundtruth.clouds.open_directions import OpenDirections
from relocbench.datasets.groundtruth.clouds.preparing import PreparedCloud
from relocbench.datasets.groundtruth.clouds.uncertainty import OPEN, FinalFit, FinePlanes, final_fit
from relocbench.datasets.groundtruth.icp.backends import Backend, icp_by_backend
from relocbench.datasets.groundtruth.icp.icp import IcpOptions
from relocbench.datasets.groundtruth.registration.global_registration import (
    SAME_DEG,
    SAME_M,
    GlobalOptions,
    describe,
    distinct,
    guesses,
    pose_difference,
)
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.groundtruth.verification.alternatives import fit
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.datasets.groundtruth.verification.verification import verification_evidence, weakest
from relocbench.geometry import invert, make_transform, se3_log

_RIGID = IcpOptions(scale_error_sigma=0.0, drift_per_m=0.0, turn_per_m=0.0)
_DRIFTING = IcpOptions(scale_error_sigma=0.0)
"""for clouds that were put together by odometry"""
_TRIED = 10
"""guesses and alternatives of each kind that are refined, those that fit best"""
_FITS = 0.5
"""share of the best fit that an alternative must reach to be refined"""
_ROUNDS = 2
"""how often the best pose is shifted on the fine grid, since a shift of it may be the best one then"""
_TIMES, _MORE = 2.5, 0.03
"""a second pose that holds, or nearly, must leave more unexplained than the best: by this factor and this much more"""
_TIMES_BESIDE = 1.25
"""the same factor for a pose less than a metre beside the best, where the same surfaces are compared"""
_ROUGHER, _CLOSE_M = 1.5, 0.01
"""factor of the residuals, or of residuals this small, from which a second pose is no rival of the best"""
_APART_M, _SEEN_M = 0.25, 0.05
"""refined poses further apart than this are different ones, and those no further apart than this the same one"""


@dataclass(frozen=True)
class SearchOptions:
    """Options of the search."""

    matching: GlobalOptions = field(default_factory=GlobalOptions)
    backend: Backend = "own"
    initial: Array | None = None
    """(4, 4) ``T_A_B`` of the nodes, enlarged; the only guess if it is given"""
    drifts: bool = False
    """whether one of the clouds was put together by odometry"""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A refined pose with its evidence, all enlarged, from node to node."""

    T_a_b: Array
    information: Array
    evidence: Evidence
    verdict: Verdict
    unexplained: float
    """see :func:`unexplained`"""
    nearly: bool
    """whether the pose is trusted by limits that are a little wider, see :func:`holds_nearly`"""
    open: OpenDirections
    """motions that the surfaces cannot tell"""
    residuals: tuple[Array, Array]
    """distances of B's points from A's surfaces, and of A's from B's"""

    @property
    def trusted(self) -> bool:
        return not self.verdict.reason

    def as_good_as(self, best: Candidate) -> bool:
        """Whether this pose leaves about as little unexplained as the best one, and its surfaces lie as close."""
        this, other = (max(c.evidence.residual_ref_m, c.evidence.residual_query_m) for c in (self, best))
        close = this < _ROUGHER * max(other, _CLOSE_M)
        times = _TIMES_BESIDE if _same(self.T_a_b, best.T_a_b) else _TIMES
        return close and self.unexplained < times * best.unexplained + _MORE


@dataclass(frozen=True, eq=False)
class CloudSearchResult:
    """The result of the search."""

    best: Candidate | None
    """the pose that is trusted, or the most plausible one; None if there was no guess"""
    reason: str
    """why it is not trusted; empty if it is"""
    guesses: int
    """number of distinct guesses that were refined"""
    rival: Candidate | None = None
    """a different pose that is trusted as well, or nearly, if there is one"""
    spread: Array = field(default_factory=lambda: np.zeros((6, 6)))
    """(6, 6) second moment, about the best pose, of poses that hold as well, xi in ``T_a_b @ se3_exp(xi)``"""


def search(
    a: PreparedCloud,
    b: PreparedCloud,
    scale: SceneScale,
    known: FreeSpaceKnown,
    options: SearchOptions,
    advance: Callable[[int], None] = lambda count: None,
) -> CloudSearchResult:
    """Search for the pose of B in A. ``advance`` is called for at most :func:`steps` steps."""
    judged = _Judge(a, b, scale, known, options, advance)
    tried: list[Candidate] = []
    if options.initial is not None:
        tried = judged.all_of([options.initial])
    else:
        for number, attempt in enumerate(_attempts(options.matching, scale)):
            candidates = guesses(describe(a.submap, attempt), describe(b.submap, attempt), None, attempt)
            advance(1)
            if number == 0:
                candidates.insert(0, _as_they_are(a, b))
            tried += judged.all_of(judged.best_fitting(candidates))
            if any(candidate.trusted or candidate.verdict.slides for candidate in tried):
                break
    if not tried:
        return CloudSearchResult(None, "no guess: the clouds have too few features in common", 0)
    best = _most_plausible(tried)
    others = judged.all_of(judged.best_fitting(alternatives_of(a.planes, b.planes, best.T_a_b, scale), _FITS))
    everything, shifted = [*tried, *others], None
    for _ in range(_ROUNDS):
        best = _most_plausible(everything)
        if best is shifted:
            break
        everything += judged.all_of(shifts_as_close(a.planes, b.planes, best.T_a_b, scale), by_icp=False)
        shifted = best
    best = _most_plausible(everything)
    count = len(everything)
    if not best.trusted:
        return CloudSearchResult(best, best.verdict.reason, count)
    rivals = [c for c in everything if (c.trusted or c.nearly) and not _same(c.T_a_b, best.T_a_b, _APART_M)]
    rivals.sort(key=lambda c: c.unexplained)
    alike = [c for c in rivals if c.as_good_as(best)]
    if alike:
        metres, degrees = pose_difference(best.T_a_b, alike[0].T_a_b)
        reason = f"ambiguous: another pose, {metres / scale.factor:.2g} m and {degrees:.0f} deg away, holds as well"
        return CloudSearchResult(best, reason, count, alike[0], _spread(best.T_a_b, [c.T_a_b for c in alike]))
    return CloudSearchResult(best, "", count, rivals[0] if rivals else None)


def _spread(T: Array, alike: Sequence[Array]) -> Array:
    """(6, 6) second moment of poses that are as plausible as T, about T: what is left open between them."""
    xi = np.array([se3_log(invert(T) @ alike[k]) for k in distinct(alike, _APART_M)])
    return np.asarray(xi.T @ xi / (len(xi) + 1))


def steps(options: SearchOptions) -> int:
    """The number of steps of a search, for a progress bar: guesses and alternatives that are refined, and searches."""
    searches = 0 if options.initial is not None else len(options.matching.attempts())
    return 1 + searches * (_TRIED + 1) + _TRIED + _ROUNDS * MOST_BESIDE


def _attempts(matching: GlobalOptions, scale: SceneScale) -> list[GlobalOptions]:
    """The searches by features, whose voxels shrink with scenes that noise keeps smaller than a street."""
    return [replace(attempt, voxel_m=attempt.voxel_m * scale.detail) for attempt in matching.attempts()]


def _as_they_are(a: PreparedCloud, b: PreparedCloud) -> Array:
    """The guess that both clouds are in one frame already."""
    return make_transform(np.eye(3), b.T_cloud_node[:3, 3] - a.T_cloud_node[:3, 3])


def _same(T_one: Array, T_other: Array, same_m: float = SAME_M) -> bool:
    metres, degrees = pose_difference(T_one, T_other)
    return metres <= same_m and degrees <= SAME_DEG


def _most_plausible(candidates: Sequence[Candidate]) -> Candidate:
    """The trusted candidate that leaves least unexplained; if none is trusted, details count too."""

    def key(c: Candidate) -> tuple[bool, float]:
        detail = float(np.min(np.nan_to_num([c.evidence.detail_ref, c.evidence.detail_query], nan=0.0)))
        return not c.trusted, c.unexplained + (0.0 if c.trusted else 2 * (1 - detail))

    return min(candidates, key=key)


class _Judge:
    """Refines and judges guesses; a pose that was judged is not judged again."""

    def __init__(
        self,
        a: PreparedCloud,
        b: PreparedCloud,
        scale: SceneScale,
        known: FreeSpaceKnown,
        options: SearchOptions,
        advance: Callable[[int], None],
    ) -> None:
        self._a, self._b, self._scale, self._known, self._advance = a, b, scale, known, advance
        self._backend = options.backend
        self._icp = _DRIFTING if options.drifts else _RIGID
        self._fine = FinePlanes(a.submap), FinePlanes(b.submap)
        self._outdoors = a.outdoors and b.outdoors
        self._seen: list[Array] = []

    def best_fitting(self, poses: Sequence[Array], share: float = 0.0) -> list[Array]:
        """The distinct ones, best fit first; those that fit by at least a share of the best one."""
        some = [poses[k] for k in distinct(poses, SAME_M / 2)]
        fits = np.array([fit(self._a.planes, self._b.planes, T, SHIFT) for T in some])
        order = np.argsort(-fits, kind="stable")[:_TRIED]
        return [some[k] for k in order if fits[k] >= share * fits.max()]

    def all_of(self, poses: Sequence[Array], *, by_icp: bool = True) -> list[Candidate]:
        """The candidates of guesses that did not end where an earlier one did.

        Args:
            by_icp: whether guesses are refined by ICP; those that are right to decimetres need the final fit only, and
                would be drawn to the next best pose.
        """
        out = []
        for guess in poses:
            self._advance(1)
            T, information = guess, np.eye(6)
            if by_icp:
                result = icp_by_backend(self._backend, self._a, self._b, guess, self._icp)
                if result.count < self._icp.least_matches:
                    continue
                T, information = result.T_ref_query, result.information
                if self._was_seen(T):
                    continue
            candidate = self._judged(T, information)
            if by_icp or not self._was_seen(candidate.T_a_b):
                out.append(candidate)
            self._seen.append(candidate.T_a_b)
        return out

    def _was_seen(self, T: Array) -> bool:
        return any(pose_difference(seen, T)[0] < _SEEN_M and _same(seen, T) for seen in self._seen)

    def _judged(self, T: Array, information: Array) -> Candidate:
        fitted = final_fit(*self._fine, T)
        if _same(fitted.T_ref_query, T):
            T, information = fitted.T_ref_query, self._with_drift(fitted, information)
        evidence = verification_evidence(self._a, self._b, T, information)
        sigma, direction, sigma_deg = weakest(information, T)
        evidence = replace(evidence, weakest_sigma_m=sigma, weakest_direction=direction, weakest_sigma_deg=sigma_deg)
        slides = fitted.open.named(self._a.T_cloud_node @ T, self._scale.factor)
        return Candidate(
            T,
            information,
            evidence,
            judge(evidence, self._scale, self._known, None if self._outdoors else lambda: self._distinct(T), slides),
            unexplained(evidence),
            holds_nearly(evidence, self._scale, self._known, self._outdoors),
            fitted.open,
            fitted.residuals,
        )

    def _distinct(self, T: Array) -> Distinct:
        return distinct_evidence(self._a, self._b, T)

    def _with_drift(self, fitted: FinalFit, by_icp: Array) -> Array:
        """The information of the final fit; of clouds put together by odometry, that of ICP, which allows for drift."""
        return fitted.open.forgotten(by_icp) + OPEN * np.eye(6) if self._icp is _DRIFTING else fitted.information


def unexplained(evidence: Evidence) -> float:
    """What speaks against a pose, to compare poses by: 0 if everything that could be compared agrees.

    The larger share of surfaces that the other cloud could see and did not measure, and twice the larger share of
    violations as far as these are known; poses at which there is little to compare come last.
    """
    overlap = np.nan_to_num([evidence.overlap_ref, evidence.overlap_query], nan=0.0)
    violations = np.nan_to_num([evidence.violations_ref, evidence.violations_query], nan=0.0)
    seen = float(np.min(np.nan_to_num([evidence.seen_ref, evidence.seen_query], nan=0.0)))
    return float(1 - overlap.min() + 2 * violations.max() + max(0.0, 1 - seen / WITH_FREE_SPACE.least_seen))
