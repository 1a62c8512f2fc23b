"""The compiled normal equations: against finite differences, and against plain NumPy."""

from __future__ import annotations

import numpy as np
import plain_alignment as plain
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.depth_map import LevelPoints
from baselines.alignment.shared.pyramid import Level, camera_intrinsics, with_gradients
from baselines.alignment.shared.scratch import BLOCK
from baselines.alignment.shared.small_matrices import se3_exp, solve_cholesky
from relocbench import geometry
from relocbench.arrays import Array
from relocbench.geometry import Camera

CAMERA = Camera("pinhole", 80, 60, 70.0, 75.0, 39.0, 30.5)
T = geometry.se3_exp(np.array([0.05, -0.03, 0.1, 0.02, -0.01, 0.03]))


def run(
    level_map: FloatArray,
    points: FloatArray,
    values: FloatArray,
    pose: Array,
    gain: float = 1.0,
    offset: float = 0.0,
    huber: float = 9.0,
    cutoff: float = 20.0,
) -> tuple[float, int, int, Array, Array]:
    H, g = np.full((8, 8), np.nan), np.full(8, np.nan)
    light = np.array([gain, offset])
    intrinsics = camera_intrinsics(CAMERA)
    return (*linearize(level_map, points, values, intrinsics, pose, light, huber, cutoff, H, g), H, g)


def ramp() -> Array:
    """A map that is linear in the pixel, so that its bilinear derivatives are exact; double precision."""
    rng = np.random.default_rng(1)
    slopes = rng.uniform(-3, 3, 2)
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
    value = u * slopes[0] + v * slopes[1] + rng.uniform(0, 50)
    return np.stack([value, np.full_like(value, slopes[0]), np.full_like(value, slopes[1])], axis=-1)


@pytest.mark.thorough
@pytest.mark.parametrize("huber", [1e6, 2.0])
def test_gradient_is_half_the_derivative_of_the_energy(huber: float) -> None:
    rng = np.random.default_rng(5)
    points = np.stack([rng.uniform(-0.3, 0.3, 40), rng.uniform(-0.3, 0.3, 40), rng.uniform(0.1, 0.5, 40)])
    values = rng.uniform(-50, 100, (40, 1))
    level_map, gain, offset = ramp(), 1.2, -4.0

    def energy(step: Array) -> float:
        pose = geometry.se3_exp(step[:6]) @ T
        return run(level_map, points, values, pose, gain * np.exp(step[6]), offset + step[7], huber, 1e9)[0]

    g = run(level_map, points, values, T, gain, offset, huber, 1e9)[4]
    for k in range(8):
        h = np.eye(8)[k] * 1e-5
        assert g[k] == pytest.approx((energy(h) - energy(-h)) / 4e-5, rel=1e-5, abs=1e-4)


def test_hessian_is_the_product_of_finite_difference_jacobians() -> None:
    point = np.array([[0.1], [-0.2], [0.4]])
    level_map, values = ramp(), np.random.default_rng(6).uniform(0, 20, (1, 1))

    def residual(step: Array) -> Array:
        moved = geometry.apply(geometry.se3_exp(step[:6]) @ T, np.array([[0.1, -0.2, 1.0]]) / 0.4)
        pixel = CAMERA.project(moved)[0][0]
        value = plain.bilinear(level_map, pixel[:1], pixel[1:])[0, :1]
        out: Array = value - (np.exp(step[6]) * values[0] + step[7])
        return out

    J = np.stack([(residual(h) - residual(-h)) / 2e-6 for h in 1e-6 * np.eye(8)], axis=-1)
    _, valid, _, H, g = run(level_map, point, values, T, huber=1e9, cutoff=1e9)
    assert valid == 1
    np.testing.assert_allclose(H, J.T @ J, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(g, J.T @ residual(np.zeros(8)), rtol=1e-6, atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.sampled_from([1, 7, BLOCK, BLOCK + 1, 3 * BLOCK - 5]),
    huber=st.floats(0.05, 3.0),
    ratio=st.floats(1.0, 10.0),
)
def test_agrees_with_plain_numpy(seed: int, count: int, huber: float, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(CAMERA.height, CAMERA.width, 1)).astype(np.float32)
    level = Level(with_gradients(image), CAMERA)
    geometry_ = np.stack(
        [rng.uniform(-0.8, 0.8, count), rng.uniform(-0.6, 0.6, count), rng.uniform(-0.2, 3.0, count)]
    ).astype(np.float32)
    values = rng.normal(size=(count, 1)).astype(np.float32)
    points = LevelPoints(geometry_, values, np.zeros((count, 2), dtype=np.int32))
    pose = geometry.se3_exp(rng.normal(size=6) * [0.1, 0.1, 0.3, 0.1, 0.1, 0.1])
    a, b = 0.2, -0.1

    slow = plain.linearize(level, points, pose, a, b, huber, huber * ratio)
    wide = level.map.astype(np.float64), geometry_.astype(np.float64), values.astype(np.float64)
    energy, valid, saturated, H, g = run(*wide, pose, np.exp(a), b, huber, huber * ratio)
    assert (valid, saturated) == (slow.valid, slow.saturated)
    if valid:
        assert energy == pytest.approx(slow.energy, rel=1e-9)
    np.testing.assert_allclose(H, slow.H, rtol=1e-8, atol=1e-8 * np.abs(slow.H).max(initial=1))
    np.testing.assert_allclose(g, slow.g, rtol=1e-8, atol=1e-8 * np.abs(slow.g).max(initial=1))

    single = run(level.map, geometry_, values, pose, np.exp(a), b, huber, huber * ratio)
    # Single precision may put a point on the other side of a border or of the cutoff, no more.
    assert abs(single[1] - valid) <= 2
    if (single[1], single[2]) == (valid, saturated) and valid:
        assert single[0] == pytest.approx(energy, rel=1e-3, abs=1e-6)
        np.testing.assert_allclose(single[3], H, atol=2e-3 * np.abs(H).max())


def test_points_out_of_view_are_not_counted_and_leave_no_trace() -> None:
    level_map = ramp()
    inside = np.array([[0.0], [0.0], [0.5]])
    # Out to the right, behind the camera, in the camera's plane, and with no inverse depth at all.
    dropped = np.array([[5.0, 0.0, 0.0, 0.1], [0.0, 0.0, 0.0, 0.1], [0.5, -2.0, -1 / T[2, 3], 0.0]])
    values = np.array([[30.0], [1e6], [1e6], [1e6], [1e6]])
    alone = run(level_map, inside, values[:1], T)
    together = run(level_map, np.concatenate([inside, dropped], axis=1), values, T)
    assert alone[1] == together[1] == 1
    assert alone[0] == together[0]
    np.testing.assert_array_equal(alone[3], together[3])


def test_pixels_must_lie_more_than_two_pixels_inside() -> None:
    def valid_at(px: float, py: float) -> int:
        x, y = (px - CAMERA.cx) / CAMERA.fx, (py - CAMERA.cy) / CAMERA.fy
        return run(ramp(), np.array([[x], [y], [1.0]]), np.zeros((1, 1)), np.eye(4))[1]

    right, bottom = CAMERA.width - 3, CAMERA.height - 3
    assert [valid_at(x, 30) for x in (1.99, 2.01, right - 0.01, right + 0.01)] == [0, 1, 1, 0]
    assert [valid_at(30, y) for y in (1.99, 2.01, bottom - 0.01, bottom + 0.01)] == [0, 1, 1, 0]


def test_a_saturated_residual_adds_a_constant_energy_and_pulls_at_nothing() -> None:
    level_map, point = ramp(), np.array([[0.0], [0.0], [0.5]])
    for value in (1e3, 1e5):
        energy, valid, saturated, H, g = run(level_map, point, np.array([[value]]), T)
        assert (energy, valid, saturated) == (2 * 9 * 20 - 81, 1, 1)
        assert not H.any()
        assert not g.any()


def test_without_a_point_in_view_the_energy_is_infinite() -> None:
    energy, valid, _, H, _ = run(ramp(), np.zeros((3, 0)), np.zeros((0, 1)), T)
    assert (energy, valid) == (np.inf, 0)
    assert not H.any()


def test_a_map_too_small_to_look_into_has_no_valid_point() -> None:
    tiny = np.zeros((5, 5, 3))
    assert run(tiny, np.array([[0.0], [0.0], [1.0]]), np.zeros((1, 1)), np.eye(4))[1] == 0


@given(st.lists(st.floats(-2, 2), min_size=6, max_size=6), st.sampled_from([1.0, 1e-2, 1e-4, 1e-9, 0.0]))
@settings(deadline=None)
def test_compiled_exponential_is_the_one_of_geometry(twist: list[float], scale: float) -> None:
    xi = scale * np.array(twist)
    found = np.full((4, 4), np.nan)
    se3_exp(xi, found)
    np.testing.assert_allclose(found, geometry.se3_exp(xi), atol=1e-13)


def test_cholesky_solves_and_refuses_what_is_not_positive_definite() -> None:
    rng = np.random.default_rng(8)
    root = rng.normal(size=(8, 8))
    A, b, room = root @ root.T, rng.normal(size=8), np.zeros((8, 8))
    for n in (6, 8):
        x = np.zeros(n)
        assert solve_cholesky(A, b, room, x)
        np.testing.assert_allclose(A[:n, :n] @ x, b[:n], atol=1e-9)
    assert not solve_cholesky(np.diag([1.0] * 5 + [0.0] * 3), b, room, x)
    assert not solve_cholesky(np.full((8, 8), np.nan), b, room, x)
