"""Coarse-to-fine alignment on feature maps from one start, and the best of several starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from baselines.alignment.features.kernel import workspace_for
from baselines.alignment.features.problem import FeatureProblem
from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.reference import ReferenceFeatures
from baselines.alignment.features.settings import FeatureSettings
from baselines.alignment.shared.levels import LevelOutcome, best_of, coarse_to_fine, failure_of
from baselines.alignment.shared.levenberg import (
    COUNT,
    ENERGY,
    NO_RESIDUALS,
    NOT_FINITE,
    NOT_FINITE_POINTS,
    SATURATED,
    SQUARES,
    WEIGHT,
    minimise_level,
)
from baselines.alignment.shared.pyramid import camera_intrinsics
from baselines.alignment.shared.starts import Start
from relocbench.arrays import Array
from relocbench.errors import MethodError
from relocbench.geometry import compose

UNKNOWNS = 6


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
    failure: str = ""
    """why there is no pose; empty if there is one"""
    abandoned: bool = False
    """the alignment was given up because another start was clearly better"""

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


def align_features(
    reference: ReferenceFeatures,
    query: FeaturePyramid,
    T_start: Array,
    settings: FeatureSettings,
    rival: FeatureAlignment | None = None,
    first_level: int | None = None,
) -> FeatureAlignment:
    """Align from one start, beginning with the coarsest level that both sides have and that has enough points.

    Args:
        reference: points of each level with their features.
        query: maps of each level, with as many channels.
        T_start: (4, 4) first guess of T_query_ref.
        settings: see there.
        rival: the best alignment so far from another start; this one is abandoned on the first level whose root mean
            energy exceeds the rival's by the factor of the settings.
        first_level: coarser levels are left out.

    Raises:
        MethodError: the numbers of channels differ, or a side has no level.
    """
    _require_same_channels(reference, query)
    T, H, variance = np.array(T_start, dtype=np.float64), np.zeros((UNKNOWNS, UNKNOWNS)), float("nan")
    points = len(reference.levels[0])
    residuals = points * (reference.levels[0].values.shape[1] if settings.per_channel else 1)

    def stopped(failure: str) -> FeatureAlignment:
        return FeatureAlignment(T, (), points, residuals, H, variance, failure)

    if not np.all(np.isfinite(T)):
        return stopped("the start is not finite")
    if points < settings.min_points:
        return stopped(f"the reference has {points} points, at least {settings.min_points} are needed")

    def minimise(level: int) -> tuple[LevelOutcome, str]:
        nonlocal T, H, variance
        of_level, query_level = reference.levels[level], query.levels[level]
        huber, cutoff = settings.thresholds(of_level, level)
        if not huber > 0:
            reason = "all the same" if huber == 0 else "not finite"
            nothing = LevelOutcome(level, 0, float("inf"), 0, 0, 1.0, NO_RESIDUALS)
            return nothing, f"the reference's features are {reason} on level {level}"
        problem = FeatureProblem(
            query_level.map,
            of_level.points,
            of_level.values,
            of_level.weights,
            camera_intrinsics(query_level.camera),
            huber,
            settings.per_channel,
            workspace_for(of_level.points),
        )
        T, _, mean_H, statistics, iterations, factor, end = minimise_level(
            problem,
            T,
            np.zeros(2),
            (UNKNOWNS, UNKNOWNS),
            cutoff,
            settings.iterations_of(level),
            settings.damping.schedule,
        )
        H = mean_H * statistics[WEIGHT]
        valid, saturated = int(statistics[COUNT]), int(statistics[SATURATED])
        variance = _variance(statistics, query_level.channels, settings.per_channel)
        outcome = LevelOutcome(level, iterations, float(statistics[ENERGY]), valid, saturated, factor, end)
        if end == NOT_FINITE:
            return outcome, f"features are not finite at {int(statistics[NOT_FINITE_POINTS])} points on level {level}"
        return outcome, failure_of(outcome, T)

    coarsest = coarsest_level(reference, query, settings)
    begin = coarsest if first_level is None else min(first_level, coarsest)
    walk = coarse_to_fine(begin, minimise, rival.outcomes if rival else (), settings.give_up)
    return FeatureAlignment(compose(T), walk.outcomes, points, residuals, H, variance, walk.failure, walk.abandoned)


def align_features_best(
    reference: ReferenceFeatures, query: FeaturePyramid, starts: Sequence[Start], settings: FeatureSettings
) -> FeatureAlignment:
    """Align from every start and return the alignment of lowest final energy.

    A failed alignment is returned only if all of them failed.

    Raises:
        ValueError: there is no start.
        MethodError: the numbers of channels differ.
    """
    return best_of(
        starts, lambda start, rival: align_features(reference, query, start.T_query_ref, settings, rival, start.level)
    )


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
