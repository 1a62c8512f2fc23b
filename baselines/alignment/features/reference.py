"""The reference of feature alignment: few points of known depth with their feature vectors, kept for all queries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.features.pyramid import FeaturePyramid, level_coordinates, sample
from baselines.alignment.shared.depth_map import KEPT_BORDER, coarse_depths
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FeaturePoints:
    """What the alignment of one level needs of the reference."""

    points: NDArray[np.float32]
    """(3, N) normalised x, y and inverse depth (1/m)"""
    values: NDArray[np.float32]
    """(N, D) the reference's features there"""
    weights: NDArray[np.float32]
    """(N,) positive; a point of weight 2 counts as two"""

    @classmethod
    def at(
        cls, uv: Array, inverse_depth: Array, values: NDArray[np.floating], camera: Camera, weights: Array | None = None
    ) -> FeaturePoints:
        """Points given with their feature vectors.

        Args:
            uv: (N, 2) pixels of the level, need not be integers.
            inverse_depth: (N,) 1/m, positive.
            values: (N, D).
            camera: of the level.
            weights: (N,) positive; all 1 by default.

        Raises:
            MethodError: shapes do not fit, or a weight is not a positive number.
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
        return self.points.shape[1]

    @cached_property
    def spread(self) -> float:
        """Robust scale of the features: median distance of a feature vector from the channels' medians.

        Vectors of unrelated points are about sqrt(2) times so far from each other. Not a number without points, or
        when features are not finite.
        """
        if not len(self):
            return float("nan")
        values = self.values.astype(np.float64)
        return float(np.median(np.linalg.norm(values - np.median(values, axis=0), axis=1)))


@dataclass(frozen=True, eq=False)
class ReferenceFeatures:
    """A prepared keyframe: points of every level, finest first. The maps themselves are no longer needed."""

    levels: tuple[FeaturePoints, ...]

    @classmethod
    def at_points(
        cls, points: KeyframePoints, pyramid: FeaturePyramid, weights: Array | None = None
    ) -> ReferenceFeatures:
        """The same points on every level, where they are to a fraction of a pixel; features are sampled bilinearly.

        Points without a positive depth are left out, and on each level those nearer than 2 px to its border.

        Args:
            points: (N) pixels of level 0 with inverse depth.
            pyramid: features of the keyframe.
            weights: (N,) positive; all 1 by default.

        Raises:
            MethodError: not as many weights as points, or one that is not a positive number.
        """
        weights = np.ones(len(points)) if weights is None else np.asarray(weights, dtype=np.float64)
        if weights.shape != (len(points),):
            raise MethodError(f"{len(points)} points need as many weights, got {weights.shape}")
        known = (points.inverse_depth > 0) & np.isfinite(points.inverse_depth)
        levels = []
        for number, level in enumerate(pyramid.levels):
            uv = level_coordinates(points.uv, number)
            last = np.array([level.camera.width, level.camera.height]) - 1 - KEPT_BORDER
            kept = known & np.all((uv >= KEPT_BORDER) & (uv <= last), axis=1)
            uv = uv[kept]
            values = sample(level.map, uv)
            levels.append(FeaturePoints.at(uv, points.inverse_depth[kept], values, level.camera, weights[kept]))
        return cls(tuple(levels))

    @classmethod
    def on_coarse_depth(cls, points: KeyframePoints, pyramid: FeaturePyramid) -> ReferenceFeatures:
        """Points carried down the pyramid and dilated, as DSO does; features are read at whole pixels.

        Many more points than given come out (each fills four empty neighbours), at depths that are averages: right
        where surfaces are smooth, wrong at their edges.
        """
        depths = coarse_depths(points, [level.camera for level in pyramid.levels])
        return cls(
            tuple(
                FeaturePoints.at(uv.astype(np.float64), inverse_depth, level.map[uv[:, 1], uv[:, 0]], level.camera)
                for (uv, inverse_depth), level in zip(depths, pyramid.levels, strict=True)
            )
        )

    @classmethod
    def of(cls, levels: Sequence[FeaturePoints]) -> ReferenceFeatures:
        """Levels made elsewhere, finest first."""
        return cls(tuple(levels))

    def __len__(self) -> int:
        return len(self.levels)
