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
    threshold: float = 2.5
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
        (M,) rows and (M, 2) pixels, to fractions by a parabola through the squared distances to the neighbours.
    """
    height, width, channels = level_map.shape
    flat = level_map.reshape(-1, channels)
    # -||f - g||^2 less -||f||^2, which is the same for all pixels g, as one product: 2 f g - ||g||^2.
    likeness = np.c_[2.0 * values, np.full(len(values), -1.0, np.float32)] @ np.c_[flat, np.sum(flat**2, axis=1)].T
    nearest = np.argmax(likeness, axis=1)
    own = np.sum(values**2, axis=1)[:, None]
    mutual = np.flatnonzero(np.argmax(likeness[:, nearest] - own, axis=0) == np.arange(len(values)))
    v, u = np.divmod(nearest[mutual], width)

    def peak(place: NDArray[np.intp], step: int, side: int) -> Array:
        """Offset along one side, from the likeness one pixel before, at and after the nearest one."""
        inside = (place > 0) & (place < side - 1)
        at = nearest[mutual]
        before, middle, after = (likeness[mutual, at + k * step * inside].astype(np.float64) for k in (-1, 0, 1))
        bend = 2.0 * middle - before - after
        off = np.divide(0.5 * (after - before), bend, out=np.zeros_like(bend), where=bend > 0)
        return np.asarray(np.clip(off, -0.5, 0.5), dtype=np.float64)

    return mutual, np.stack([u + peak(u, 1, width), v + peak(v, width, height)], axis=1).astype(np.float64)
