"""From correspondences of a keyframe and a query to a pose, however they are found."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, Generic, TypeVar

import numpy as np
from pydantic import Field

from baselines.calibration import Calibration
from baselines.correlation import GreyImage, correlations, strong_pixels
from baselines.feature_pnp.keyframe_depth import inverse_depth_at
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose, refine_pose, rival_inliers
from relocbench.arrays import Array, Indices
from relocbench.tracking import Query, Reference, TrackResult

_SMALLEST_SIGMA = 0.03  # metres; a smaller standard deviation says no more about errors of 0.25 m
SHOWN_INLIERS, SHOWN_OTHERS = 50, 25
"""matches at most that an answer tells; all have no room in its info"""
_MINIMAL = 4  # three points leave up to four solutions, a fourth one decides


@dataclass(frozen=True, eq=False)
class StrongPixels:
    """Where a keyframe, at half its size, has a large gradient and a depth: an answer is checked there."""

    half: GreyImage
    """the image at half its size"""
    uv: Array
    """(M, 2) pixels of ``half``"""
    depth: Array
    """(M,) metres"""

    @staticmethod
    def of(reference: Reference, depth_radius_px: float | None) -> StrongPixels:
        """Those of a keyframe; see :func:`inverse_depth_at` for the radius."""
        half = GreyImage.half_of(reference.image, reference.camera)
        uv = strong_pixels(half)
        inverse_depth, _ = inverse_depth_at(reference, 2 * uv + 0.5, depth_radius_px)
        known = inverse_depth > 0
        return StrongPixels(half, uv[known], 1.0 / inverse_depth[known])


@dataclass(frozen=True, eq=False)
class PreparedKeyframe:
    """What a keyframe is prepared to, whatever finds the correspondences."""

    strong: StrongPixels


Prepared = TypeVar("Prepared", bound=PreparedKeyframe)


@dataclass(kw_only=True, eq=False)
class PnpOptions:
    """The parameters of every tracker that finds a pose from correspondences; each adds its own.

    Args:
        depth_radius_px: largest distance, in pixels, from a pixel to points of a sparse map that give its depth; by
            default it follows the density of the map.
        reprojection_threshold_px: largest error, in query pixels, of an inlier on the finest pyramid level.
        min_inliers: with fewer inliers, tracking fails.
        max_iterations: largest number of minimal samples.
        confidence: the probability of success at which sampling stops early.
        seed: of the sampling.
    """

    depth_radius_px: Annotated[float, Field(ge=0)] | None = None
    reprojection_threshold_px: Annotated[float, Field(gt=0)] = 2.0
    min_inliers: Annotated[int, Field(ge=4)] = 10
    max_iterations: Annotated[int, Field(ge=1)] = 10000
    confidence: Annotated[float, Field(gt=0, lt=1)] = 0.9999
    seed: Annotated[int, Field(ge=0)] = 0


class Pnp(PnpOptions, ABC, Generic[Prepared]):
    """MAGSAC perspective-n-point from correspondences, robust refinement.

    Subclasses find the correspondences. The confidence is the probability that the answer is within 0.25 m and 2
    degrees, from a calibration of the answer's lead, the logarithm of its inliers over those of the best other pose, of
    its precision, the negative logarithm of the translation's standard deviation in metres, and of the correlation of
    keyframe and query around pixels of large gradient.
    """

    calibration: ClassVar[Calibration | None] = None
    """None: answers have no confidence"""

    @abstractmethod
    def prepare(self, reference: Reference) -> Prepared:
        """What a keyframe has to be known by, computed once for all its queries."""

    @abstractmethod
    def correspond(self, reference: Prepared, query: Query) -> Matches2D3D:
        """The points of a keyframe and the pixels that see them in a query, each pixel at most once."""

    def track(self, reference: Prepared, query: Query, prior: Array | None = None) -> TrackResult:
        """Find the pose of a query; the prior is not used."""
        matches = self.correspond(reference, query)
        if len(matches) < max(_MINIMAL, self.min_inliers):
            return TrackResult.failure(
                f"{len(matches)} matches, {max(_MINIMAL, self.min_inliers)} needed", matches=len(matches)
            )
        threshold = self.reprojection_threshold_px
        start = ransac_pose(matches, query.camera, threshold, self.max_iterations, self.confidence, self.seed)
        if start is None:
            shown = sampled_matches(matches, np.zeros(0, dtype=np.int64))
            return TrackResult.failure("no pose agrees with the matches", matches=len(matches), shown_matches=shown)
        refined = refine_pose(start, matches, query.camera, threshold)
        inliers = len(refined.inliers)
        translation_sigma, rotation_sigma = refined.sigmas
        info = {
            "matches": len(matches),
            "inliers": inliers,
            "reprojection_rms_px": _finite_or_none(refined.rms_px),
            "translation_sigma_m": _finite_or_none(translation_sigma),
            "rotation_sigma_deg": _finite_or_none(float(np.rad2deg(rotation_sigma))),
            "shown_matches": sampled_matches(matches, refined.inliers),
        }
        if inliers < self.min_inliers:
            return TrackResult.failure(f"{inliers} inliers, {self.min_inliers} needed", **info)
        if not np.all(np.isfinite(refined.T_query_ref)):
            return TrackResult.failure("the pose is not finite", **info)
        distance = float(np.median(np.linalg.norm(matches.points[refined.inliers], axis=-1)))
        if not translation_sigma < distance:
            return TrackResult.failure("degenerate: the inliers do not hold the pose", **info)
        rival = rival_inliers(refined.T_query_ref, matches, query.camera, threshold, self.seed)
        evidence = {
            "lead": float(np.log((inliers + 1) / (rival + 1))),
            "precision": float(-np.log(max(translation_sigma, _SMALLEST_SIGMA))),
            "correlation": _correlation(refined.T_query_ref, reference.strong, query),
        }
        info |= {"rival_inliers": rival, **evidence}
        confidence = None if self.calibration is None else self.calibration.confidence(evidence)
        return TrackResult(refined.T_query_ref, confidence=confidence, info=info)


def sampled_matches(matches: Matches2D3D, inliers: Indices) -> list[list[float]]:
    """Some matches as ``info["shown_matches"]`` has them, so that pages can draw them: evenly chosen, inliers first.

    Each is ``[u, v of the keyframe, u, v of the query, 1 for an inlier, else 0]``, in tenths of pixels.
    """
    if matches.reference_pixels is None:
        return []
    others = np.setdiff1d(np.arange(len(matches)), inliers)
    out = []
    for index, most, agrees in ((np.sort(inliers), SHOWN_INLIERS, 1), (others, SHOWN_OTHERS, 0)):
        some = index[np.linspace(0, len(index) - 1, min(most, len(index))).round().astype(np.int64)]
        both = np.hstack([matches.reference_pixels[some], matches.pixels[some]]).round(1)
        out += [[*pixels, agrees] for pixels in both.tolist()]
    return out


def _correlation(T_query_ref: Array, strong: StrongPixels, query: Query) -> float:
    """The mean of the correlation of both images, at half their size, around pixels of large gradient."""
    half = GreyImage.half_of(query.image, query.camera)
    found = correlations(T_query_ref, strong.uv, strong.depth, strong.half, half)
    return float(np.mean(found)) if len(found) else 0.0


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
