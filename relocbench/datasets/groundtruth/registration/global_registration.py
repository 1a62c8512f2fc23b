"""Global registration: guesses of the relative pose of two submaps without a prediction; any of them may be wrong.

FPFH features (Rusu, Blodow and Beetz, ICRA 2009) of thinned structure are matched by RANSAC with fixed seeds, by fast
global registration (Zhou, Park and Koltun, ECCV 2016), or by KISS-Matcher. On streets the results are often turned by
180 degrees or shifted along periodic facades, so that alternatives of each are tried too, and verification chooses.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.icp.backends import open3d_cloud
from relocbench.datasets.groundtruth.registration.ransac import most_agreed
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.errors import ConfigError
from relocbench.geometry import invert, rotation_angle

Matcher = Literal["ransac", "fgr", "kiss-matcher"]

_MOST_AGREE = 0.5
"""if more than this share of the matches agree, RANSAC ends"""
SAME_M, SAME_DEG = 1.0, 4.0
"""poses that differ by no more than this count as one"""


@dataclass(frozen=True)
class GlobalOptions:
    """Options of global registration."""

    matcher: Matcher = "ransac"
    voxel_m: float = 0.7
    iterations: int = 30_000
    """number of RANSAC's iterations, unless most matches agree before"""
    seeds: tuple[int, ...] = (0, 1, 2)
    """seeds; the matcher runs once for each"""
    coarser_m: tuple[float, ...] = (1.0, 1.4)
    """voxel sizes of further searches, each tried if no guess held so far: sparse scans need larger ones"""
    coarser_runs: int = 10
    """number of seeds of each further search"""

    def attempts(self) -> tuple[GlobalOptions, ...]:
        """The options of this search and of the further ones that follow if it fails."""
        first = self.seeds[0] if self.seeds else 0
        seeds = tuple(range(first, first + self.coarser_runs))
        return (self, *(replace(self, voxel_m=voxel_m, seeds=seeds) for voxel_m in self.coarser_m))


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior knowledge of the pose of the query's node relative to the reference's; it is used as a hard limit."""

    T_ref_query: Array
    """(4, 4)"""
    sigma_m: float
    """standard deviation of the position on each axis"""
    sigma_heading_deg: float = 180.0
    """standard deviation of the rotation; from 60 on every rotation is allowed"""

    def allows(self, T_ref_query: Array) -> bool:
        """Whether a pose is within three standard deviations in position and in rotation."""
        away = float(np.linalg.norm(T_ref_query[:3, 3] - self.T_ref_query[:3, 3]))
        turned = float(np.degrees(rotation_angle(self.T_ref_query[:3, :3].T @ T_ref_query[:3, :3])))
        return away <= 3 * self.sigma_m and turned <= max(3 * self.sigma_heading_deg, 1e-6)


@dataclass(frozen=True, eq=False)
class Features:
    """Thinned points of a submap with their feature descriptors."""

    points: Array
    """(N, 3)"""
    normals: Array
    """(N, 3)"""
    descriptors: Array
    """(33, N) FPFH descriptors"""


def describe(submap: Submap, options: GlobalOptions | None = None) -> Features:
    """Features of a submap's static structure; of all points with a normal if there is hardly any structure."""
    import open3d as o3d

    o = options or GlobalOptions()
    flat = np.einsum("ni,ni->n", submap.normals, submap.normals) > 0.5
    chosen = flat & (submap.surface == Surface.STRUCTURE) & (submap.steady >= 0.5)
    if np.count_nonzero(chosen) < 0.1 * np.count_nonzero(flat):
        chosen = flat
    points, normals = submap.points[chosen].astype(np.float64), submap.normals[chosen].astype(np.float64)
    if not len(points):
        return Features(points, normals, np.zeros((33, 0)))
    keep = first_in_voxels(points, o.voxel_m)
    cloud = open3d_cloud(points[keep], normals[keep])
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * o.voxel_m, max_nn=100)
    # Open3D's stubs require indices, which have a default.
    feature = o3d.pipelines.registration.compute_fpfh_feature(cloud, search)  # type: ignore[call-arg]
    return Features(points[keep], normals[keep], np.asarray(feature.data))


def guesses(
    ref: Features, query: Features, prior: Prior | None = None, options: GlobalOptions | None = None
) -> list[Array]:
    """Distinct guesses of ``T_ref_query`` that the prior allows, the same every time; all may be wrong.

    Raises:
        ConfigError: the matcher's package is not installed.
    """
    o = options or GlobalOptions()
    if min(len(ref.points), len(query.points)) < 10:
        return []
    if o.matcher == "kiss-matcher":
        results = [_kiss_matcher(ref, query, o)]
    elif o.matcher == "fgr":
        results = [_fgr(ref, query, o, seed) for seed in o.seeds]
    else:
        matches = _matches(ref, query)
        results = [_ransac(ref, query, matches, o, seed) for seed in o.seeds if len(matches)]
    allowed = [T for T in results if T is not None and (prior is None or prior.allows(T))]
    return [allowed[k] for k in distinct(allowed)]


def pose_difference(T_a: Array, T_b: Array) -> tuple[float, float]:
    """Metres and degrees between two poses (4, 4) in the same frame."""
    apart = invert(T_a) @ T_b
    return float(np.linalg.norm(apart[:3, 3])), float(np.degrees(rotation_angle(apart[:3, :3])))


def distinct(poses: Sequence[Array], same_m: float = SAME_M) -> list[int]:
    """Rows of poses, each of which differs by more than ``same_m`` or 4 degrees from those chosen before it."""
    kept: list[int] = []
    for row, T in enumerate(poses):
        differences = (pose_difference(poses[k], T) for k in kept)
        if all(metres > same_m or degrees > SAME_DEG for metres, degrees in differences):
            kept.append(row)
    return kept


def _feature(descriptors: Array) -> Any:
    import open3d as o3d

    feature = o3d.pipelines.registration.Feature()
    feature.data = descriptors
    return feature


def _ransac(ref: Features, query: Features, matches: Indices, options: GlobalOptions, seed: int) -> Array | None:
    """The pose that most matches (M, 2), rows of the query's and of the reference's points, agree with."""
    draws = np.random.default_rng(seed).integers(0, len(matches), (options.iterations, 3))
    of_query, of_ref = (
        (side.points[rows], side.normals[rows]) for side, rows in zip((query, ref), matches.T, strict=True)
    )
    T, count = most_agreed(*of_query, *of_ref, 1.5 * options.voxel_m, draws, int(_MOST_AGREE * len(matches)) + 1)
    return T if count >= 3 else None


def _matches(ref: Features, query: Features) -> Indices:
    """(M, 2) rows of points of the query and of the reference that are nearest to each other by their descriptors; if
    these are few, the reference's nearest of each point of the query."""
    import open3d as o3d

    # Open3D prints a warning to standard output if few features match.
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        found = o3d.pipelines.registration.correspondences_from_features(
            _feature(query.descriptors), _feature(ref.descriptors), True
        )
    return np.asarray(found, dtype=np.int64).reshape(-1, 2)


def _fgr(ref: Features, query: Features, options: GlobalOptions, seed: int) -> Array | None:
    import open3d as o3d

    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    result = registration.registration_fgr_based_on_feature_matching(
        open3d_cloud(query.points, query.normals),
        open3d_cloud(ref.points, ref.normals),
        _feature(query.descriptors),
        _feature(ref.descriptors),
        registration.FastGlobalRegistrationOption(decrease_mu=True, maximum_correspondence_distance=options.voxel_m),
    )
    T = np.asarray(result.transformation, dtype=np.float64)
    return T if np.isfinite(T).all() and not np.array_equal(T, np.eye(4)) else None


def _kiss_matcher(ref: Features, query: Features, options: GlobalOptions) -> Array | None:
    try:
        kiss_matcher = importlib.import_module("kiss_matcher")
    except ImportError:
        raise ConfigError(
            "matcher 'kiss-matcher' needs the package kiss-matcher: "
            "pip install 'relocbench[registration]', or use 'ransac'"
        ) from None
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(options.voxel_m))
    solution = matcher.estimate(list(query.points.astype(np.float32)), list(ref.points.astype(np.float32)))
    if not solution.valid:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.asarray(solution.rotation), np.asarray(solution.translation).ravel()
    return T
