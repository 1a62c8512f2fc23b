"""Coarse-to-fine alignment on feature maps from one start, and the best of several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from baselines.alignment.features.kernel import linearize_features, workspace_for
from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.reference import FeaturePoints, ReferenceFeatures
from baselines.alignment.features.settings import FeatureSettings
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.levels import Descent, LevelOutcome, failure_of
from baselines.alignment.shared.levenberg import (
    COUNT,
    ENERGY,
    NO_RESIDUALS,
    NOT_FINITE,
    NOT_FINITE_POINTS,
    SATURATED,
    SQUARES,
    STATISTICS,
    WEIGHT,
    linearize_at,
    minimise_level_from_each,
)
from baselines.alignment.shared.pyramid import camera_intrinsics
from baselines.alignment.shared.starts import Start
from relocbench.arrays import Array
from relocbench.errors import MethodError
from relocbench.geometry import compose, make_transform

UNKNOWNS = 6
SAME_M, SAME_RAD = 0.02, 0.002
"""estimates of several starts that are nearer to each other are at the same pose"""
NEARBY_LEVEL, NEARBY_BEST = 1, 2
"""where further starts are tried, and around how many of the best poses"""
COMPARED_LEVELS = 2
"""the finest levels, by whose energies together the alignments of several starts are compared in the end"""
APART, APART_RAD = 0.05, float(np.deg2rad(3.0))
"""share of the points' median depth; estimates of several starts that are farther from each other are at poses that
exclude each other"""
LARGEST_LEAD = 1.0
SIGMAS_M = 1e-4, 1e2
"""between which a standard deviation of the translation says something about an answer"""


class FeatureProblem(NamedTuple):
    """One level; the fields are arguments of :func:`baselines.alignment.features.kernel.linearize_features`."""

    level_map: FloatArray
    points: FloatArray
    values: FloatArray
    weights: FloatArray
    intrinsics: Array
    huber: float
    per_channel: bool
    workspace: tuple[FloatArray, FloatArray, FloatArray]


@overload(linearize_at)
def _linearize_features(
    problem: Any, T_query_ref: Any, brightness: Any, cutoff: Any, H: Any, g: Any, statistics: Any
) -> Callable[..., None] | None:
    if not (isinstance(problem, types.NamedTuple) and problem.instance_class is FeatureProblem):
        return None

    def compiled(problem: Any, T_query_ref: Any, brightness: Any, cutoff: Any, H: Any, g: Any, statistics: Any) -> None:
        level_map, points, values, weights, intrinsics, huber, per_channel, workspace = problem
        linearize_features(
            level_map, points, values, weights, intrinsics, T_query_ref, huber, cutoff, per_channel, workspace,
            H, g, statistics,
        )  # fmt: skip

    return compiled


@dataclass(frozen=True, eq=False)
class FeatureAlignment:
    """The result of an alignment."""

    T_query_ref: Array
    """(4, 4)"""
    outcomes: tuple[LevelOutcome, ...]
    """in the order of work, coarsest level first; a level that is repeated with the base cutoff occurs twice"""
    points: int
    """number on the finest level, valid or not"""
    residuals: int
    """as many as points, or D times as many if the robust loss is applied per channel"""
    H: Array
    """(6, 6) sum of omega w J^T J over the points of the last level: the information matrix of the left increment
    (translation 3, rotation 3; axes of the query camera) for residuals of variance one"""
    variance: float
    """variance of one channel's residual at omega = 1, estimated from the inliers of the last level; NaN without any"""
    misfit: float = float("inf")
    """the mean energies of the two finest levels, each in units of its squared Huber threshold, added"""
    lead: float = LARGEST_LEAD
    """the logarithm of how many times larger the misfit of the best other pose is, at most 1: two poses are others if
    they are more than a twentieth of the points' median depth or 3 degrees apart"""
    failure: str = ""
    """why there is no pose; empty if there is one"""
    starts: tuple[int, ...] = ()
    """how many starts were aligned on each level, finest first"""
    reached: tuple[Array, ...] = ()
    """(4, 4) each, the poses of all starts that were aligned on the finest level without failure"""

    @property
    def final(self) -> LevelOutcome:
        """The outcome of the last level worked on."""
        return self.outcomes[-1]

    @property
    def energy(self) -> float:
        """The mean energy of the valid residuals of the last level; infinite if no level was worked on."""
        return self.final.energy if self.outcomes else float("inf")

    @property
    def inlier_share(self) -> float:
        """The share of the reference's residuals on the finest level that are in view and within the cutoff."""
        if self.failure or not self.residuals:
            return 0.0
        return (self.final.valid - self.final.saturated) / self.residuals

    @property
    def covariance(self) -> Array:
        """The covariance (6, 6) of the left increment, variance * H^-1; NaN if H is singular.

        It treats the residuals of neighbouring points and channels as independent, which they are not, and is therefore
        too small: it serves to compare directions and pairs, not as an absolute uncertainty.
        """
        try:
            return np.asarray(self.variance * np.linalg.inv(self.H), dtype=np.float64)
        except np.linalg.LinAlgError:
            return np.full((UNKNOWNS, UNKNOWNS), np.nan)

    @property
    def precision(self) -> float:
        """The negative logarithm of the standard deviation (m) of the translation, over all three axes.

        The standard deviation is that of :attr:`covariance`, taken to be in ``SIGMAS_M``; the largest of these where
        the normal equations do not hold the translation.
        """
        variances = np.diag(self.covariance)[:3]
        sigma = np.sqrt(np.sum(variances)) if np.all(variances >= 0) else np.inf
        return -float(np.log(np.clip(sigma, *SIGMAS_M)))


def align_features(
    reference: ReferenceFeatures, query: FeaturePyramid, starts: Sequence[Start], settings: FeatureSettings
) -> FeatureAlignment:
    """Align from one start or several and return the alignment that fits best.

    The coarsest level is the last that both sides have with enough points. All starts are aligned on a level before any
    of them goes on to the next finer one, which those do that are best there: of several that have come to the same
    pose one; none whose root mean energy is more than ``give_up`` times the lowest; and at most ``kept`` of them.
    Starts with a finer first level join on it, and on the level next to the finest those ``nearby`` the best poses.
    Of those that come to the end, the one wins that has the lowest sum of the energies of the two finest levels, each
    in units of its squared Huber threshold. A failed alignment is returned only if all of them failed.

    Args:
        reference: points of each level with their features.
        query: maps of each level, with as many channels.
        starts: at least one.

    Raises:
        ValueError: there is no start.
        MethodError: the numbers of channels differ, or a side has no level.
    """
    if not starts:
        raise ValueError("an alignment needs at least one start")
    _require_same_channels(reference, query)
    coarsest = coarsest_level(reference, query, settings)
    estimates = [_Estimate(start, coarsest) for start in starts]
    _refuse_starts(estimates, len(reference.levels[0]), settings)
    aligned = [0] * (coarsest + 1)
    for level in range(coarsest, -1, -1):
        reached = [estimate for estimate in estimates if estimate.is_on(level)]
        _minimise(reached, level, reference, query, settings)
        if level == NEARBY_LEVEL:
            more = _nearby(reached, reference.levels[level], settings)
            _minimise(more, level, reference, query, settings)
            reached, estimates = reached + more, estimates + more
        aligned[level] = len(reached)
        _keep_best([estimate for estimate in reached if not estimate.descent.failure], level, settings)
    # Nobody is given up before somebody fits better; where all failed, the first reason is told.
    ended = [estimate for estimate in estimates if not estimate.descent.abandoned]
    right = [estimate for estimate in ended if not estimate.descent.failure]
    fits = sorted(((_misfit(each, reference, query, settings), each) for each in right), key=lambda fit: fit[0])
    misfit, best = fits[0] if fits else (float("inf"), ended[0])
    return FeatureAlignment(
        T_query_ref=compose(best.T) if np.all(np.isfinite(best.T)) else best.T,
        outcomes=tuple(best.descent.outcomes),
        points=len(reference.levels[0]),
        residuals=_residuals(reference.levels[0], settings),
        H=best.H,
        variance=best.variance,
        misfit=misfit,
        lead=_lead(fits, reference.levels[0]),
        failure=best.descent.failure,
        starts=tuple(aligned),
        reached=tuple(
            each.T
            for each in estimates
            if each.descent.level < 0 and (each.descent.abandoned or not each.descent.failure)
        ),
    )


def _nearby(reached: Sequence[_Estimate], points: FeaturePoints, settings: FeatureSettings) -> list[_Estimate]:
    """Starts around the best poses of a level; see :attr:`FeatureSettings.nearby`."""
    best: list[_Estimate] = []
    for estimate in sorted((each for each in reached if not each.descent.failure), key=lambda each: each.energy):
        if len(best) < NEARBY_BEST and not any(estimate.is_at(better) for better in best):
            best.append(estimate)
    moves = [
        share * points.median_depth * sign * axis
        for share in settings.nearby
        for sign in (1.0, -1.0)
        for axis in np.eye(3)
    ]
    moved = (make_transform(np.eye(3), move) @ compose(estimate.T) for estimate in best for move in moves)
    return [_Estimate(Start(pose), NEARBY_LEVEL) for pose in moved]


def _misfit(
    estimate: _Estimate, reference: ReferenceFeatures, query: FeaturePyramid, settings: FeatureSettings
) -> float:
    """The sum of the mean energies of the finest levels at a pose, each in units of its squared Huber threshold.

    Infinite where a level has no valid residual, or a feature that is not finite.
    """
    H, g, statistics = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS), np.empty(STATISTICS)
    total = 0.0
    for level in range(min(COMPARED_LEVELS, len(reference), len(query))):
        huber, cutoff = settings.thresholds(reference.levels[level], 0)  # the finest level's: the cutoff counts on all
        if huber > 0:
            p = _problem(level, reference, query, huber, settings)
            linearize_features(
                p.level_map, p.points, p.values, p.weights, p.intrinsics, estimate.T, p.huber, cutoff, p.per_channel,
                p.workspace, H, g, statistics,
            )  # fmt: skip
            total += float(statistics[ENERGY]) / huber**2
    return total if np.isfinite(total) else np.inf


def _lead(fits: Sequence[tuple[float, _Estimate]], points: FeaturePoints) -> float:
    """See :attr:`FeatureAlignment.lead`; ``fits`` are misfits and their estimates, the best first."""
    for misfit, estimate in fits[1:]:
        lowest, best = fits[0]
        if not estimate.is_at(best, APART * points.median_depth, APART_RAD):
            if misfit == lowest:  # also where both are infinite
                return 0.0
            return min(float(np.log(misfit / lowest)), LARGEST_LEAD) if lowest > 0 else LARGEST_LEAD
    return LARGEST_LEAD


def _keep_best(reached: Sequence[_Estimate], level: int, settings: FeatureSettings) -> None:
    """Give up all but the best of the estimates that have reached a level, see :func:`align_features`."""
    kept: list[_Estimate] = []
    for estimate in sorted(reached, key=lambda each: each.energy):
        worse = kept and estimate.energy > settings.give_up**2 * kept[0].energy
        if worse or len(kept) == settings.kept_on(level) or any(estimate.is_at(better) for better in kept):
            estimate.descent.give_up()
        else:
            kept.append(estimate)


class _Estimate:
    """The pose of one start on its way from level to level, with the normal equations of the last one."""

    def __init__(self, start: Start, coarsest: int) -> None:
        self.T = np.array(start.T_query_ref, dtype=np.float64)
        self.H = np.zeros((UNKNOWNS, UNKNOWNS))
        self.variance = float("nan")
        self.descent = Descent(coarsest if start.level is None else min(start.level, coarsest))

    @property
    def energy(self) -> float:
        return self.descent.outcomes[-1].energy

    def is_on(self, level: int) -> bool:
        """Whether this level is the next to be worked on."""
        return self.descent.level == level and not self.descent.ended

    def is_at(self, other: _Estimate, metres: float = SAME_M, radians: float = SAME_RAD) -> bool:
        """Whether the camera stands where another estimate has it, and looks the same way."""
        return (
            float(np.linalg.norm(self.T[:3, 3] - other.T[:3, 3])) < metres
            and float(np.linalg.norm(self.T[:3, :3] - other.T[:3, :3])) < np.sqrt(2) * radians
        )


def _refuse_starts(estimates: Sequence[_Estimate], points: int, settings: FeatureSettings) -> None:
    """Fail the starts that are not finite; all of them if the reference has too few points."""
    for estimate in estimates:
        if not np.all(np.isfinite(estimate.T)):
            estimate.descent.failure = "the start is not finite"
        elif points < settings.min_points:
            estimate.descent.failure = f"the reference has {points} points, at least {settings.min_points} are needed"


def _minimise(
    estimates: Sequence[_Estimate],
    level: int,
    reference: ReferenceFeatures,
    query: FeaturePyramid,
    settings: FeatureSettings,
) -> None:
    """Align a level from where each of the estimates is, once more where its cutoff had to be raised."""
    if not estimates:
        return
    points = reference.levels[level]
    huber, cutoff = settings.thresholds(points, level)
    if not huber > 0:
        reason = "all the same" if huber == 0 else "not finite"
        nothing = LevelOutcome(level, 0, float("inf"), 0, 0, 1.0, NO_RESIDUALS)
        for estimate in estimates:
            estimate.descent.advance(nothing, f"the reference's features are {reason} on level {level}")
        return
    found = minimise_level_from_each(
        _problem(level, reference, query, huber, settings),
        np.stack([estimate.T for estimate in estimates]),
        UNKNOWNS,
        cutoff,
        settings.iterations_of(level),
        settings.damping.schedule,
    )
    residuals = _residuals(points, settings)
    for estimate, T, mean_H, statistics, iterations, factor, end in zip(estimates, *found, strict=True):
        estimate.T, estimate.H = T, mean_H * statistics[WEIGHT]
        estimate.variance = _variance(statistics, points.values.shape[1], settings.per_channel)
        valid, saturated = int(statistics[COUNT]), int(statistics[SATURATED])
        outcome = LevelOutcome(
            level, int(iterations), float(statistics[ENERGY]), valid, saturated, float(factor), int(end)
        )
        failure = failure_of(outcome, T)
        if end == NOT_FINITE:
            failure = f"features are not finite at {int(statistics[NOT_FINITE_POINTS])} points on level {level}"
        elif not failure and valid < settings.min_valid_share * residuals:
            failure = f"only {valid} of {residuals} residuals project into the query on level {level}"
        estimate.descent.advance(outcome, failure)
    _minimise([each for each in estimates if each.is_on(level)], level, reference, query, settings)


def _problem(
    level: int, reference: ReferenceFeatures, query: FeaturePyramid, huber: float, settings: FeatureSettings
) -> FeatureProblem:
    points, seen = reference.levels[level], query.levels[level]
    return FeatureProblem(
        seen.map,
        points.points,
        points.values,
        points.weights,
        camera_intrinsics(seen.camera),
        huber,
        settings.per_channel,
        workspace_for(points.points),
    )


def _residuals(points: FeaturePoints, settings: FeatureSettings) -> int:
    """The number of a level's residuals, in view or not."""
    return len(points) * (points.values.shape[1] if settings.per_channel else 1)


def coarsest_level(reference: ReferenceFeatures, query: FeaturePyramid, settings: FeatureSettings) -> int:
    """The coarsest level such that it and all finer ones have enough points."""
    coarsest = 0
    for level in range(min(len(reference), len(query))):
        if len(reference.levels[level]) < settings.min_points:
            break
        coarsest = level
    return coarsest


def _variance(statistics: Array, channels: int, per_channel: bool) -> float:
    """The sum of omega w r^2 over the inliers' channels, divided by the degrees of freedom; NaN if there are none."""
    inliers = statistics[COUNT] - statistics[SATURATED]
    freedom = inliers * (1 if per_channel else channels) - UNKNOWNS
    return float(statistics[SQUARES] * statistics[WEIGHT] / freedom) if freedom > 0 else float("nan")


def _require_same_channels(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    if not len(reference) or not len(query):
        raise MethodError("feature alignment needs at least one level on both sides")
    for number, (points, level) in enumerate(zip(reference.levels, query.levels, strict=False)):
        if points.values.shape[1] != level.channels:
            raise MethodError(
                f"features of level {number} have {points.values.shape[1]} channels in the reference, "
                f"{level.channels} in the query"
            )
