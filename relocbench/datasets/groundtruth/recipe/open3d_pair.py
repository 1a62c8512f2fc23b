"""Registration of two clouds by Open3D alone: RANSAC on FPFH features without a prediction, and point-to-plane ICP.

The recipe that GN-Net (von Stumberg, Wenzel, Khan and Cremers, RA-L 2020) describes for its ground truth; it does not
state voxels, reaches and iterations, which are the usual ones of Open3D's tutorials, scaled to streets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.geometry import adjoint, make_transform, project_to_rotation, so3_exp, so3_log

FEWEST_POINTS = 100
"""a cloud with fewer points is not registered"""


@dataclass(frozen=True)
class Open3dOptions:
    """Options of the recipe."""

    coarse_m: float = 0.5
    """voxel size of the clouds that features are computed for"""
    feature_reach: float = 5.0
    """radius of the features, in such voxels"""
    ransac_reach: float = 1.5
    """greatest distance between corresponding points in RANSAC, in such voxels"""
    ransac_iterations: int = 100_000
    fine_m: float = 0.1
    """voxel size of the clouds for ICP"""
    icp_reach_m: float = 0.5
    """greatest distance between corresponding points in ICP"""
    icp_iterations: int = 50
    seed: int = 0
    least_fitness: float = 0.6
    """a pair is accepted if so large a share of the query's points has a point of the reference within reach, and"""
    most_rmse_m: float = 0.2
    """if the distances between these points have no larger root mean square"""


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of one submap as ICP uses them, and those that RANSAC starts from."""

    points: Array
    """(N, 3), all of them"""
    fine: Any
    """Open3D's cloud, thinned, with normals"""

    @classmethod
    def of(cls, points: Array, options: Open3dOptions) -> Cloud:
        """Thin points (N, 3) and estimate normals."""
        return cls(points, _thinned(points, options.fine_m))

    def __len__(self) -> int:
        return len(self.fine.points)


@dataclass(frozen=True, eq=False)
class Open3dFit:
    """What Open3D says of two clouds."""

    T_ref_query: Array
    """(4, 4)"""
    fitness: float
    """share of the query's points with a point of the reference within the reach"""
    rmse_m: float
    """root mean square of the distances between these points"""
    information: Array
    """(6, 6) Open3D's information matrix, of xi = (rho, phi) in ``T_ref_query @ se3_exp(xi)``"""

    def refusal(self, options: Open3dOptions) -> str:
        """Why the pair is not accepted; empty if it is."""
        if self.fitness < options.least_fitness:
            return f"fitness {self.fitness:.2f} is below {options.least_fitness:g}"
        if self.rmse_m > options.most_rmse_m:
            return f"RMSE {self.rmse_m:.3f} m exceeds {options.most_rmse_m:g} m"
        return ""


def search(ref: Cloud, query: Cloud, options: Open3dOptions) -> Array:
    """(4, 4) ``T_ref_query`` by RANSAC on FPFH features, the same for the same seed; it may be wrong."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    o3d.utility.random.seed(options.seed)
    coarse = [_thinned(cloud.points, options.coarse_m) for cloud in (query, ref)]
    near = o3d.geometry.KDTreeSearchParamHybrid(radius=options.feature_reach * options.coarse_m, max_nn=100)
    # Open3D's stubs require indices, which have a default.
    features = [registration.compute_fpfh_feature(cloud, near) for cloud in coarse]  # type: ignore[call-arg]
    reach = options.ransac_reach * options.coarse_m
    result = registration.registration_ransac_based_on_feature_matching(
        coarse[0],
        coarse[1],
        features[0],
        features[1],
        True,
        reach,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(reach),
        ],
        registration.RANSACConvergenceCriteria(options.ransac_iterations, 0.999),
    )
    return _settled(result.transformation)


def refine(ref: Cloud, query: Cloud, T_ref_query: Array, options: Open3dOptions) -> Open3dFit:
    """Point-to-plane ICP from a prediction, with Open3D's information matrix at its end."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    result = registration.registration_icp(
        query.fine,
        ref.fine,
        options.icp_reach_m,
        T_ref_query,
        registration.TransformationEstimationPointToPlane(),
        registration.ICPConvergenceCriteria(max_iteration=options.icp_iterations),
    )
    T = _settled(result.transformation)
    by_open3d = registration.get_information_matrix_from_point_clouds(query.fine, ref.fine, options.icp_reach_m, T)
    information = on_the_right(np.array(by_open3d, dtype=np.float64).round(3), T)
    return Open3dFit(T, round(float(result.fitness), 9), round(float(result.inlier_rmse), 9), information)


def _settled(transformation: Any) -> Array:
    """(4, 4) Open3D's pose, a rotation and rounded to nanometres and nanoradians.

    Its threads add in any order, so that the last digits differ from run to run; datasets must not.
    """
    T = np.array(transformation, dtype=np.float64)
    turned = so3_log(project_to_rotation(T[:3, :3]))
    return make_transform(so3_exp(np.round(turned, 9)), np.round(T[:3, 3], 9))


def on_the_right(information: Array, T_ref_query: Array) -> Array:
    """Open3D's information matrix in this package's convention.

    Open3D's is of a twist (phi, rho) on the left of ``T_ref_query``, the rotation first: the sum, over corresponding
    points, of ``G^T G`` with ``G = [-[p]_x, I]`` for a point p in the reference's frame (Choi, Zhou and Koltun, Robust
    Reconstruction of Indoor Scenes, CVPR 2015). As ``T exp(xi) = exp(Ad_T xi) T``, the result is ``Ad_T^T L Ad_T``.
    """
    order = [3, 4, 5, 0, 1, 2]
    left = information[np.ix_(order, order)]
    A = adjoint(T_ref_query)
    out = A.T @ left @ A
    return np.asarray((out + out.T) / 2)


def _thinned(points: Array, voxel_m: float) -> Any:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(voxel_m)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=max(2 * voxel_m, 0.3), max_nn=30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    return cloud
