"""Properties of SE(3): the promises of names and docstrings, over random transforms and at the edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from relocbench.arrays import Array, Times
from relocbench.geometry import (
    adjoint,
    apply,
    compose,
    hat,
    interpolate,
    interpolate_trajectory,
    invert,
    is_rotation,
    make_transform,
    project_to_rotation,
    quaternion_from_rotation,
    rotation_angle,
    rotation_from_quaternion,
    se3_exp,
    se3_log,
    so3_exp,
    so3_log,
    transform_from_tq,
    transform_to_tq,
)

AXES = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)
SMALL = st.sampled_from([0.0, 1e-300, 1e-160, 1e-12, 1e-9, 1e-8, 1e-6, 1e-4, 0.01, 0.2499, 0.25, 0.2501])
ANGLES = st.one_of(SMALL, st.floats(0, np.pi - 1e-6))
NEAR_PI = st.sampled_from([1e-3, 1e-6, 1e-9, 1e-12, 0.0]).map(lambda gap: np.pi - gap)
POSITIONS = st.tuples(*[st.floats(-1e3, 1e3)] * 3).map(np.array)
ROTATION_VECTORS = st.builds(lambda axis, angle: axis * angle, AXES, ANGLES)
TRANSFORMS = st.builds(lambda phi, t: make_transform(so3_exp(phi), t), ROTATION_VECTORS, POSITIONS)


@given(ROTATION_VECTORS)
def test_log_undoes_exp_of_rotations(phi: Array) -> None:
    # Next to half a turn the direction of the axis is as good as the matrix, the angle as good as its sine.
    np.testing.assert_allclose(so3_log(so3_exp(phi)), phi, rtol=1e-9, atol=1e-15)


@given(AXES, NEAR_PI)
def test_log_of_half_a_turn_is_the_same_rotation(axis: Array, angle: float) -> None:
    rotation = so3_exp(axis * angle)
    phi = so3_log(rotation)
    assert np.linalg.norm(phi) <= np.pi + 1e-15
    assert np.linalg.norm(phi) == pytest.approx(angle, abs=1e-14)
    np.testing.assert_allclose(so3_exp(phi), rotation, atol=1e-14)


@given(st.one_of(ROTATION_VECTORS, st.builds(lambda a, t: a * t, AXES, st.floats(0, 50))))
def test_exp_agrees_with_scipy_and_is_a_rotation(phi: Array) -> None:
    rotation = so3_exp(phi)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(phi).as_matrix(), atol=1e-13)
    assert is_rotation(rotation, tolerance=1e-13)


@given(AXES, st.floats(-15, -1).map(lambda e: 10.0**e))
def test_rotation_angle_is_right_for_tiny_rotations(axis: Array, angle: float) -> None:
    assert rotation_angle(so3_exp(axis * angle)) == pytest.approx(angle, rel=1e-13)


@given(AXES)
def test_rotation_angle_at_a_nanoradian(axis: Array) -> None:
    assert rotation_angle(so3_exp(axis * 1e-9)) == pytest.approx(1e-9, rel=1e-13)


def test_rotation_angle_of_half_turns_is_exactly_pi() -> None:
    for diagonal in ([1, -1, -1], [-1, 1, -1], [-1, -1, 1]):
        assert rotation_angle(np.diag(diagonal)) == np.pi
    swap = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])  # half a turn about x + y
    assert rotation_angle(swap) == np.pi


@given(AXES, st.floats(0, np.pi), ROTATION_VECTORS)
def test_rotation_angle_does_not_depend_on_the_frame(axis: Array, angle: float, phi: Array) -> None:
    frame = so3_exp(phi)
    assert rotation_angle(frame @ so3_exp(axis * angle) @ frame.T) == pytest.approx(angle, abs=1e-14)


@given(AXES, st.one_of(ANGLES, NEAR_PI))
def test_quaternion_and_rotation_undo_each_other(axis: Array, angle: float) -> None:
    rotation = so3_exp(axis * angle)
    q = quaternion_from_rotation(rotation)
    assert q[3] >= 0
    assert np.linalg.norm(q) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(rotation_from_quaternion(q), rotation, atol=1e-14)
    np.testing.assert_allclose(rotation_from_quaternion(-3 * q), rotation, atol=1e-14)  # sign and scale do not matter
    agreement = abs(float(q @ Rotation.from_matrix(rotation).as_quat()))  # scipy's order is x y z w as well
    assert agreement == pytest.approx(1, abs=1e-14)


def test_quaternion_order_is_x_y_z_w() -> None:
    """A quarter turn about z takes x to y; its quaternion is (0, 0, sin 45, cos 45)."""
    q = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    rotation = rotation_from_quaternion(q)
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(quaternion_from_rotation(rotation), q, atol=1e-15)


@given(ROTATION_VECTORS, POSITIONS)
def test_log_undoes_exp_of_twists(phi: Array, rho: Array) -> None:
    xi = np.concatenate([rho, phi])
    size = 1 + float(np.linalg.norm(rho))
    np.testing.assert_allclose(se3_log(se3_exp(xi)), xi, rtol=1e-9, atol=1e-12 * size)


@given(AXES, NEAR_PI, POSITIONS)
def test_exp_undoes_log_of_transforms_near_half_a_turn(axis: Array, angle: float, t: Array) -> None:
    transform = make_transform(so3_exp(axis * angle), t)
    np.testing.assert_allclose(se3_exp(se3_log(transform)), transform, atol=1e-12 * (1 + float(np.linalg.norm(t))))


@given(ROTATION_VECTORS, POSITIONS)
def test_exp_of_a_twist_is_the_matrix_exponential(phi: Array, rho: Array) -> None:
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = hat(phi), rho
    expected, term = np.eye(4), np.eye(4)
    for n in range(1, 60):  # the defining series; |phi| <= pi needs about forty terms
        term = term @ generator / n
        expected = expected + term
    np.testing.assert_allclose(
        se3_exp([*rho, *phi]), expected, rtol=1e-12, atol=1e-12 * (1 + float(np.linalg.norm(rho)))
    )


@given(POSITIONS, POSITIONS)
def test_hat_is_the_cross_product(a: Array, b: Array) -> None:
    np.testing.assert_allclose(hat(a) @ b, np.cross(a, b), atol=1e-9)
    np.testing.assert_array_equal(hat(a).T, -hat(a))


@given(TRANSFORMS)
def test_inverse_undoes_from_both_sides(transform: Array) -> None:
    size = 1 + np.abs(transform[:3, 3]).max()
    np.testing.assert_allclose(transform @ invert(transform), np.eye(4), atol=1e-14 * size)
    np.testing.assert_allclose(invert(transform) @ transform, np.eye(4), atol=1e-14 * size)


@given(TRANSFORMS, TRANSFORMS, TRANSFORMS, POSITIONS)
def test_compose_applies_right_to_left(T_d_c: Array, T_c_b: Array, T_b_a: Array, point: Array) -> None:
    step_by_step = apply(T_d_c, apply(T_c_b, apply(T_b_a, point[None])))
    np.testing.assert_allclose(apply(compose(T_d_c, T_c_b, T_b_a), point[None]), step_by_step, atol=1e-10)
    inverse = compose(invert(T_b_a), invert(T_c_b), invert(T_d_c))
    np.testing.assert_allclose(invert(compose(T_d_c, T_c_b, T_b_a)), inverse, atol=1e-10)


def test_compose_of_nothing_is_the_identity() -> None:
    np.testing.assert_array_equal(compose(), np.eye(4))


@pytest.mark.thorough
def test_compose_does_not_drift_off_the_rotations() -> None:
    step = se3_exp([0.1, 0.2, 0.3, 0.01, -0.02, 0.03])
    transform = np.eye(4)
    for _ in range(20000):
        transform = compose(transform, step)
    assert is_rotation(transform[:3, :3], tolerance=1e-14)


@given(TRANSFORMS)
def test_translation_and_quaternion_hold_the_transform(transform: Array) -> None:
    t, q = transform_to_tq(transform)
    np.testing.assert_allclose(transform_from_tq(t, q), transform, atol=1e-14 * (1 + np.abs(t).max()))


def test_functions_are_vectorised_over_leading_dimensions() -> None:
    rng = np.random.default_rng(0)
    xi = rng.normal(size=(2, 5, 6))
    many = se3_exp(xi)
    assert many.shape == (2, 5, 4, 4)
    for i in np.ndindex(2, 5):
        np.testing.assert_allclose(many[i], se3_exp(xi[i]), atol=1e-15)
        np.testing.assert_allclose(se3_log(many)[i], se3_log(many[i]), atol=1e-15)
        np.testing.assert_allclose(invert(many)[i], invert(many[i]), atol=1e-15)
        np.testing.assert_allclose(quaternion_from_rotation(many[..., :3, :3])[i], transform_to_tq(many[i])[1])
    points = rng.normal(size=(2, 5, 7, 3))
    np.testing.assert_allclose(apply(many, points)[1, 2], apply(many[1, 2], points[1, 2]), atol=1e-14)
    np.testing.assert_allclose(compose(many, many)[1, 3], compose(many[1, 3], many[1, 3]), atol=1e-15)


@given(TRANSFORMS, TRANSFORMS)
def test_interpolation_ends_at_its_ends(T_0: Array, T_1: Array) -> None:
    np.testing.assert_allclose(interpolate(T_0, T_1, 0.0), T_0, atol=1e-13)
    np.testing.assert_allclose(interpolate(T_0, T_1, 1.0), T_1, atol=1e-12)


@given(TRANSFORMS, AXES, st.floats(0, np.pi - 1e-3), POSITIONS, st.floats(0, 1))
def test_interpolation_takes_its_share_of_the_shorter_arc(
    T_0: Array, axis: Array, angle: float, t_1: Array, fraction: float
) -> None:
    T_1 = make_transform(T_0[:3, :3] @ so3_exp(axis * angle), t_1)
    between = interpolate(T_0, T_1, fraction)
    assert rotation_angle(T_0[:3, :3].T @ between[:3, :3]) == pytest.approx(fraction * angle, abs=1e-12)
    assert rotation_angle(between[:3, :3].T @ T_1[:3, :3]) == pytest.approx((1 - fraction) * angle, abs=1e-12)
    expected = (1 - fraction) * T_0[:3, 3] + fraction * t_1
    np.testing.assert_allclose(between[:3, 3], expected, atol=1e-9)
    slerp = Slerp([0, 1], Rotation.from_matrix(np.stack([T_0[:3, :3], T_1[:3, :3]])))
    np.testing.assert_allclose(between[:3, :3], slerp(fraction).as_matrix(), atol=1e-10)


def test_halfway_between_350_and_20_degrees_is_5() -> None:
    start, end, middle = (so3_exp([0, 0, np.deg2rad(d)]) for d in (350, 20, 5))
    halfway = interpolate(make_transform(start, [0, 0, 0]), make_transform(end, [2, 4, 6]), 0.5)
    np.testing.assert_allclose(halfway, make_transform(middle, [1, 2, 3]), atol=1e-15)


NOW_NS = 1_602_074_877_390_449_152  # float64 holds such a time to 256 ns


def ramp(n: int = 4, step_ns: int = 1000) -> tuple[Times, Array]:
    """Times from now on, and poses that move one metre along x and turn a tenth of a radian each step."""
    times = NOW_NS + step_ns * np.arange(n, dtype=np.int64)
    twists = np.zeros((n, 6))
    twists[:, 5] = 0.1 * np.arange(n)
    poses = se3_exp(twists)
    poses[:, 0, 3] = np.arange(n)
    return times, poses


def test_trajectory_is_interpolated_to_the_nanosecond() -> None:
    times, poses = ramp()
    query = [NOW_NS, NOW_NS + 1, NOW_NS + 999, NOW_NS + 1000, NOW_NS + 1001, NOW_NS + 3000]
    found = interpolate_trajectory(times, poses, query)
    np.testing.assert_allclose(found[:, 0, 3], [0, 0.001, 0.999, 1, 1.001, 3], atol=1e-15)
    np.testing.assert_allclose(so3_log(found[:, :3, :3])[:, 2], [0, 1e-4, 0.0999, 0.1, 0.1001, 0.3], atol=1e-14)


def test_trajectory_at_its_own_times_is_itself() -> None:
    times, poses = ramp(7)
    np.testing.assert_allclose(interpolate_trajectory(times, poses, times), poses, atol=1e-15)


@pytest.mark.parametrize("offset", [-1, 3001])
def test_trajectory_is_never_extrapolated(offset: int) -> None:
    times, poses = ramp()
    with pytest.raises(ValueError, match=str(NOW_NS + offset)):
        interpolate_trajectory(times, poses, [NOW_NS + 5, NOW_NS + offset])


@pytest.mark.parametrize("times", [[], [5, 5, 6, 7], [5, 4, 6, 7]])
def test_trajectory_times_must_increase(times: list[int]) -> None:
    with pytest.raises(ValueError, match="increasing"):
        interpolate_trajectory(np.array(times, dtype=np.int64), ramp()[1][: len(times)], [5])


def test_trajectory_of_one_pose_answers_its_time_alone() -> None:
    times, poses = ramp(1)
    np.testing.assert_array_equal(interpolate_trajectory(times, poses, [NOW_NS, NOW_NS]), [poses[0], poses[0]])
    with pytest.raises(ValueError, match="outside"):
        interpolate_trajectory(times, poses, [NOW_NS + 1])


def test_trajectory_asked_for_nothing_answers_nothing() -> None:
    assert interpolate_trajectory(*ramp(), []).shape == (0, 4, 4)


def test_trajectory_times_in_seconds_are_refused() -> None:
    times, poses = ramp()
    with pytest.raises(ValueError, match="nanoseconds"):
        interpolate_trajectory(times, poses, [1602074877.390449])
    with pytest.raises(ValueError, match="nanoseconds"):
        interpolate_trajectory(times / 1e9, poses, [NOW_NS])


def test_trajectory_needs_a_pose_for_every_time() -> None:
    times, poses = ramp()
    with pytest.raises(ValueError, match="4"):
        interpolate_trajectory(times, poses[:3], [NOW_NS])


@given(TRANSFORMS, st.integers(0, 2**32 - 1))
def test_the_adjoint_carries_a_twist_to_the_other_side(transform: Array, seed: int) -> None:
    xi = np.random.default_rng(seed).uniform(-1, 1, 6)
    np.testing.assert_allclose(transform @ se3_exp(xi), se3_exp(adjoint(transform) @ xi) @ transform, atol=1e-9)


@given(TRANSFORMS, st.integers(0, 2**32 - 1))
def test_nearest_rotation_mends_printed_digits(transform: Array, seed: int) -> None:
    rotation = transform[:3, :3]
    noise = np.random.default_rng(seed).uniform(-5e-7, 5e-7, (3, 3))
    mended = project_to_rotation(rotation + noise)
    assert is_rotation(mended, tolerance=1e-14)
    assert np.abs(mended - rotation).max() < 3e-6
    assert np.linalg.norm(mended - rotation - noise) <= np.linalg.norm(noise) + 1e-15  # nearer than the true one


def test_nearest_rotation_to_a_reflection_is_a_rotation() -> None:
    assert is_rotation(project_to_rotation(np.diag([1.0, 1.0, -1.0])))


def test_what_is_no_rotation() -> None:
    assert is_rotation(np.eye(3))
    assert not is_rotation(np.diag([1.0, 1.0, -1.0]))
    assert not is_rotation(1.001 * np.eye(3))
    assert not is_rotation(np.full((3, 3), np.nan))
