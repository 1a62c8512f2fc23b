"""A first guess of the pose from the features themselves: where the query shows the reference's points, then PnP.

Direct alignment only finds what lies within a few pixels of its coarsest level. LM-Reloc (von Stumberg et al., 3DV
2020) trains a second network on the correlation of coarse features for the first guess; here the features that are
aligned are matched, and the matches go through robust PnP. Nothing is trained for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.alignment import FeaturePyramid
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose
from baselines.gn_net.correspondence import Landmarks, match_landmarks
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, apply

Array = NDArray[np.float64]

SMALLEST_SAMPLE = 4
"""matches that one pose follows from, and no other"""


@dataclass(frozen=True)
class StartSettings:
    """How the first guess is searched for.

    Raises:
        ConfigError: a number that makes no sense.
    """

    points: int = 400
    """at most so many of the reference's are matched"""
    level: int = 2
    """of the feature maps, counted from the finest, on which the whole query is searched"""
    windows: tuple[int, ...] = (3, 2)
    """half-widths of the windows on the levels below, coarser first, pixels of the level"""
    threshold: float = 2.0
    """pixels of the finest map; what RANSAC, and the confidence of an answer, hold for agreement"""
    iterations: int = 2000
    """of RANSAC, at most"""
    confidence: float = 0.999
    """at which RANSAC stops earlier"""

    def __post_init__(self) -> None:
        if self.level < 0 or min(self.points, self.iterations) < SMALLEST_SAMPLE or self.threshold <= 0:
            raise ConfigError("a start from matches needs level >= 0, four points and iterations, threshold > 0")
        if any(half_width < 1 for half_width in self.windows):
            raise ConfigError(f"windows of a start from matches are {self.windows}, expected half-widths of 1 or more")
        if not 0 < self.confidence < 1:
            raise ConfigError(f"confidence of RANSAC is {self.confidence}, expected between 0 and 1")


@dataclass(frozen=True, eq=False)
class SeenLandmarks:
    """Where a query shows a reference's landmarks."""

    matches: Matches2D3D
    """of those that were found; pixels of the query's finest map; nearest features first"""
    sought: int
    """landmarks of the reference"""
    camera: Camera
    """of the query's finest map"""
    settings: StartSettings
    """they were looked for with"""

    def pose(self, seed: int) -> Array | None:
        """T_query_ref (4, 4) that agrees best with them; None where there is none. ``seed`` is RANSAC's."""
        return ransac_pose(
            self.matches,
            self.camera,
            self.settings.threshold,
            self.settings.iterations,
            self.settings.confidence,
            seed,
            best_first=True,
        )

    def agreement(self, T_query_ref: Array) -> float:
        """Share of all landmarks sought that are seen within the threshold of where a pose puts them.

        It compares between references. Residuals do not: a wrong pose can bring all points into view, where their
        features are much alike.
        """
        if not self.sought:
            return 0.0
        put, _ = self.camera.project(apply(T_query_ref, self.matches.points))
        agree = np.linalg.norm(put - self.matches.pixels, axis=1) <= self.settings.threshold
        return float(np.count_nonzero(agree) / self.sought)


def find_landmarks(landmarks: Landmarks, query: FeaturePyramid, settings: StartSettings) -> SeenLandmarks:
    """Look for landmarks in the query's maps, level by level.

    Fewer landmarks than a pose follows from are not looked for.
    """
    rows, pixels = np.zeros(0, dtype=np.intp), np.zeros((0, 2))
    if len(landmarks) >= SMALLEST_SAMPLE:
        rows, pixels = match_landmarks(landmarks, query, min(settings.level, len(query) - 1), settings.windows)
    points = landmarks.points[rows]
    matches = Matches2D3D(points, pixels, np.ones(len(points)), np.zeros_like(points))
    return SeenLandmarks(matches, len(landmarks), query.levels[0].camera, settings)
