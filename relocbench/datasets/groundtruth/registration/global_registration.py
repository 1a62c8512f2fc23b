"""Registration without a prediction: several distinct guesses, none of them trusted.

FPFH features (Rusu, Blodow and Beetz, ICRA 2009) matched by RANSAC with fixed seeds, or by fast global registration
(Zhou, Park and Koltun, ECCV 2016), on thinned structure. Such answers are often wrong on streets: turned by 180
degrees, or slid along periodic facades. So the alternatives of each are made on purpose, and verification chooses.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.errors import ConfigError
from relocbench.geometry import invert, rotation_angle

Array = NDArray[np.float64]
Matcher = Literal["ransac", "fgr", "kiss-matcher"]


@dataclass(frozen=True)
class GlobalOptions:
    """Options of the search for first guesses."""

    matcher: Matcher = "ransac"
    voxel_m: float = 0.7
    iterations: int = 30_000
    """of RANSAC, always all of them"""
    seeds: tuple[int, ...] = (0, 1, 2)
    """one run each"""
    same_m: float = 1.0
    """guesses that lie nearer to each other, and"""
    same_deg: float = 4.0
    """turn by less, are one"""
    coarser_m: tuple[float, ...] = (1.0, 1.4)
    """voxels that are tried in turn where nothing holds of what was found before: sparse scans show too little in the
    fine ones"""
    coarser_runs: int = 10
    """of each of these"""

    def attempts(self) -> tuple[GlobalOptions, ...]:
        """This search, and those that follow where it fails."""
        first = self.seeds[0] if self.seeds else 0
        seeds = tuple(range(first, first + self.coarser_runs))
        return (self, *(replace(self, voxel_m=voxel_m, seeds=seeds) for voxel_m in self.coarser_m))


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known beforehand of where the query's node is, seen from the reference's; limits are hard."""

    T_ref_query: Array
    """(4, 4)"""
    sigma_m: float
    """standard deviation of the position, each axis"""
    sigma_heading_deg: float = 180.0
    """standard deviation of the turn; 60 and more says nothing"""

    def allows(self, T_ref_query: Array) -> bool:
        """Within three standard deviations of position and of turn."""
        away = float(np.linalg.norm(T_ref_query[:3, 3] - self.T_ref_query[:3, 3]))
        turned = float(np.degrees(rotation_angle(self.T_ref_query[:3, :3].T @ T_ref_query[:3, :3])))
        return away <= 3 * self.sigma_m and turned <= max(3 * self.sigma_heading_deg, 1e-6)


@dataclass(frozen=True, eq=False)
class Features:
    """Thinned structure of a submap with its descriptors."""

    points: Array
    """(N, 3)"""
    normals: Array
    """(N, 3)"""
    descriptors: Array
    """(33, N) FPFH"""


def describe(submap: Submap, options: GlobalOptions | None = None) -> Features:
    """Features of the structure of a submap; of everything with a normal where there is hardly any structure."""
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
    cloud = _cloud(points[keep], normals[keep])
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * o.voxel_m, max_nn=100)
    # The stubs ask for indices, which have a default.
    feature = o3d.pipelines.registration.compute_fpfh_feature(cloud, search)  # type: ignore[call-arg]
    return Features(points[keep], normals[keep], np.asarray(feature.data))


def guesses(
    ref: Features, query: Features, prior: Prior | None = None, options: GlobalOptions | None = None
) -> list[Array]:
    """Distinct ``T_ref_query`` that the prior allows; none may be right. The same every time.

    Raises:
        ConfigError: the matcher is not installed.
    """
    o = options or GlobalOptions()
    if min(len(ref.points), len(query.points)) < 10:
        return []
    if o.matcher == "kiss-matcher":
        found = [_kiss_matcher(ref, query, o)]
    elif o.matcher == "fgr":
        found = [_fgr(ref, query, o, seed) for seed in o.seeds]
    else:
        found = [_ransac(ref, query, o, seed) for seed in o.seeds]
    return distinct([T for T in found if T is not None and (prior is None or prior.allows(T))], o.same_m, o.same_deg)


def distinct(transforms: Sequence[Array], same_m: float, same_deg: float) -> list[Array]:
    """The first of each group of transforms that hardly differ."""
    kept: list[Array] = []
    for T in transforms:
        apart = (invert(k) @ T for k in kept)
        if all(np.linalg.norm(d[:3, 3]) > same_m or np.degrees(rotation_angle(d[:3, :3])) > same_deg for d in apart):
            kept.append(T)
    return kept


def _cloud(points: Array, normals: Array) -> Any:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


def _feature(descriptors: Array) -> Any:
    import open3d as o3d

    feature = o3d.pipelines.registration.Feature()
    feature.data = descriptors
    return feature


def _ransac(ref: Features, query: Features, options: GlobalOptions, seed: int) -> Array | None:
    import open3d as o3d

    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    near = 1.5 * options.voxel_m
    result = registration.registration_ransac_based_on_feature_matching(
        _cloud(query.points, query.normals),
        _cloud(ref.points, ref.normals),
        _feature(query.descriptors),
        _feature(ref.descriptors),
        True,
        near,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnNormal(np.radians(30.0)),
            registration.CorrespondenceCheckerBasedOnDistance(near),
        ],
        # A confidence of 1 never stops early.
        registration.RANSACConvergenceCriteria(options.iterations, 1.0),
    )
    return np.asarray(result.transformation, dtype=np.float64) if len(result.correspondence_set) >= 3 else None


def _fgr(ref: Features, query: Features, options: GlobalOptions, seed: int) -> Array | None:
    import open3d as o3d

    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    result = registration.registration_fgr_based_on_feature_matching(
        _cloud(query.points, query.normals),
        _cloud(ref.points, ref.normals),
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
            "the matcher 'kiss-matcher' needs the package kiss-matcher: pip install 'relocbench[registration]', or use "
            "ransac"
        ) from None
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(options.voxel_m))
    solution = matcher.estimate(list(query.points.astype(np.float32)), list(ref.points.astype(np.float32)))
    if not solution.valid:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.asarray(solution.rotation), np.asarray(solution.translation).ravel()
    return T
