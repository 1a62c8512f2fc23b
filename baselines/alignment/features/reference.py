"""The reference of feature alignment: points of known depth with their feature vectors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.features.pyramid import FeaturePyramid, level_coordinates, sample
from baselines.alignment.shared.depth_map import KEPT_BORDER
from relocbench.arrays import Array, Floats
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

FULL_LEVELS = 2
"""the finest levels, on which all points are used"""


@dataclass(frozen=True, eq=False)
class FeaturePoints:
    """The points of one level of the reference."""

    points: Floats
    """(3, N) normalised x, y and inverse depth (1/m)"""
    values: Floats
    """(N, D) features of the reference at the points"""
    weights: Floats
    """(N,) positive; a point of weight 2 counts as two"""

    @classmethod
    def at(
        cls,
        uv: Array,
        inverse_depth: Array,
        values: NDArray[np.floating],
        camera: Camera,
        weights: NDArray[np.floating] | None = None,
    ) -> FeaturePoints:
        """Points at given pixels with given feature vectors.

        Args:
            uv: (N, 2) pixels of the level, which need not be integers.
            inverse_depth: (N,) 1/m, positive.
            values: (N, D) feature vectors.
            camera: of the level.
            weights: (N,) positive; 1 by default.

        Raises:
            MethodError: the shapes disagree, or a weight is not a positive number.
        """
        n = len(uv)
        weights = np.ones(n) if weights is None else np.asarray(weights, dtype=np.float64)
        if uv.shape != (n, 2) or inverse_depth.shape != (n,) or values.shape[:1] != (n,) or values.ndim != 2:
            raise MethodError(
                "reference points need uv (N, 2), inverse depth (N,) and values (N, D); "
                f"got {uv.shape}, {inverse_depth.shape}, {values.shape}"
            )
        if weights.shape != (n,) or not np.all((weights > 0) & np.isfinite(weights)):
            raise MethodError(f"{n} reference points need as many weights, all positive numbers")
        x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
        return cls(
            points=np.ascontiguousarray(np.stack([x, y, inverse_depth]), dtype=np.float32),
            values=np.ascontiguousarray(values, dtype=np.float32),
            weights=np.ascontiguousarray(weights, dtype=np.float32),
        )

    def __len__(self) -> int:
        return int(self.points.shape[1])

    @cached_property
    def median_depth(self) -> float:
        """Metres along z; 0 without any point."""
        return 1.0 / float(np.median(self.points[2])) if len(self) else 0.0

    @cached_property
    def spread(self) -> float:
        """A robust scale of the features: the median distance of a feature vector from the channels' medians.

        Feature vectors of unrelated points are about sqrt(2) times as far from each other. NaN if there are no points
        or a feature is not finite.
        """
        if not len(self):
            return float("nan")
        values = self.values.astype(np.float64)
        return float(np.median(np.linalg.norm(values - np.median(values, axis=0), axis=1)))


@dataclass(frozen=True, eq=False)
class ReferenceFeatures:
    """A prepared keyframe: its points on every level, finest first. The maps themselves are not kept."""

    levels: tuple[FeaturePoints, ...]

    @classmethod
    def at_points(
        cls, points: KeyframePoints, pyramid: FeaturePyramid, coarse_points: int | None = None
    ) -> ReferenceFeatures:
        """The same points on every level, at fractions of a pixel, with features interpolated bilinearly.

        Points without a positive depth are left out, and so are, on each level, points within 2 px of its border.

        Args:
            points: N pixels of level 0 with inverse depth.
            pyramid: of the keyframe. Where it has confidences, they are the weights.
            coarse_points: at most so many, evenly spread in their order, on all levels but the two finest, whose maps
                have fewer pixels than there are points; all by default.

        Raises:
            MethodError: a confidence is not a positive number.
        """
        known = (points.inverse_depth > 0) & np.isfinite(points.inverse_depth)
        levels = []
        for number, level in enumerate(pyramid.levels):
            uv = level_coordinates(points.uv, number)
            last = np.array([level.camera.width, level.camera.height]) - 1 - KEPT_BORDER
            kept = known & np.all((uv >= KEPT_BORDER) & (uv <= last), axis=1)
            rows = np.flatnonzero(kept)
            if coarse_points is not None and number >= FULL_LEVELS and len(rows) > coarse_points:
                rows = rows[np.linspace(0, len(rows) - 1, coarse_points).round().astype(int)]
            uv = uv[rows]
            weights = None if level.confidence is None else sample(level.confidence, uv)[:, 0]
            levels.append(
                FeaturePoints.at(uv, points.inverse_depth[rows], sample(level.map, uv), level.camera, weights)
            )
        return cls(tuple(levels))

    def __len__(self) -> int:
        return len(self.levels)
