"""Registration of single pairs for ``ground_truth.py``, without neighbours and without verification.

``open3d_pairs`` is the usual recipe with Open3D, computed anew for each pair: both clouds are downsampled to 0.5 m,
with normals and FPFH features, for RANSAC with 100 000 iterations, and to 0.1 m, with normals, for point-to-plane ICP.
``own_pairs`` is this package's search (three seeded runs of RANSAC) and refinement on the same submaps, of which the
best fit is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from ground_truth_work import Spent, timed
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions
from relocbench.datasets.groundtruth.blocks.deskewing import BeamReader
from relocbench.datasets.groundtruth.blocks.making import BlockOptions
from relocbench.datasets.groundtruth.blocks.nodes import arc_length_along
from relocbench.datasets.groundtruth.icp.icp import run_icp
from relocbench.datasets.groundtruth.registration.global_registration import describe, guesses
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AloneUnit:
    """Node pairs (reference, query) of two drives."""

    reference: Drive
    query: Drive
    nodes: tuple[tuple[int, int], ...]
    options: AlignmentOptions


Answers = list[tuple[Array, Spent, int]]
"""``T_ref_query`` from node to node, its cost, and the points of both submaps"""


def open3d_pairs(unit: AloneUnit) -> Answers:
    """The plain recipe; the time to assemble the raw points of the submaps is not counted."""
    out = []
    for ref, query in unit.nodes:
        clouds = [raw_submap(d, n, unit.options.submap_m) for d, n in ((unit.reference, ref), (unit.query, query))]
        T, spent = timed(lambda: open3d_pair(*clouds))  # noqa: B023
        out.append((T, spent, sum(map(len, clouds))))
    return out


def raw_submap(drive: Drive, node: int, length_m: float) -> Array:
    """All points (N, 3) measured along a stretch of road, assembled by odometry, in the node's frame."""
    nodes, options = drive.nodes, BlockOptions()
    near = np.flatnonzero(np.abs(nodes.travelled_m - nodes.travelled_m[node]) <= length_m / 2)
    begin, end = nodes.begins_and_ends()
    reader = BeamReader(
        drive.recording, arc_length_along(drive.recording), options.min_range_m, options.max_range_m, options.min_step_m
    )
    return reader.between(int(begin[near[0]]), int(end[near[-1]]), nodes.T_odom_node[node]).points


def open3d_pair(ref: Array, query: Array) -> Array:
    """``T_ref_query``."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    o3d.utility.random.seed(0)
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (query, ref)]
    coarse = [_thinned(cloud, 0.5) for cloud in clouds]
    features = [
        registration.compute_fpfh_feature(cloud, o3d.geometry.KDTreeSearchParamHybrid(radius=2.5, max_nn=100))
        for cloud in coarse
    ]
    found = registration.registration_ransac_based_on_feature_matching(
        *coarse, *features, True, 0.75, registration.TransformationEstimationPointToPoint(False), 3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(0.75),
        ],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )  # fmt: skip
    fine = [_thinned(cloud, 0.1) for cloud in clouds]
    refined = registration.registration_icp(
        *fine, 0.5, found.transformation, registration.TransformationEstimationPointToPlane(),
        registration.ICPConvergenceCriteria(max_iteration=50),
    )  # fmt: skip
    return np.asarray(refined.transformation, dtype=np.float64)


def _thinned(cloud: Any, voxel_m: float) -> Any:
    import open3d as o3d

    out = cloud.voxel_down_sample(voxel_m)
    out.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=max(2 * voxel_m, 0.3), max_nn=30))
    out.orient_normals_towards_camera_location(np.array([0.0, 0.0, 0.0]))
    return out


def own_pairs(unit: AloneUnit) -> Answers:
    """Search and refinement of each pair on its own."""
    out = []
    windows = unit.reference.window(unit.options.submap_m), unit.query.window(unit.options.submap_m)
    for ref, query in unit.nodes:
        submaps = windows[0].at(ref), windows[1].at(query)
        T, spent = timed(lambda: _own_pair(*map(PreparedSubmap, submaps), unit.options))  # noqa: B023
        out.append((T, spent, sum(map(len, submaps))))
    return out


def _own_pair(ref: PreparedSubmap, query: PreparedSubmap, options: AlignmentOptions) -> Array:
    search, icp = options.registration.search, options.registration.register.icp
    found = guesses(describe(ref.submap, search), describe(query.submap, search), None, search)
    refined = [run_icp(ref.planes, query.planes, T, icp) for T in found]
    if not refined:
        return np.full((4, 4), np.nan)
    return max(refined, key=lambda r: r.count).T_ref_query
