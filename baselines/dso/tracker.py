"""DSO's coarse tracker as a relocalization tracker, from one start or from several.

Engel, Koltun and Cremers, Direct Sparse Odometry, PAMI 2018. About 2000 pixels of large gradient with known depth are
carried to all pyramid levels and aligned to the query, coarse to fine, together with an affine change of brightness.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from baselines.alignment import (
    DSO_PATTERN,
    Alignment,
    Level,
    LevelPoints,
    MatchSettings,
    Settings,
    align_best,
    choose_points,
    coarse_points,
    image_pyramid,
    match_pixels,
    match_pixels_by_level,
    small_rotations,
)
from relocbench.tracking import Query, Reference, TrackResult

Array = NDArray[np.float64]

LARGEST_LOG_GAIN = 1.2
LARGEST_OFFSET = 200.0
"""grey levels; beyond these two DSO holds the tracking of consecutive frames for failed"""
MATCH_DAMPING = 0.01
"""where a single pixel is matched: what DSO's tracker damps its first step by"""
MIN_VALID_SHARE = 0.1
"""of the reference's points must project into the query for an answer"""


@dataclass(frozen=True, eq=False)
class DsoReference:
    """A prepared keyframe."""

    levels: tuple[LevelPoints, ...]
    """finest first"""
    selected: int
    """points chosen, before they were carried to the levels"""
    maps: tuple[Level, ...]
    """the keyframe's pyramid, finest first"""


class Dso:
    """Direct alignment of raw intensities from the prior, or from the identity without one.

    Confidence, 0 to 1: the mean over all points of the reference of 1 - energy / largest energy at the final pose,
    where a point out of view counts 0. It is 1 for a perfect fit of all points and 0 if none fits.

    Args:
        points: about so many pixels are chosen from a dense depth; points of a sparse map are all used.
        huber: grey levels; larger residuals weigh less.
        cutoff: grey levels; larger residuals are held for outliers.
        cutoff_levels: on so many of the finest levels; coarser ones only have the Huber loss. DSO has the cutoff on
            all (set ``max_levels`` for that), where a motion model gives a near start; from the identity it costs
            half of the distance that can be bridged.
        max_levels: of the image pyramid.
        affine: estimate gain and offset of the brightness between the two images.
        min_points: fewer points with depth are a stated failure.
        dso_failure_test: refuse answers with |log gain| > 1.2 or |offset| > 200, as DSO does. Meant for consecutive
            frames; between seasons it would reject good answers. What it would have said is in the result either way.
        seed: of the choice of points.
    """

    uses_prior = True

    def __init__(
        self,
        points: Annotated[int, Field(ge=1)] = 2000,
        huber: Annotated[float, Field(gt=0)] = 9.0,
        cutoff: Annotated[float, Field(gt=0)] = 20.0,
        cutoff_levels: Annotated[int, Field(ge=1)] = 1,
        max_levels: Annotated[int, Field(ge=1, le=16)] = 6,
        affine: bool = True,
        min_points: Annotated[int, Field(ge=8)] = 30,
        dso_failure_test: bool = False,
        seed: int = 0,
    ) -> None:
        self.points = points
        self.settings = Settings(huber=huber, cutoff=cutoff, cutoff_levels=cutoff_levels, affine=affine)
        self.max_levels = max_levels
        self.min_points = min_points
        self.dso_failure_test = dso_failure_test
        self.seed = seed

    def prepare(self, reference: Reference) -> DsoReference:
        """Choose points and carry them to all levels.

        Raises:
            MethodError: the camera is not pinhole.
        """
        levels = image_pyramid(reference.image, reference.camera, self.max_levels)
        chosen = choose_points(reference, levels, self.points, np.random.default_rng(self.seed))
        return DsoReference(tuple(coarse_points(chosen, levels)), len(chosen), tuple(levels))

    def track(self, reference: DsoReference, query: Query, prior: Array | None = None) -> TrackResult:
        """Align a query to a prepared reference.

        Raises:
            MethodError: the camera is not pinhole.
        """
        levels = image_pyramid(query.image, query.camera, self.max_levels)
        if min(reference.selected, len(reference.levels[0])) < self.min_points:
            return TrackResult.failure(
                f"{reference.selected} reference points with depth, at least {self.min_points} are needed"
            )
        first = np.eye(4) if prior is None else np.asarray(prior, dtype=np.float64)
        # Few points of a sparse map can leave too few pixels on a coarse level: then a finer one is the first.
        usable = list(takewhile(lambda level: len(level) >= self.min_points, reference.levels))
        return self._answer(align_best(usable, levels, self._starts(first), self.settings))

    def match(self, reference: DsoReference, query: Query, uv_ref: Array, uv_start: Array) -> Array:
        """Where single pixels of the keyframe are in the query, by Gauss-Newton on raw intensities from given starts.

        One intensity cannot place a pixel in two directions, so that the eight of DSO's residual pattern around it are
        taken. The tracker's one gain and offset for the whole image are not known here: with ``affine`` mean and
        contrast are taken out of each pattern instead.

        Args:
            uv_ref, uv_start: (N, 2) pixels of the keyframe, and of the query to start from.

        Returns:
            (N, 2) pixels of the query; NaN where the pattern leaves the image or has no contrast.

        Raises:
            MethodError: the camera is not pinhole.
        """
        levels = image_pyramid(query.image, query.camera, self.max_levels)
        return match_pixels(reference.maps, levels, uv_ref, uv_start, self._match_settings())

    def match_levels(self, reference: DsoReference, query: Query, uv_ref: Array, uv_start: Array) -> list[Array]:
        """As :meth:`match` on each level of the pyramid alone, finest first; (N, 2) pixels of the image each."""
        levels = image_pyramid(query.image, query.camera, self.max_levels)
        return match_pixels_by_level(reference.maps, levels, uv_ref, uv_start, self._match_settings())

    def _match_settings(self) -> MatchSettings:
        light: Literal["affine", "none"] = "affine" if self.settings.affine else "none"
        return MatchSettings(DSO_PATTERN, light, damping=MATCH_DAMPING)

    def _starts(self, first: Array) -> list[Array]:
        return [first]

    def _answer(self, found: Alignment) -> TrackResult:
        info = self._info(found)
        if found.trouble:
            return TrackResult.failure(found.trouble, **info)
        if found.final.valid < max(self.min_points, MIN_VALID_SHARE * found.points):
            return TrackResult.failure(
                f"only {found.final.valid} of {found.points} points project into the query", **info
            )
        if self.dso_failure_test and info["dso_would_reject"]:
            return TrackResult.failure(
                f"brightness changes by gain exp({found.a:.2f}) and offset {found.b:.0f}: beyond DSO's limits", **info
            )
        return TrackResult(found.T_query_ref, confidence=self._confidence(found), info=info)

    def _confidence(self, found: Alignment) -> float:
        h, c = self.settings.huber, self.settings.cutoff * found.final.cutoff_factor
        largest = 2 * h * c - h * h if c > h else c * c
        agreement = max(0.0, 1.0 - found.final.energy / largest)
        return float(agreement * found.final.valid / found.points)

    def _info(self, found: Alignment) -> dict[str, Any]:
        final = found.final
        return {
            "energy": float(final.energy),
            "points": found.points,
            "valid": int(final.valid),
            "saturated_share": float(final.saturated / final.valid) if final.valid else 1.0,
            "levels": [outcome.level for outcome in found.outcomes],
            "iterations": [int(outcome.iterations) for outcome in found.outcomes],
            "energies": [float(outcome.energy) for outcome in found.outcomes],
            "cutoff_factors": [float(outcome.cutoff_factor) for outcome in found.outcomes],
            "a": float(found.a),
            "b": float(found.b),
            "dso_would_reject": bool(abs(found.a) > LARGEST_LOG_GAIN or abs(found.b) > LARGEST_OFFSET),
        }


class DsoMultiStart(Dso):
    """As :class:`Dso`, started also from 26 small rotations of the query camera; the lowest final energy wins."""

    def _starts(self, first: Array) -> list[Array]:
        return [first, *(rotation @ first for rotation in small_rotations())]
