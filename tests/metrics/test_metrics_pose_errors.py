"""What the errors of a pair promise under changes of frame, and at the ends of their ranges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from relocbench.arrays import Array
from relocbench.geometry import invert, make_transform, se3_exp, so3_exp
from relocbench.metrics import pose_errors, within

twists = arrays(np.float64, (4, 6), elements=st.floats(-3, 3))
one_twist = arrays(np.float64, (6,), elements=st.floats(-3, 3))
axes = arrays(np.float64, (3,), elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)


def assert_close(actual: Array, expected: Array) -> None:
    """Equal up to the rounding of a few products of numbers below 10."""
    np.testing.assert_allclose(actual, expected, rtol=1e-12, atol=1e-12)


@given(twists, twists, one_twist)
def test_moving_the_reference_frame_changes_neither_rotation_nor_centre_error(
    pred: Array, gt: Array, move: Array
) -> None:
    T_pred, T_gt, T_ref_other = se3_exp(pred), se3_exp(gt), se3_exp(move)
    before, after = pose_errors(T_pred, T_gt), pose_errors(T_pred @ T_ref_other, T_gt @ T_ref_other)
    assert_close(after.translation_error_m, before.translation_error_m)
    np.testing.assert_allclose(after.rotation_error_deg, before.rotation_error_deg, rtol=1e-9, atol=1e-11)


@given(twists, twists, one_twist)
def test_moving_the_query_frame_changes_neither_rotation_nor_mlad_error(pred: Array, gt: Array, move: Array) -> None:
    T_pred, T_gt, T_other_query = se3_exp(pred), se3_exp(gt), se3_exp(move)
    before, after = pose_errors(T_pred, T_gt), pose_errors(T_other_query @ T_pred, T_other_query @ T_gt)
    assert_close(after.mlad_translation_error_m, before.mlad_translation_error_m)
    np.testing.assert_allclose(after.rotation_error_deg, before.rotation_error_deg, rtol=1e-9, atol=1e-11)


def test_each_translation_error_changes_on_its_other_side() -> None:
    T_pred, T_gt = make_transform(so3_exp([[0, 0.1, 0]]), [[0.0, 0, 1]]), make_transform(np.eye(3), [[0.0, 0, 1]])
    lever = make_transform(np.eye(3), [10.0, 0, 0])
    centre = pose_errors(lever @ T_pred, lever @ T_gt).translation_error_m
    mlad = pose_errors(T_pred @ lever, T_gt @ lever).mlad_translation_error_m
    # a lever arm of 10 m swings by 2 * 10 * sin(0.05)
    assert mlad[0] == pytest.approx(20 * np.sin(0.05))
    assert centre[0] == pytest.approx(2 * np.hypot(10, 1) * np.sin(0.05))


@given(twists, twists)
def test_the_translation_errors_swap_roles_when_poses_are_stored_the_other_way_round(pred: Array, gt: Array) -> None:
    T_pred, T_gt = se3_exp(pred), se3_exp(gt)
    stored, inverted = pose_errors(T_pred, T_gt), pose_errors(invert(T_pred), invert(T_gt))
    assert_close(inverted.translation_error_m, stored.mlad_translation_error_m)
    assert_close(inverted.mlad_translation_error_m, stored.translation_error_m)
    np.testing.assert_allclose(inverted.rotation_error_deg, stored.rotation_error_deg, rtol=1e-9, atol=1e-11)


@given(twists, arrays(np.float64, (4, 3), elements=st.floats(-3, 3)))
def test_the_translation_errors_are_equal_when_the_rotation_is_exact(gt: Array, offset: Array) -> None:
    T_gt = se3_exp(gt)
    T_pred = T_gt.copy()
    T_pred[:, :3, 3] += offset
    errors = pose_errors(T_pred, T_gt)
    assert_close(errors.translation_error_m, errors.mlad_translation_error_m)
    assert_close(errors.mlad_translation_error_m, np.linalg.norm(offset, axis=-1))


@given(twists)
def test_the_true_pose_has_no_error(gt: Array) -> None:
    errors = pose_errors(se3_exp(gt), se3_exp(gt))
    np.testing.assert_array_equal(errors.translation_error_m, 0)
    np.testing.assert_array_equal(errors.mlad_translation_error_m, 0)
    np.testing.assert_allclose(errors.rotation_error_deg, 0, atol=1e-13)


@given(axes, one_twist)
def test_rotation_error_is_accurate_at_a_billionth_of_a_radian(axis: Array, gt: Array) -> None:
    T_gt = se3_exp(gt)[None]
    T_error = make_transform(so3_exp(1e-9 * axis / np.linalg.norm(axis)), np.zeros(3))
    error = pose_errors(T_error @ T_gt, T_gt).rotation_error_deg[0]
    assert error == pytest.approx(np.degrees(1e-9), abs=np.degrees(1e-15))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_a_turn_is_180_degrees_exactly(axis: int) -> None:
    turned = -np.eye(4)
    turned[axis, axis] = turned[3, 3] = 1
    assert pose_errors(turned[None], np.eye(4)[None]).rotation_error_deg[0] == 180.0


@given(axes)
def test_half_a_turn_about_any_axis_is_180_degrees(axis: Array) -> None:
    turned = make_transform(so3_exp(np.pi * axis / np.linalg.norm(axis)), np.zeros(3))
    assert pose_errors(turned[None], np.eye(4)[None]).rotation_error_deg[0] == pytest.approx(180, abs=1e-12)


@given(st.floats(1e-6, np.pi), axes)
def test_rotation_error_is_the_angle_of_the_rotation_between(angle: float, axis: Array) -> None:
    turned = make_transform(so3_exp(angle * axis / np.linalg.norm(axis)), np.zeros(3))
    error = pose_errors(turned[None], np.eye(4)[None]).rotation_error_deg[0]
    assert error == pytest.approx(np.degrees(angle), rel=1e-9)


def test_hand_value_query_ahead_and_turned() -> None:
    # Query 2 m ahead (z), predicted 2 m ahead but turned by 90 degrees about y: the centre is right, t is not.
    R = so3_exp([0, np.pi / 2, 0])
    centre = np.array([0.0, 0.0, 2.0])
    T_gt, T_pred = make_transform(np.eye(3), -centre)[None], make_transform(R, -R @ centre)[None]
    errors = pose_errors(T_pred, T_gt)
    assert errors.rotation_error_deg[0] == pytest.approx(90)
    assert errors.translation_error_m[0] == pytest.approx(0, abs=1e-15)
    assert errors.mlad_translation_error_m[0] == pytest.approx(2 * np.sqrt(2))


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(N, 4, 4\)"):
        pose_errors(np.eye(4), np.eye(4))
    with pytest.raises(ValueError, match="true poses"):
        pose_errors(np.eye(4)[None], np.tile(np.eye(4), (2, 1, 1)))
    with pytest.raises(ValueError, match="answered"):
        pose_errors(np.eye(4)[None], np.eye(4)[None], answered=[True, True])


@given(twists, twists, st.floats(0.01, 5), st.floats(0.1, 90), st.floats(1.1, 10))
def test_the_joint_error_is_at_most_one_exactly_within_both_thresholds(
    pred: Array, gt: Array, metres: float, degrees: float, factor: float
) -> None:
    errors = pose_errors(se3_exp(pred), se3_exp(gt))
    joint = errors.joint_error(metres, degrees)
    assert np.array_equal(joint <= 1, within(errors, metres, degrees))
    np.testing.assert_allclose(errors.joint_error(factor * metres, factor * degrees), joint / factor, rtol=1e-12)
    assert np.all(joint >= errors.translation_error_m / metres)
    assert np.all(joint >= errors.rotation_error_deg / degrees)


def test_a_right_position_alone_has_a_joint_error_of_its_rotation() -> None:
    T_gt = np.eye(4)[None].repeat(2, axis=0)
    T_pred = np.stack(
        [make_transform(so3_exp(np.array([0.0, 0.0, np.radians(3)])), np.zeros(3)), np.full((4, 4), np.nan)]
    )
    joint = pose_errors(T_pred, T_gt).joint_error(0.25, 2)
    assert joint.tolist() == pytest.approx([1.5, np.inf])
    with pytest.raises(ValueError, match="positive"):
        pose_errors(T_pred, T_gt).joint_error(0.25, 0)
