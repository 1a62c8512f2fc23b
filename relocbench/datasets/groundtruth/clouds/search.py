"""The pose of two clouds without a prediction: guesses, refined and verified, and their typical alternatives.

There is no drive along which a hypothesis could be followed. A pose is therefore only taken if none of its alternatives
(shifts along the scene's axes, turns about them, and the other guesses) is trusted as well and nearly as plausible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.distinct import Distinct, distinct_evidence
from relocbench.datasets.groundtruth.clouds.judging import WITH_FREE_SPACE, FreeSpaceKnown, Verdict, holds_nearly, judge
from relocbench.datasets.groundtruth.clouds.preparing import PreparedCloud
from relocbench.datasets.groundtruth.clouds.uncertainty import FinalFit, FinePlanes, final_fit
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
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions, fit, shifted_poses
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.datasets.groundtruth.verification.verification import verification_evidence, weakest
from relocbench.geometry import make_transform, so3_exp

_RIGID = IcpOptions(scale_error_sigma=0.0, drift_per_m=0.0, turn_per_m=0.0)
_DRIFTING = IcpOptions(scale_error_sigma=0.0)
"""for clouds that were put together by odometry"""
_TRIED = 10
"""guesses and alternatives of each kind that are refined, those that fit best"""
_FITS = 0.5
"""share of the best fit that an alternative must reach to be refined"""
_TIMES, _MORE = 2.5, 0.03
"""a second pose that holds, or nearly, must leave more unexplained than the best: by this factor and this much more"""
_SHIFT = ShiftOptions(step_m=0.7, apart_m=1.5, most=4, points=300)
_FOLLOWED = 2
"""shifts along one axis from which shifts along the other are tried"""
_QUARTER = np.pi / 2
_DIRECTIONS, _ALIKE = 1500, 0.97
"""normals that axes are found with, and the cosine of the angle within which two face the same way"""


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
    fit: FinalFit | None = None

    @property
    def trusted(self) -> bool:
        return not self.verdict.reason


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


def search(
    a: PreparedCloud,
    b: PreparedCloud,
    scale: SceneScale,
    known: FreeSpaceKnown,
    options: SearchOptions,
    advance: Callable[[int], None] = lambda count: None,
) -> CloudSearchResult:
    """Search for the pose of B in A. ``advance`` is called once for each of :func:`steps` steps."""
    judged = _Judge(a, b, scale, known, options)
    tried: list[Candidate] = []
    if options.initial is not None:
        tried = judged.all_of([options.initial])
        advance(steps(options) - 1)
    else:
        attempts = _attempts(options.matching, scale)
        for number, attempt in enumerate(attempts):
            candidates = guesses(describe(a.submap, attempt), describe(b.submap, attempt), None, attempt)
            if number == 0:
                candidates.insert(0, _as_they_are(a, b))
            tried += judged.all_of(judged.best_fitting(candidates))
            if any(candidate.trusted for candidate in tried):
                advance(len(attempts) - number)
                break
            advance(1)
    if not tried:
        advance(1)
        return CloudSearchResult(None, "no guess: the clouds have too few features in common", 0)
    best = _most_plausible(tried)
    others = judged.all_of(judged.best_fitting(alternatives_of(a.planes, b.planes, best.T_a_b, scale), _FITS))
    advance(1)
    everything = [*tried, *others]
    best = _most_plausible(everything)
    count = len(everything)
    if not best.trusted:
        return CloudSearchResult(best, best.verdict.reason, count)
    rivals = [c for c in everything if (c.trusted or c.nearly) and not _same(c.T_a_b, best.T_a_b)]
    rival = min(rivals, key=lambda c: c.unexplained, default=None)
    if rival is not None and rival.unexplained < _TIMES * best.unexplained + _MORE:
        metres, degrees = pose_difference(best.T_a_b, rival.T_a_b)
        reason = f"ambiguous: another pose, {metres / scale.factor:.2g} m and {degrees:.0f} deg away, holds as well"
        return CloudSearchResult(best, reason, count, rival)
    return CloudSearchResult(best, "", count, rival)


def steps(options: SearchOptions) -> int:
    """The number of steps of a search, for a progress bar."""
    return 1 + len(options.matching.attempts())


def _attempts(matching: GlobalOptions, scale: SceneScale) -> list[GlobalOptions]:
    """The searches by features, whose voxels shrink with scenes that noise keeps smaller than a street."""
    return [replace(attempt, voxel_m=attempt.voxel_m * scale.detail) for attempt in matching.attempts()]


def _as_they_are(a: PreparedCloud, b: PreparedCloud) -> Array:
    """The guess that both clouds are in one frame already."""
    return make_transform(np.eye(3), b.T_cloud_node[:3, 3] - a.T_cloud_node[:3, 3])


def _same(T_one: Array, T_other: Array) -> bool:
    metres, degrees = pose_difference(T_one, T_other)
    return metres <= SAME_M and degrees <= SAME_DEG


def _most_plausible(candidates: Sequence[Candidate]) -> Candidate:
    """The trusted candidate that leaves least unexplained; if none is trusted, details count too."""

    def key(c: Candidate) -> tuple[bool, float]:
        detail = float(np.min(np.nan_to_num([c.evidence.detail_ref, c.evidence.detail_query], nan=0.0)))
        return not c.trusted, c.unexplained + (0.0 if c.trusted else 2 * (1 - detail))

    return min(candidates, key=key)


class _Judge:
    """Refines and judges guesses; a pose that was judged is not judged again."""

    def __init__(
        self, a: PreparedCloud, b: PreparedCloud, scale: SceneScale, known: FreeSpaceKnown, options: SearchOptions
    ) -> None:
        self._a, self._b, self._scale, self._known = a, b, scale, known
        self._backend = options.backend
        self._icp = _DRIFTING if options.drifts else _RIGID
        self._fine = FinePlanes(a.submap), FinePlanes(b.submap)
        self._outdoors = a.outdoors and b.outdoors
        self._seen: list[Array] = []

    def best_fitting(self, poses: Sequence[Array], share: float = 0.0) -> list[Array]:
        """The distinct ones, best fit first; those that fit by at least a share of the best one."""
        some = [poses[k] for k in distinct(poses, SAME_M / 2)]
        fits = np.array([fit(self._a.planes, self._b.planes, T, _SHIFT) for T in some])
        order = np.argsort(-fits, kind="stable")[:_TRIED]
        return [some[k] for k in order if fits[k] >= share * fits.max()]

    def all_of(self, poses: Sequence[Array]) -> list[Candidate]:
        """The candidates of guesses that did not end where an earlier one did."""
        out = []
        for guess in poses:
            result = icp_by_backend(self._backend, self._a, self._b, guess, self._icp)
            if result.count < self._icp.least_matches:
                continue
            if any(pose_difference(T, result.T_ref_query)[0] < 0.05 and _same(T, result.T_ref_query)
                   for T in self._seen):  # fmt: skip
                continue
            self._seen.append(result.T_ref_query)
            out.append(self._judged(result.T_ref_query, result.information))
        return out

    def _judged(self, T: Array, information: Array) -> Candidate:
        fitted = final_fit(*self._fine, T)
        if _same(fitted.T_ref_query, T):
            T, information = fitted.T_ref_query, self._with_drift(fitted.information, information)
        evidence = verification_evidence(self._a, self._b, T, information)
        sigma, direction, sigma_deg = weakest(information, T)
        evidence = replace(evidence, weakest_sigma_m=sigma, weakest_direction=direction, weakest_sigma_deg=sigma_deg)
        return Candidate(
            T,
            information,
            evidence,
            judge(evidence, self._scale, self._known, None if self._outdoors else lambda: self._distinct(T)),
            unexplained(evidence),
            holds_nearly(evidence, self._scale, self._known, self._outdoors),
            fitted,
        )

    def _distinct(self, T: Array) -> Distinct:
        return distinct_evidence(self._a, self._b, T)

    def _with_drift(self, fitted: Array, by_icp: Array) -> Array:
        """The information of the final fit; of clouds put together by odometry, that of ICP, which allows for drift."""
        return by_icp if self._icp is _DRIFTING else fitted


def unexplained(evidence: Evidence) -> float:
    """What speaks against a pose, to compare poses by: 0 if everything that could be compared agrees.

    The larger share of surfaces that the other cloud could see and did not measure, and twice the larger share of
    violations as far as these are known; poses at which there is little to compare come last.
    """
    overlap = np.nan_to_num([evidence.overlap_ref, evidence.overlap_query], nan=0.0)
    violations = np.nan_to_num([evidence.violations_ref, evidence.violations_query], nan=0.0)
    seen = float(np.min(np.nan_to_num([evidence.seen_ref, evidence.seen_query], nan=0.0)))
    return float(1 - overlap.min() + 2 * violations.max() + max(0.0, 1 - seen / WITH_FREE_SPACE.least_seen))


def alternatives_of(a: PlaneMap, b: PlaneMap, T_a_b: Array, scale: SceneScale) -> list[Array]:
    """Shifts of a pose along the axes of A's surfaces, and of the pose turned by quarters about the axes of B's."""
    axes_a, axes_b = _axes(a), _axes(b)
    reach = min(_SHIFT.reach_m, scale.radius_m * scale.factor)
    options = replace(_SHIFT, reach_m=reach)
    turns = [np.zeros(3), *(k * _QUARTER * axis for axis in axes_b for k in (1, 2, 3))]
    out = []
    for turn in turns:
        T = T_a_b @ make_transform(so3_exp(turn), np.zeros(3))
        # Surfaces that face along one axis fit whatever the shift along the other, so that one follows the other.
        for first, second in (axes_a[:2], axes_a[1::-1]):
            for shifted in shifted_poses(a, b, T, options, first)[:_FOLLOWED]:
                out += shifted_poses(a, b, shifted, options, second)[:_FOLLOWED]
    return out


def _axes(planes: PlaneMap) -> list[Array]:
    """Three orthogonal unit vectors (3,): the directions that most surfaces face, the least frequent one first.

    Those of a box are its edges, about which quarter turns map it to itself. Principal axes would not do: of a cube
    any three are.
    """
    normals = planes.sample(1).normals
    normals = normals[np.linspace(0, len(normals) - 1, min(_DIRECTIONS, len(normals))).astype(np.int64)]
    if not len(normals):
        return list(np.eye(3))
    alike = np.abs(normals @ normals.T) > _ALIKE
    first = _mean_axis(normals, int(np.argmax(alike.sum(axis=1))))
    across = np.abs(normals @ first) < 0.5
    if across.any():
        second = _mean_axis(normals, int(np.argmax(np.where(across, alike.sum(axis=1), -1))))
    else:
        second = np.eye(3)[int(np.argmin(np.abs(first)))]
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    axes = [first, second, np.cross(first, second)]
    facing = [int(np.count_nonzero(np.abs(normals @ axis) > _ALIKE)) for axis in axes]
    return [axes[k] for k in np.argsort(facing, kind="stable")]


def _mean_axis(normals: Array, row: int) -> Array:
    """(3,) the mean direction, of either sign, of the normals that face about as one of them does."""
    cosine = normals @ normals[row]
    near = np.abs(cosine) > _ALIKE
    mean = np.sum(normals[near] * np.sign(cosine[near])[:, None], axis=0)
    return np.asarray(mean / np.linalg.norm(mean))
