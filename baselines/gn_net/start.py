"""The initial pose of an alignment from matches of the features that are aligned, by PnP.

Direct alignment converges only from within a few pixels of its coarsest level. LM-Reloc (von Stumberg et al., 3DV 2020)
trains a second network on the correlation of coarse features for the initial pose. Here the features that are aligned
are matched and the pose is found by robust PnP, which needs no training of its own, with PoseLib (Larsson et al.,
https://github.com/PoseLib/PoseLib): P3P in LO-RANSAC, then refinement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import poselib

from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.gn_net.correspondence import Landmarks, match_landmarks
from relocbench.arrays import Array
from relocbench.geometry import Camera, apply

SMALLEST_SAMPLE = 4
"""the number of matches that determine a pose uniquely"""


@dataclass(frozen=True)
class StartSettings:
    """How the initial pose is searched for."""

    points: int = 1200
    """largest number of the reference's points that are matched"""
    level: int = 2
    """the level, counted from the finest feature map, on which the whole query is searched"""
    windows: tuple[int, ...] = (3, 2)
    """half-widths, in pixels of the level, of the windows on the finer levels, coarser ones first"""
    threshold: float = 2.0
    """pixels of the finest map; the inlier threshold of RANSAC and of an answer's agreement"""
    iterations: int = 1000
    """largest number of RANSAC iterations"""
    fewest_iterations: int = 50
    """however early the pose seems certain"""
    confidence: float = 0.999
    """the probability of success at which RANSAC stops early"""


@dataclass(frozen=True, eq=False)
class MatchedLandmarks:
    """The landmarks of a reference that were matched in a query."""

    points: Array
    """(M, 3) metres, reference camera; nearest features first"""
    pixels: Array
    """(M, 2) of the query's finest map"""
    sought: int
    """number of landmarks of the reference"""
    camera: Camera
    """of the query's finest map"""
    settings: StartSettings
    """that they were matched with"""

    def __len__(self) -> int:
        return len(self.points)

    def pose(self, seed: int, best_first: bool = False) -> Array | None:
        """The T_query_ref (4, 4) that RANSAC with this seed finds; None if it finds none.

        Args:
            seed: of the samples.
            best_first: draw early samples among the nearest features (PROSAC: Chum and Matas, CVPR 2005).
        """
        if len(self) < SMALLEST_SAMPLE:
            return None
        camera = self.camera
        pinhole = {"model": "PINHOLE", "width": camera.width, "height": camera.height}
        found, result = poselib.estimate_absolute_pose(
            self.pixels,
            self.points,
            {**pinhole, "params": [camera.fx, camera.fy, camera.cx, camera.cy]},
            {
                "max_reproj_error": self.settings.threshold,
                "max_iterations": self.settings.iterations,
                "min_iterations": self.settings.fewest_iterations,
                "success_prob": self.settings.confidence,
                "progressive_sampling": best_first,
                "seed": seed % 2**64,
            },
        )
        pose = np.vstack([np.asarray(found.Rt), [0.0, 0.0, 0.0, 1.0]])
        return pose if result["num_inliers"] >= SMALLEST_SAMPLE and np.all(np.isfinite(pose)) else None

    def poses(self, count: int, seed: int) -> Iterator[Array]:
        """At most ``count`` poses of :meth:`pose`, every second one from samples among the nearest features first."""
        for number in range(count):
            pose = self.pose(seed + number, best_first=number % 2 == 1)
            if pose is not None:
                yield pose

    def agreement(self, T_query_ref: Array) -> float:
        """The share of all landmarks that are matched within the threshold of where a pose projects them.

        It can be compared between references, which residuals cannot: a wrong pose may project all points onto a part
        of the query with similar features.
        """
        if not self.sought:
            return 0.0
        projected, _ = self.camera.project(apply(T_query_ref, self.points))
        agree = np.linalg.norm(projected - self.pixels, axis=1) <= self.settings.threshold
        return float(np.count_nonzero(agree) / self.sought)


def find_landmarks(landmarks: Landmarks, query: FeaturePyramid, settings: StartSettings) -> MatchedLandmarks:
    """Match landmarks in the query's maps, level by level; none if they are too few to determine a pose."""
    rows, pixels = np.zeros(0, dtype=np.intp), np.zeros((0, 2))
    if len(landmarks) >= SMALLEST_SAMPLE:
        rows, pixels = match_landmarks(landmarks, query, min(settings.level, len(query) - 1), settings.windows)
    return MatchedLandmarks(landmarks.points[rows], pixels, len(landmarks), query.levels[0].camera, settings)
