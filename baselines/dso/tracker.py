"""DSO's coarse tracker as a relocalization tracker, from one start or from several.

Engel, Koltun and Cremers, Direct Sparse Odometry, PAMI 2018. About 2000 pixels of large gradient with known depth are
propagated to all pyramid levels and aligned to the query, coarse to fine, together with affine brightness parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from baselines.alignment.direct.settings import Settings
from baselines.alignment.direct.solver import Alignment, align_best
from baselines.alignment.matching import DSO_PATTERN, MatchSettings, match_pixels, match_pixels_by_level
from baselines.alignment.shared.depth_map import LevelPoints, coarse_points
from baselines.alignment.shared.pyramid import Level, image_pyramid
from baselines.alignment.shared.selection import choose_points
from baselines.alignment.shared.starts import ALONG_THE_ROAD, moved_along, small_rotations
from baselines.calibration import DSO, DSO_MULTISTART, Calibration
from baselines.correlation import GreyImage, correlations
from baselines.options import Finite
from relocbench.arrays import Array
from relocbench.tracking import Query, Reference, TrackResult

LARGEST_LOG_GAIN = 1.2
LARGEST_OFFSET = 200.0
"""grey levels; beyond either limit DSO considers the tracking of consecutive frames failed"""
MATCH_DAMPING = 0.01
"""damping of the matching of single pixels: that of the first step of DSO's tracker"""
MIN_VALID_SHARE = 0.1
"""share of the reference's points that must project into the query"""


@dataclass(frozen=True, eq=False)
class DsoReference:
    """A prepared keyframe."""

    levels: tuple[LevelPoints, ...]
    """finest first"""
    selected: int
    """number of points chosen, before they were propagated to the levels"""
    maps: tuple[Level, ...]
    """the keyframe's pyramid, finest first"""


@dataclass(eq=False)
class Dso:
    """Direct alignment of raw intensities from the prior, or from the identity without one.

    The confidence is the probability that the answer is within 0.25 m and 2 degrees, from a calibration of the
    correlation between keyframe and query around the points, with 0 for points out of view.

    Args:
        points: largest number of points with depth; of more, those of large gradient are chosen.
        huber: grey levels; larger residuals are downweighted.
        cutoff: grey levels; larger residuals are treated as outliers.
        cutoff_levels: number of the finest levels on which the cutoff applies; coarser ones only have the Huber loss.
            DSO applies it on all (set it to ``max_levels``), starting from a motion model; from the identity it halves
            the distance that can be bridged.
        max_levels: largest number of pyramid levels.
        affine: estimate affine brightness parameters, a gain and an offset, between the two images.
        min_points: with fewer points that have depth, tracking fails.
        min_correlation: with a smaller mean correlation around the points, tracking fails; below the default no answer
            was right on validation districts.
        dso_failure_test: refuse poses with |log gain| > 1.2 or |offset| > 200, as DSO does. The test is meant for
            consecutive frames; between seasons it would reject good poses. Its verdict is in the result either way.
        along: lengths in metres, positive ahead, of arcs of circles along which the camera of the prior, or of the
            identity, drives to further starts; the lowest final energy wins.
        turns_deg: degrees, positive to the right, by which the camera is turned at the end of an arc, 0 straight on:
            there is a start for each length and turn.
        seed: of the choice of points.
    """

    uses_prior = True
    calibration: ClassVar[Calibration] = DSO

    points: Annotated[int, Field(ge=1)] = 2000
    huber: Annotated[float, Field(gt=0)] = 9.0
    cutoff: Annotated[float, Field(gt=0)] = 20.0
    cutoff_levels: Annotated[int, Field(ge=1)] = 1
    max_levels: Annotated[int, Field(ge=1, le=16)] = 6
    affine: bool = True
    min_points: Annotated[int, Field(ge=8)] = 30
    min_correlation: Annotated[float, Field(ge=-1, le=1)] = 0.03
    dso_failure_test: bool = False
    along: tuple[Finite, ...] = ()
    turns_deg: tuple[Finite, ...] = (0.0,)
    seed: int = 0

    def __post_init__(self) -> None:
        self.settings = Settings(self.huber, self.cutoff, self.cutoff_levels, affine=self.affine)
        self.turns = tuple(np.deg2rad(self.turns_deg))

    @classmethod
    def assumes(cls, **parameters: Any) -> str:
        """What is assumed of how cameras move, shown behind the method's name."""
        return ALONG_THE_ROAD if parameters["along"] else ""

    def prepare(self, reference: Reference) -> DsoReference:
        """Choose points and propagate them to all levels.

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
        # A sparse map may leave too few pixels on a coarse level; then a finer level is the first.
        usable = list(takewhile(lambda level: len(level) >= self.min_points, reference.levels))
        return self._answer(align_best(usable, levels, self._starts(first), self.settings), reference, levels[0])

    def match(self, reference: DsoReference, query: Query, uv_ref: Array, uv_start: Array) -> Array:
        """Find single pixels of the keyframe in the query, by Gauss-Newton on raw intensities from given starts.

        Since one intensity does not determine two coordinates, the eight pixels of DSO's residual pattern are matched
        together. The brightness parameters of the whole image are not known here; with ``affine``, mean and contrast
        are taken out of each pattern instead.

        Args:
            reference: the prepared keyframe.
            query: the image to search.
            uv_ref: (N, 2) pixels of the keyframe.
            uv_start: (N, 2) pixels of the query to start from.

        Returns:
            (N, 2) pixels of the query; NaN where the pattern leaves the image or has no contrast.

        Raises:
            MethodError: the camera is not pinhole.
        """
        levels = image_pyramid(query.image, query.camera, self.max_levels)
        return match_pixels(reference.maps, levels, uv_ref, uv_start, self._match_settings())

    def match_levels(self, reference: DsoReference, query: Query, uv_ref: Array, uv_start: Array) -> list[Array]:
        """As :meth:`match`, on each pyramid level alone, finest first; (N, 2) pixels of the image for each."""
        levels = image_pyramid(query.image, query.camera, self.max_levels)
        return match_pixels_by_level(reference.maps, levels, uv_ref, uv_start, self._match_settings())

    def _match_settings(self) -> MatchSettings:
        brightness: Literal["affine", "none"] = "affine" if self.settings.affine else "none"
        return MatchSettings(DSO_PATTERN, brightness, damping=MATCH_DAMPING)

    def _starts(self, first: Array) -> list[Array]:
        return [first, *moved_along(first, self.along, self.turns)]

    def _answer(self, found: Alignment, reference: DsoReference, query: Level) -> TrackResult:
        info = self._info(found)
        if found.failure:
            return TrackResult.failure(found.failure, **info)
        if found.final.valid < max(self.min_points, MIN_VALID_SHARE * found.points):
            return TrackResult.failure(
                f"only {found.final.valid} of {found.points} points project into the query", **info
            )
        if self.dso_failure_test and info["dso_would_reject"]:
            return TrackResult.failure(
                f"brightness changes by gain exp({found.a:.2f}) and offset {found.b:.0f}: beyond DSO's limits", **info
            )
        correlation, seen_again = evidence_for(found.T_query_ref, reference.levels[0], reference.maps[0], query)
        info |= {"correlation": correlation, "seen_again": seen_again}
        if correlation < self.min_correlation:
            return TrackResult.failure(
                f"keyframe and query have a correlation of {correlation:.2f} around the points, at least "
                f"{self.min_correlation:.2f} is needed",
                **info,
            )
        return TrackResult(found.T_query_ref, confidence=self.calibration.confidence(info), info=info)

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

    calibration = DSO_MULTISTART

    def _starts(self, first: Array) -> list[Array]:
        return [*super()._starts(first), *(rotation @ first for rotation in small_rotations())]


ALIKE = 0.7
"""correlation from which a point counts as seen again"""


def evidence_for(T_query_ref: Array, points: LevelPoints, reference: Level, query: Level) -> tuple[float, float]:
    """What speaks for a pose: the mean correlation around the points of a level of the keyframe, -1 to 1, and the share
    of those whose correlation is at least :data:`ALIKE`. Points out of view count as points that look different."""
    depth = 1.0 / points.points[2].astype(np.float64)
    found = correlations(T_query_ref, points.uv.astype(np.float64), depth, _grey(reference), _grey(query))
    return float(np.mean(found)), float(np.mean(found >= ALIKE))


def _grey(level: Level) -> GreyImage:
    return GreyImage(level.map[..., 0], level.camera)
