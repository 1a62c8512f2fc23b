"""One pipeline for any features, and the two trackers with ORB and with SIFT."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from baselines.calibration import ORB_PNP, SIFT_PNP, Calibration
from baselines.feature_pnp.features import FeatureKind, Features, detect, match, spread_evenly
from baselines.feature_pnp.keyframe_depth import lift
from baselines.feature_pnp.pnp import Pnp, PreparedKeyframe, StrongPixels
from baselines.feature_pnp.solve import Matches2D3D
from relocbench.arrays import Array, Image, Indices
from relocbench.tracking import Query, Reference


@dataclass(frozen=True, eq=False)
class PreparedReference(PreparedKeyframe):
    """The features of a keyframe that have a depth, and their points."""

    features: Features
    points: Array
    """(N, 3) metres, reference camera frame"""
    depth_direction: Array
    """(N, 3) metres; the displacement of the point by one standard deviation of its depth"""


@dataclass(kw_only=True, eq=False)
class FeaturePnp(Pnp[PreparedReference]):
    """Keypoints, matching, and a pose from the matches; see :class:`Pnp` for that and for the confidence.

    Subclasses detect and match.

    Args:
        features: largest number of keypoints in each image.
        grid_px: side, in pixels, of the grid cells over which keypoints are distributed evenly.
    """

    features: Annotated[int, Field(ge=4, le=20000)] = 3000
    grid_px: Annotated[int, Field(ge=4)] = 32

    @abstractmethod
    def detect(self, image: Image) -> Features:
        """The features of an image, strongest first; more than ``features`` are thinned out evenly."""

    @abstractmethod
    def match_features(self, reference: Features, query: Features) -> Indices:
        """Matches (M, 2), indices into both; each feature of the query occurs at most once."""

    def prepare(self, reference: Reference) -> PreparedReference:
        """Detect the features of a keyframe, and lift those whose depth is known to points of its frame."""
        found = self.detect(reference.image)
        lifted = lift(reference, found.uv, self.depth_radius_px)
        kept = spread_evenly(found.take(lifted.index), self.grid_px, self.features)
        return PreparedReference(
            StrongPixels.of(reference, self.depth_radius_px),
            found.take(lifted.index[kept]),
            lifted.points[kept],
            lifted.depth_direction[kept],
        )

    def correspond(self, reference: PreparedReference, query: Query) -> Matches2D3D:
        """Detect the features of a query, and match those of the keyframe with them."""
        found = self.detect(query.image)
        found = found.take(spread_evenly(found, self.grid_px, self.features))
        pairs = self.match_features(reference.features, found)
        of_reference, of_query = pairs[:, 0], pairs[:, 1]
        return Matches2D3D(
            points=reference.points[of_reference],
            pixels=found.uv[of_query],
            scale=np.maximum(reference.features.scale[of_reference], found.scale[of_query]),
            depth_direction=reference.depth_direction[of_reference],
            reference_pixels=reference.features.uv[of_reference],
        )


@dataclass(kw_only=True, eq=False)
class RatioTestPnp(FeaturePnp):
    """A :class:`FeaturePnp` that accepts matches by Lowe's ratio test.

    Args:
        ratio: of Lowe's test; a match is accepted below this ratio of the nearest to the second nearest distance.
        mutual: accept only mutual nearest neighbours.
    """

    kind: ClassVar[FeatureKind]

    ratio: Annotated[float, Field(gt=0, le=1)] = 0.8
    mutual: bool = True

    def detect(self, image: Image) -> Features:
        return detect(image, self.kind, self.features)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return match(reference, query, self.ratio, self.mutual)


class OrbPnp(RatioTestPnp):
    """ORB (Rublee et al., ICCV 2011) with PnP."""

    kind: ClassVar[FeatureKind] = "orb"
    calibration: ClassVar[Calibration | None] = ORB_PNP


class SiftPnp(RatioTestPnp):
    """SIFT (Lowe, IJCV 2004) with PnP."""

    kind: ClassVar[FeatureKind] = "sift"
    calibration: ClassVar[Calibration | None] = SIFT_PNP
