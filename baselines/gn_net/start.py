"""A first guess of the pose from the features themselves: each reference point's nearest feature in the query.

Direct alignment only finds what lies within a few pixels of its coarsest level. LM-Reloc (von Stumberg et al., 3DV
2020) trains a second network on the correlation of coarse features for the first guess; here the nearest features of a
coarse level, mutually, go through robust PnP. Nothing is trained for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.alignment import FeaturePyramid, ReferenceFeatures
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose
from relocbench.errors import ConfigError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StartSettings:
    """How the first guess is searched for.

    Raises:
        ConfigError: a number that makes no sense.
    """

    level: int = 2
    """of the feature maps, counted from the finest"""
    points: int = 600
    """at most so many of the reference's are matched"""
    threshold: float = 1.5
    """pixels of the level; what RANSAC holds for agreement"""
    iterations: int = 1000
    """of RANSAC, at most"""
    confidence: float = 0.999
    """at which RANSAC stops earlier"""

    def __post_init__(self) -> None:
        if self.level < 0 or min(self.points, self.iterations) < 4 or self.threshold <= 0:
            raise ConfigError("a start from matches needs level >= 0, four points and iterations, threshold > 0")
        if not 0 < self.confidence < 1:
            raise ConfigError(f"confidence of RANSAC is {self.confidence}, expected between 0 and 1")


def matched_pose(
    reference: ReferenceFeatures, query: FeaturePyramid, settings: StartSettings, seed: int
) -> Array | None:
    """T_query_ref (4, 4) that agrees best with mutually nearest features; None where none was found.

    Args:
        reference: points of each level with their features.
        query: maps of each level.
        settings: which level, and RANSAC's.
        seed: of the choice of points and of RANSAC.
    """
    level = min(settings.level, len(reference) - 1, len(query) - 1)
    known, seen = reference.levels[level], query.levels[level]
    rng = np.random.default_rng(seed)
    chosen = np.sort(rng.permutation(len(known))[: settings.points])
    matched, pixels = _mutually_nearest(known.values[chosen], seen.map)
    x, y, inverse_depth = known.points[:, chosen[matched]].astype(np.float64)
    points = np.stack([x, y, np.ones_like(x)], axis=1) / inverse_depth[:, None]
    matches = Matches2D3D(points, pixels, np.ones(len(points)), np.zeros_like(points))
    return ransac_pose(matches, seen.camera, settings.threshold, settings.iterations, settings.confidence, seed)


def _mutually_nearest(values: NDArray[np.float32], level_map: NDArray[np.float32]) -> tuple[NDArray[np.intp], Array]:
    """Rows of ``values`` (N, D) that are the nearest to the pixel of the map (H, W, D) nearest to them, and where.

    Returns:
        (M,) rows and (M, 2) pixels, to fractions by a parabola through the distances to the neighbouring pixels.
    """
    height, width, channels = level_map.shape
    flat = level_map.reshape(-1, channels)
    squared = np.sum(flat**2, axis=1) - 2.0 * values @ flat.T + np.sum(values**2, axis=1)[:, None]
    nearest = np.argmin(squared, axis=1)
    rows = np.arange(len(values))
    mutual = np.flatnonzero(np.argmin(squared[:, nearest], axis=0) == rows)
    v, u = np.divmod(nearest[mutual], width)
    table = squared[mutual].reshape(-1, height, width)
    at = np.arange(len(mutual))

    def off(low: NDArray[np.float32], high: NDArray[np.float32]) -> Array:
        middle = table[at, v, u]
        bend = np.asarray(low - 2.0 * middle + high, dtype=np.float64)
        slope = np.asarray(low - high, dtype=np.float64)
        return np.clip(np.divide(0.5 * slope, bend, out=np.zeros_like(bend), where=bend > 0), -0.5, 0.5)

    across = off(table[at, v, np.maximum(u - 1, 0)], table[at, v, np.minimum(u + 1, width - 1)])
    along = off(table[at, np.maximum(v - 1, 0), u], table[at, np.minimum(v + 1, height - 1), u])
    across[(u == 0) | (u == width - 1)] = 0.0
    along[(v == 0) | (v == height - 1)] = 0.0
    return mutual, np.stack([u + across, v + along], axis=1).astype(np.float64)
