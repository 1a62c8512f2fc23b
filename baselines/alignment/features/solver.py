"""Coarse-to-fine alignment on feature maps: the levels one after another, and several starts against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.features.kernel import COUNT, ENERGY, NOT_FINITE, SATURATED, SQUARES, WEIGHT
from baselines.alignment.features.levenberg import FEATURES_NOT_FINITE, minimise_feature_level
from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.reference import ReferenceFeatures
from baselines.alignment.features.settings import FeatureSettings
from baselines.alignment.shared.levels import LevelOutcome, best_of, coarse_to_fine, trouble_of
from baselines.alignment.shared.levenberg import NO_RESIDUALS
from baselines.alignment.shared.pyramid import camera_intrinsics
from baselines.alignment.shared.starts import Start
from relocbench.errors import MethodError
from relocbench.geometry import compose

Array = NDArray[np.float64]

UNKNOWNS = 6


@dataclass(frozen=True, eq=False)
class FeatureAlignment:
    """Where the alignment ended."""

    T_query_ref: Array
    """(4, 4)"""
    outcomes: tuple[LevelOutcome, ...]
    """in the order of work, coarsest level first; a level repeated with the base cutoff comes twice"""
    points: int
    """of the finest level, valid or not"""
    residuals: int
    """as many, or D times as many where each channel counts"""
    H: Array
    """(6, 6) sum omega w J^T J over the points of the last level worked on: the information on the left increment
    (translation 3, rotation 3; the query camera's axes) for residuals of variance one"""
    variance: float
    """of one channel's residual where omega is 1, from the inliers' residuals of the last level; NaN without"""
    trouble: str = ""
    """why there is no answer; empty if there is one"""
    abandoned: bool = False
    """given up because another start was clearly better"""

    @property
    def final(self) -> LevelOutcome:
        """The last level worked on."""
        return self.outcomes[-1]

    @property
    def energy(self) -> float:
        """Mean over the valid residuals of the last level; infinite where none was worked on."""
        return self.final.energy if self.outcomes else float("inf")

    @property
    def inlier_share(self) -> float:
        """Residuals in view and within the cutoff, as a share of all the reference's on the finest level."""
        if self.trouble or not self.residuals:
            return 0.0
        return (self.final.valid - self.final.saturated) / self.residuals

    @property
    def covariance(self) -> Array:
        """(6, 6) of the left increment: variance * H^-1; NaN where H cannot be inverted.

        It takes the residuals of neighbouring points and channels for independent, which they are not, and is
        therefore too small: good for comparing directions and pairs, not as a standard deviation in metres.
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
    """Align from one start, coarsest level first that both sides have and that has points enough.

    Args:
        reference: points of each level with their features.
        query: maps of each level, with as many channels.
        T_start: (4, 4) first guess of T_query_ref.
        settings: robust loss, iterations, damping.
        rival: the best alignment so far from another start; this one is abandoned on the first level whose root mean
            energy is 1.5 times the rival's or more.
        first_level: coarser ones are left out.

    Raises:
        MethodError: the numbers of channels differ, or a side has no level.
    """
    _require_same_channels(reference, query)
    T, H, variance = np.array(T_start, dtype=np.float64), np.zeros((UNKNOWNS, UNKNOWNS)), float("nan")
    points = len(reference.levels[0])
    residuals = points * (reference.levels[0].values.shape[1] if settings.per_channel else 1)

    def stopped(trouble: str) -> FeatureAlignment:
        return FeatureAlignment(T, (), points, residuals, H, variance, trouble)

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
        T, mean_H, statistics, iterations, factor, end = minimise_feature_level(
            query_level.map,
            of_level.points,
            of_level.values,
            of_level.weights,
            camera_intrinsics(query_level.camera),
            T,
            huber,
            cutoff,
            settings.per_channel,
            settings.iterations_of(level),
            astuple(settings.damping),
        )
        H = mean_H * statistics[WEIGHT]
        valid, saturated = int(statistics[COUNT]), int(statistics[SATURATED])
        variance = _variance(statistics, query_level.channels, settings.per_channel)
        outcome = LevelOutcome(level, iterations, float(statistics[ENERGY]), valid, saturated, factor, end)
        if end == FEATURES_NOT_FINITE:
            return outcome, f"features are not finite at {int(statistics[NOT_FINITE])} points on level {level}"
        return outcome, trouble_of(outcome, T)

    coarsest = _coarsest(reference, query, settings)
    begin = coarsest if first_level is None else min(first_level, coarsest)
    walk = coarse_to_fine(begin, minimise, rival.outcomes if rival else ())
    return FeatureAlignment(compose(T), walk.outcomes, points, residuals, H, variance, walk.trouble, walk.abandoned)


def align_features_best(
    reference: ReferenceFeatures, query: FeaturePyramid, starts: Sequence[Start], settings: FeatureSettings
) -> FeatureAlignment:
    """Align from every start, each told the best so far; the lowest final energy wins.

    An alignment with trouble is returned only if all have it.

    Raises:
        ValueError: no start.
        MethodError: the numbers of channels differ.
    """
    return best_of(
        starts, lambda start, rival: align_features(reference, query, start.T_query_ref, settings, rival, start.level)
    )


def _coarsest(reference: ReferenceFeatures, query: FeaturePyramid, settings: FeatureSettings) -> int:
    """The last level before one has too few points."""
    coarsest = 0
    for level in range(min(len(reference), len(query))):
        if len(reference.levels[level]) < settings.min_points:
            break
        coarsest = level
    return coarsest


def _variance(statistics: Array, channels: int, per_channel: bool) -> float:
    """Sum omega w r^2 over the inliers' channels, divided by their number less the unknowns; NaN if none is left."""
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
