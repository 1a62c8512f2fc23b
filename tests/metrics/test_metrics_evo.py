"""Agreement with evo, the field's tool for trajectories, on trajectories whose errors are published.

A trajectory's poses are ``T_world_cam``. As a pair, the world is the reference and the camera the query, so
``T_query_ref = inv(T_world_cam)`` and the camera centres' distance is evo's absolute position error.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PosePath3D
from evo.core.units import Unit
from evo.tools import file_interface

from relocbench.arrays import Array
from relocbench.geometry import invert, project_to_rotation
from relocbench.metrics import PoseErrors, pose_errors

RealData = Callable[[str], Path]
PoseRelation = metrics.PoseRelation


def on_so3(trajectory: PosePath3D) -> PosePath3D:
    """The same trajectory with rotations put back onto SO(3).

    KITTI prints matrices with 7 to 10 digits; ``-R^T t`` of such a matrix is off by 1e-7 of 500 m.
    """
    poses = np.array(trajectory.poses_se3)
    poses[:, :3, :3] = project_to_rotation(poses[:, :3, :3])
    return PosePath3D(poses_se3=list(poses))


def kitti(real_data: RealData) -> tuple[PosePath3D, PosePath3D]:
    folder = real_data("evo_reference_results")
    gt = on_so3(file_interface.read_kitti_poses_file(folder / "KITTI_00_gt.txt"))
    return gt, on_so3(file_interface.read_kitti_poses_file(folder / "KITTI_00_ORB.txt"))


def fr1_xyz(real_data: RealData) -> tuple[PosePath3D, PosePath3D]:
    folder = real_data("evo_reference_results")
    gt = file_interface.read_tum_trajectory_file(folder / "freiburg1_xyz-groundtruth.txt")
    estimate = file_interface.read_tum_trajectory_file(folder / "freiburg1_xyz-rgbdslam.txt")
    gt, estimate = sync.associate_trajectories(gt, estimate)
    return on_so3(gt), on_so3(estimate)


def umeyama(source: Array, target: Array, with_scale: bool) -> tuple[Array, Array, float]:
    """R, t, s that minimise ``sum |target - (s R source + t)|^2`` over points (N, 3) (Umeyama, PAMI 1991)."""
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    covariance = (target - mean_target).T @ (source - mean_source) / len(source)
    u, d, vt = np.linalg.svd(covariance)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    R = u @ sign @ vt
    s = np.trace(np.diag(d) @ sign) / source.var(axis=0).sum() if with_scale else 1.0
    return R, mean_target - s * R @ mean_source, float(s)


def aligned(gt: PosePath3D, estimate: PosePath3D, with_scale: bool = False) -> Array:
    """Estimated poses (N, 4, 4) ``T_world_cam`` after the best similarity or rigid alignment of the centres."""
    poses = np.array(estimate.poses_se3)
    R, t, s = umeyama(poses[:, :3, 3], np.array(gt.positions_xyz), with_scale)
    poses[:, :3, 3] = s * poses[:, :3, 3] @ R.T + t
    poses[:, :3, :3] = R @ poses[:, :3, :3]
    return poses


def errors_of_trajectory(T_world_cam_pred: Array, T_world_cam_gt: Array) -> PoseErrors:
    return pose_errors(invert(T_world_cam_pred), invert(T_world_cam_gt))


def evo_errors(metric: metrics.PE, gt: PosePath3D, estimate: PosePath3D) -> Array:
    metric.process_data((gt, estimate))
    return np.array(metric.error)


def rmse(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def test_fr1_xyz_absolute_error_is_the_published_one(real_data: RealData) -> None:
    # evo 1.38.1, and the example of evaluate_ate on the TUM RGB-D benchmark's page: 0.013470 m.
    gt, estimate = fr1_xyz(real_data)
    error = errors_of_trajectory(aligned(gt, estimate), np.array(gt.poses_se3)).translation_error_m
    assert rmse(error) == pytest.approx(0.013470, abs=5e-7)
    assert np.mean(error) == pytest.approx(0.012024, abs=5e-7)
    assert np.median(error) == pytest.approx(0.011183, abs=5e-7)
    assert np.max(error) == pytest.approx(0.034760, abs=5e-7)


@pytest.mark.parametrize(("with_scale", "published"), [(False, 1.3034497), (True, 0.937709)])
def test_kitti_00_absolute_error_is_the_published_one(real_data: RealData, with_scale: bool, published: float) -> None:
    # evo's own stored result of ORB-SLAM on KITTI 00 (orb_ape.zip), and evo 1.38.1 with scale.
    gt, estimate = kitti(real_data)
    error = errors_of_trajectory(aligned(gt, estimate, with_scale), np.array(gt.poses_se3)).translation_error_m
    assert rmse(error) == pytest.approx(published, abs=5e-7)


@pytest.mark.thorough
@pytest.mark.parametrize("sequence", [fr1_xyz, kitti])
def test_every_pose_has_evos_absolute_error(
    real_data: RealData, sequence: Callable[[RealData], tuple[PosePath3D, PosePath3D]]
) -> None:
    gt, raw = sequence(real_data)
    poses = aligned(gt, raw)
    estimate = PosePath3D(poses_se3=list(poses))
    errors = errors_of_trajectory(poses, np.array(gt.poses_se3))
    translation = evo_errors(metrics.APE(PoseRelation.translation_part), gt, estimate)
    rotation = evo_errors(metrics.APE(PoseRelation.rotation_angle_deg), gt, estimate)
    assert len(errors) == len(translation) > 700
    np.testing.assert_allclose(errors.translation_error_m, translation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(errors.rotation_error_deg, rotation, rtol=0, atol=1e-9)


def motions(poses: Array, pairs: Array) -> Array:
    """``T_from_to`` of each pair of indices: the later camera's pose in the frame of the earlier."""
    out: Array = invert(poses[pairs[:, 0]]) @ poses[pairs[:, 1]]
    return out


@pytest.mark.thorough
@pytest.mark.parametrize("sequence", [fr1_xyz, kitti])
def test_every_motion_has_evos_relative_error(
    real_data: RealData, sequence: Callable[[RealData], tuple[PosePath3D, PosePath3D]]
) -> None:
    # The later camera is the query: its centre in the frame of the earlier one is what evo compares.
    gt, estimate = sequence(real_data)
    n = gt.num_poses
    pairs = np.stack([np.arange(n - 1), np.arange(1, n)], axis=-1)
    pred, true = (motions(np.array(path.poses_se3), pairs) for path in (estimate, gt))
    errors = pose_errors(invert(pred), invert(true))
    translation = evo_errors(metrics.RPE(PoseRelation.translation_part), gt, estimate)
    rotation = evo_errors(metrics.RPE(PoseRelation.rotation_angle_deg), gt, estimate)
    np.testing.assert_allclose(errors.translation_error_m, translation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(errors.rotation_error_deg, rotation, rtol=0, atol=1e-9)
    # Stored the other way round, the same number stands under the other name.
    np.testing.assert_allclose(pose_errors(pred, true).mlad_translation_error_m, translation, rtol=0, atol=1e-9)


def test_kitti_00_relative_error_over_ten_metres_is_the_published_one(real_data: RealData) -> None:
    # evo's own stored result (orb_rpe.zip): 10 m, consecutive, not aligned. It was made by a version of evo that
    # began at the first 10 m mark; later versions count the stretch from the start to that mark as well.
    gt, estimate = kitti(real_data)
    evo_metric = metrics.RPE(PoseRelation.translation_part, delta=10, delta_unit=Unit.meters, all_pairs=False)
    evo_error = evo_errors(evo_metric, gt, estimate)
    pairs = np.stack([[0, *evo_metric.delta_ids[:-1]], evo_metric.delta_ids], axis=-1)
    pred, true = (motions(np.array(path.poses_se3), pairs) for path in (estimate, gt))
    error = pose_errors(invert(pred), invert(true)).translation_error_m
    np.testing.assert_allclose(error, evo_error, rtol=0, atol=1e-9)
    assert rmse(error[1:]) == pytest.approx(0.2262613, abs=2e-7)
    assert np.mean(error[1:]) == pytest.approx(0.1690174, abs=2e-7)
