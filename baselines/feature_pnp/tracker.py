"""One pipeline for any features, and the two trackers with ORB and with SIFT."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from baselines.calibration import ORB_PNP, SIFT_PNP, Calibration
from baselines.correlation import GreyImage, correlations, strong_pixels
from baselines.feature_pnp.features import FeatureKind, Features, Indices, detect, match, spread_evenly
from baselines.feature_pnp.keyframe_depth import inverse_depth_at
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose, refine_pose, rival_inliers
from relocbench.tracking import Array, Query, Reference, TrackResult

_SMALLEST_SIGMA = 0.03  # metres; a smaller standard deviation says no more about errors of 0.25 m
_MINIMAL = 4  # three points leave up to four solutions, a fourth one decides


@dataclass(frozen=True, eq=False)
class PreparedReference:
    """The features of a keyframe that have a depth, and their points."""

    features: Features
    points: Array
    """(N, 3) metres, reference camera frame"""
    depth_direction: Array
    """(N, 3) metres; the displacement of the point by one standard deviation of its depth"""
    half: GreyImage
    """the image at half its size"""
    strong_uv: Array
    """(M, 2) pixels of large gradient of ``half`` that have a depth"""
    strong_depth: Array
    """(M,) their depths, metres"""


class FeaturePnp(ABC):
    """Keypoints, matching, MAGSAC perspective-n-point, robust refinement.

    Subclasses detect and match. The confidence is the probability that the answer is within 0.25 m and 2 degrees, from
    a calibration of the answer's lead, the logarithm of its inliers over those of the best other pose, of its
    precision, the negative logarithm of the translation's standard deviation in metres, and of the correlation of
    keyframe and query around pixels of large gradient.

    Args:
        features: largest number of keypoints in each image.
        grid_px: side, in pixels, of the grid cells over which keypoints are distributed evenly.
        depth_radius_px: largest distance, in pixels, from a keypoint to points of a sparse map that give its depth; by
            default it follows the density of the map.
        reprojection_threshold_px: largest error, in query pixels, of an inlier on the finest pyramid level.
        min_inliers: with fewer inliers, tracking fails.
        max_iterations: largest number of minimal samples.
        confidence: the probability of success at which sampling stops early.
        seed: of the sampling.
    """

    calibration: ClassVar[Calibration | None]
    """None: answers have no confidence"""

    def __init__(
        self,
        *,
        features: int,
        grid_px: int,
        depth_radius_px: float | None,
        reprojection_threshold_px: float,
        min_inliers: int,
        max_iterations: int,
        confidence: float,
        seed: int,
    ) -> None:
        self.features = features
        self.grid_px = grid_px
        self.depth_radius_px = depth_radius_px
        self.reprojection_threshold_px = reprojection_threshold_px
        self.min_inliers = min_inliers
        self.max_iterations = max_iterations
        self.confidence = confidence
        self.seed = seed

    @abstractmethod
    def detect(self, image: NDArray[np.uint8]) -> Features:
        """The features of an image, strongest first; more than ``features`` are thinned out evenly."""

    @abstractmethod
    def match_features(self, reference: Features, query: Features) -> Indices:
        """Matches (M, 2), indices into both; each feature of the query occurs at most once."""

    def prepare(self, reference: Reference) -> PreparedReference:
        """Detect the features of a keyframe, and lift those whose depth is known to points of its frame."""
        found = self.detect(reference.image)
        inverse_depth, sigma = inverse_depth_at(reference, found.uv, self.depth_radius_px)
        rays, valid = reference.camera.unproject(found.uv)
        # Depth is along z, so that rays parallel to the image or backwards have none.
        has_point = np.flatnonzero(valid & (inverse_depth > 0) & (rays[:, 2] > 0))
        kept = has_point[spread_evenly(found.take(has_point), self.grid_px, self.features)]
        inverse_depth, sigma, rays = inverse_depth[kept], sigma[kept], rays[kept]
        points = rays / inverse_depth[:, None]
        # z = 1/rho, and therefore |dz| = z sigma_rho / rho.
        depth_direction = points * (sigma / inverse_depth)[:, None]
        half = GreyImage.half_of(reference.image, reference.camera)
        strong = strong_pixels(half)
        strong_inverse_depth, _ = inverse_depth_at(reference, 2 * strong + 0.5, self.depth_radius_px)
        known = strong_inverse_depth > 0
        return PreparedReference(
            found.take(kept), points, depth_direction, half, strong[known], 1.0 / strong_inverse_depth[known]
        )

    def track(self, reference: PreparedReference, query: Query, prior: Array | None = None) -> TrackResult:
        """Find the pose of a query; the prior is not used."""
        matches = self._match(reference, query)
        if len(matches) < max(_MINIMAL, self.min_inliers):
            return TrackResult.failure(
                f"{len(matches)} matches, {max(_MINIMAL, self.min_inliers)} needed", matches=len(matches)
            )
        threshold = self.reprojection_threshold_px
        start = ransac_pose(matches, query.camera, threshold, self.max_iterations, self.confidence, self.seed)
        if start is None:
            return TrackResult.failure("no pose agrees with the matches", matches=len(matches))
        refined = refine_pose(start, matches, query.camera, threshold)
        inliers = len(refined.inliers)
        translation_sigma, rotation_sigma = refined.sigmas
        info = {
            "matches": len(matches),
            "inliers": inliers,
            "reprojection_rms_px": _finite_or_none(refined.rms_px),
            "translation_sigma_m": _finite_or_none(translation_sigma),
            "rotation_sigma_deg": _finite_or_none(float(np.rad2deg(rotation_sigma))),
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
            "correlation": _correlation(refined.T_query_ref, reference, query),
        }
        info |= {"rival_inliers": rival, **evidence}
        confidence = None if self.calibration is None else self.calibration.confidence(evidence)
        return TrackResult(refined.T_query_ref, confidence=confidence, info=info)

    def _match(self, reference: PreparedReference, query: Query) -> Matches2D3D:
        found = self.detect(query.image)
        found = found.take(spread_evenly(found, self.grid_px, self.features))
        pairs = self.match_features(reference.features, found)
        of_reference, of_query = pairs[:, 0], pairs[:, 1]
        return Matches2D3D(
            points=reference.points[of_reference],
            pixels=found.uv[of_query],
            scale=np.maximum(reference.features.scale[of_reference], found.scale[of_query]),
            depth_direction=reference.depth_direction[of_reference],
        )


def _correlation(T_query_ref: Array, reference: PreparedReference, query: Query) -> float:
    """The mean of the correlation of both images, at half their size, around pixels of large gradient."""
    half = GreyImage.half_of(query.image, query.camera)
    found = correlations(T_query_ref, reference.strong_uv, reference.strong_depth, reference.half, half)
    return float(np.mean(found)) if len(found) else 0.0


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


class RatioTestPnp(FeaturePnp):
    """A :class:`FeaturePnp` that accepts matches by Lowe's ratio test.

    Args:
        features: largest number of keypoints in each image.
        ratio: of Lowe's test; a match is accepted below this ratio of the nearest to the second nearest distance.
        mutual: accept only mutual nearest neighbours.
        grid_px: side, in pixels, of the grid cells over which keypoints are distributed evenly.
        depth_radius_px: largest distance, in pixels, from a keypoint to points of a sparse map that give its depth; by
            default it follows the density of the map.
        reprojection_threshold_px: largest error, in query pixels, of an inlier on the finest pyramid level.
        min_inliers: with fewer inliers, tracking fails.
        max_iterations: largest number of minimal samples.
        confidence: the probability of success at which sampling stops early.
        seed: of the sampling.
    """

    kind: ClassVar[FeatureKind]

    def __init__(
        self,
        *,
        features: Annotated[int, Field(ge=4, le=20000)] = 3000,
        ratio: Annotated[float, Field(gt=0, le=1)] = 0.8,
        mutual: bool = True,
        grid_px: Annotated[int, Field(ge=4)] = 32,
        depth_radius_px: Annotated[float, Field(ge=0)] | None = None,
        reprojection_threshold_px: Annotated[float, Field(gt=0)] = 2.0,
        min_inliers: Annotated[int, Field(ge=4)] = 10,
        max_iterations: Annotated[int, Field(ge=1)] = 10000,
        confidence: Annotated[float, Field(gt=0, lt=1)] = 0.9999,
        seed: Annotated[int, Field(ge=0)] = 0,
    ) -> None:
        super().__init__(
            features=features,
            grid_px=grid_px,
            depth_radius_px=depth_radius_px,
            reprojection_threshold_px=reprojection_threshold_px,
            min_inliers=min_inliers,
            max_iterations=max_iterations,
            confidence=confidence,
            seed=seed,
        )
        self.ratio = ratio
        self.mutual = mutual

    def detect(self, image: NDArray[np.uint8]) -> Features:
        return detect(image, self.kind, self.features)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return match(reference, query, self.ratio, self.mutual)


class OrbPnp(RatioTestPnp):
    """ORB (Rublee et al., ICCV 2011) with PnP; see :class:`RatioTestPnp` for the parameters."""

    kind: ClassVar[FeatureKind] = "orb"
    calibration: ClassVar[Calibration | None] = ORB_PNP


class SiftPnp(RatioTestPnp):
    """SIFT (Lowe, IJCV 2004) with PnP; see :class:`RatioTestPnp` for the parameters."""

    kind: ClassVar[FeatureKind] = "sift"
    calibration: ClassVar[Calibration | None] = SIFT_PNP
