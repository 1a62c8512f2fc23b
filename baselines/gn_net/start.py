"""The initial pose of an alignment from matches of the features that are aligned, by PnP.

Direct alignment converges only from within a few pixels of its coarsest level. LM-Reloc (von Stumberg et al., 3DV 2020)
trains a second network on the correlation of coarse features for the initial pose (``baselines.lm_reloc``). Here the
features that are aligned are matched and the pose is found by robust PnP, which needs no training of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.alignment import FeaturePyramid
from baselines.feature_pnp.solve import Matches2D3D, ransac_pose
from baselines.gn_net.correspondence import Landmarks, match_landmarks
from relocbench.arrays import Array
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, apply

SMALLEST_SAMPLE = 4
"""the number of matches that determine a pose uniquely"""


@dataclass(frozen=True)
class StartSettings:
    """How the initial pose is searched for.

    Raises:
        ConfigError: a value is out of range.
    """

    points: int = 400
    """largest number of the reference's points that are matched"""
    level: int = 2
    """the level, counted from the finest feature map, on which the whole query is searched"""
    windows: tuple[int, ...] = (3, 2)
    """half-widths, in pixels of the level, of the windows on the finer levels, coarser ones first"""
    threshold: float = 2.0
    """pixels of the finest map; the inlier threshold of RANSAC and of an answer's agreement"""
    iterations: int = 2000
    """largest number of RANSAC iterations"""
    confidence: float = 0.999
    """the probability of success at which RANSAC stops early"""

    def __post_init__(self) -> None:
        if self.level < 0 or min(self.points, self.iterations) < SMALLEST_SAMPLE or self.threshold <= 0:
            raise ConfigError("a start from matches needs level >= 0, four points and iterations, threshold > 0")
        if any(half_width < 1 for half_width in self.windows):
            raise ConfigError(f"windows of a start from matches are {self.windows}, expected half-widths of 1 or more")
        if not 0 < self.confidence < 1:
            raise ConfigError(f"confidence of RANSAC is {self.confidence}, expected between 0 and 1")


@dataclass(frozen=True, eq=False)
class MatchedLandmarks:
    """The landmarks of a reference that were matched in a query."""

    matches: Matches2D3D
    """with pixels of the query's finest map; nearest features first"""
    sought: int
    """number of landmarks of the reference"""
    camera: Camera
    """of the query's finest map"""
    settings: StartSettings
    """that they were matched with"""

    def pose(self, seed: int) -> Array | None:
        """The T_query_ref (4, 4) that RANSAC with this seed finds; None if it finds none."""
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
        """The share of all landmarks that are matched within the threshold of where a pose projects them.

        It can be compared between references, which residuals cannot: a wrong pose may project all points onto a part
        of the query with similar features.
        """
        if not self.sought:
            return 0.0
        projected, _ = self.camera.project(apply(T_query_ref, self.matches.points))
        agree = np.linalg.norm(projected - self.matches.pixels, axis=1) <= self.settings.threshold
        return float(np.count_nonzero(agree) / self.sought)


def find_landmarks(landmarks: Landmarks, query: FeaturePyramid, settings: StartSettings) -> MatchedLandmarks:
    """Match landmarks in the query's maps, level by level; none if they are too few to determine a pose."""
    rows, pixels = np.zeros(0, dtype=np.intp), np.zeros((0, 2))
    if len(landmarks) >= SMALLEST_SAMPLE:
        rows, pixels = match_landmarks(landmarks, query, min(settings.level, len(query) - 1), settings.windows)
    points = landmarks.points[rows]
    matches = Matches2D3D(points, pixels, np.ones(len(points)), np.zeros_like(points))
    return MatchedLandmarks(matches, len(landmarks), query.levels[0].camera, settings)
