"""ICP by this package, by Open3D or by small_gicp, behind one function.

This package's own is the default: it reuses the prepared planes of a submap, samples directions evenly, allows for the
drift of odometry, and returns an information matrix. For the others, the information matrix comes from this package's
linearisation at the pose that they found, so that it means the same.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, IcpResult, icp_result_at, run_icp
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.errors import ConfigError
from relocbench.geometry import project_to_rotation

Backend = Literal["own", "open3d", "small_gicp"]
BACKENDS: tuple[Backend, ...] = ("own", "open3d", "small_gicp")

_THINNING_M = 0.15


def icp_by_backend(
    backend: Backend,
    ref: PreparedSubmap,
    query: PreparedSubmap,
    T_ref_query: Array,
    options: IcpOptions,
    levels: Sequence[int] | None = None,
) -> IcpResult:
    """ICP from a prediction; see :func:`relocbench.datasets.groundtruth.icp.icp.run_icp` for the arguments.

    Raises:
        ConfigError: there is no such backend, or its package is not installed.
    """
    if backend == "own":
        return run_icp(ref.planes, query.planes, T_ref_query, options, levels=levels)
    if backend not in BACKENDS:
        raise ConfigError(f"no registration backend '{backend}'; expected one of {', '.join(BACKENDS)}")
    solve = _open3d if backend == "open3d" else _small_gicp
    T = np.array(T_ref_query, dtype=np.float64)
    for k in range(len(options.levels)) if levels is None else levels:
        reach = min(ref.planes.options.reach_m[options.levels[k]], query.planes.options.reach_m[options.levels[k]])
        T = solve(ref.planes, query.planes, T, reach, options.scales_m[k], options.iterations[k])
    T[:3, :3] = project_to_rotation(T[:3, :3])
    return icp_result_at(ref.planes, query.planes, T, options)


def _thin(planes: PlaneMap) -> tuple[Array, Array]:
    points, normals = planes.points, planes.normals
    keep = first_in_voxels(points, _THINNING_M)
    return points[keep], normals[keep]


def _open3d(
    ref: PlaneMap, query: PlaneMap, T_ref_query: Array, reach_m: float, scale_m: float, iterations: int
) -> Array:
    """Point-to-plane ICP with the same kernel, in double precision: single precision would cost millimetres."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    target, source = (open3d_cloud(*_thin(side)) for side in (ref, query))
    result = registration.registration_icp(
        source,
        target,
        reach_m,
        T_ref_query,
        registration.TransformationEstimationPointToPlane(registration.GMLoss(scale_m)),
        registration.ICPConvergenceCriteria(1e-7, 1e-7, iterations),
    )
    return np.array(result.transformation, dtype=np.float64)


def open3d_cloud(points: Array, normals: Array) -> Any:
    """Open3D's point cloud of points (N, 3) with normals (N, 3)."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


def _small_gicp(
    ref: PlaneMap, query: PlaneMap, T_ref_query: Array, reach_m: float, scale_m: float, iterations: int
) -> Array:
    try:
        small_gicp = importlib.import_module("small_gicp")
    except ImportError:
        raise ConfigError(
            "backend 'small_gicp' needs the package small_gicp: pip install 'relocbench[registration]', or use 'own'"
        ) from None
    target, source = (small_gicp.PointCloud(_thin(side)[0]) for side in (ref, query))
    tree = small_gicp.KdTree(target, num_threads=1)
    for cloud, own in ((target, tree), (source, None)):
        small_gicp.estimate_covariances(cloud, own or small_gicp.KdTree(cloud, num_threads=1), 20, 1)
    result = small_gicp.align(
        target,
        source,
        tree,
        init_T_target_source=T_ref_query,
        registration_type="GICP",
        max_correspondence_distance=reach_m,
        num_threads=1,
        max_iterations=iterations,
    )
    return np.array(result.T_target_source, dtype=np.float64)
