"""The compiled normal equations on feature maps: finite differences, plain NumPy, the intensity kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numba.core.runtime._nrt_python as _nrt_python
import numpy as np
import plain_feature_alignment as plain
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.runtime import rtsys  # type: ignore[attr-defined]
from plain_alignment import bilinear

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.features.kernel import linearize_features, workspace_for
from baselines.alignment.features.pyramid import FeatureLevel
from baselines.alignment.features.reference import FeaturePoints
from baselines.alignment.features.solver import FeatureProblem
from baselines.alignment.shared.compiled import FloatArray
from baselines.alignment.shared.levenberg import (
    COUNT,
    ENERGY,
    NOT_FINITE_POINTS,
    SATURATED,
    SQUARES,
    STATISTICS,
    WEIGHT,
    minimise_level,
)
from baselines.alignment.shared.pyramid import camera_intrinsics, with_gradients
from baselines.alignment.shared.scratch import BLOCK
from relocbench import geometry
from relocbench.arrays import Array
from relocbench.geometry import Camera

CAMERA = Camera("pinhole", 80, 60, 70.0, 75.0, 39.0, 30.5)
T = geometry.se3_exp(np.array([0.05, -0.03, 0.1, 0.02, -0.01, 0.03]))


@dataclass(frozen=True, eq=False)
class Outcome:
    H: Array
    g: Array
    statistics: Array


def run(
    level_map: FloatArray,
    points: FloatArray,
    values: FloatArray,
    pose: Array,
    huber: float = 9.0,
    cutoff: float = 20.0,
    per_channel: bool = False,
    weights: FloatArray | None = None,
) -> Outcome:
    weights = np.ones(points.shape[1], points.dtype) if weights is None else weights
    H, g, statistics = np.full((6, 6), np.nan), np.full(6, np.nan), np.full(STATISTICS, np.nan)
    linearize_features(
        level_map,
        points,
        values,
        weights,
        camera_intrinsics(CAMERA),
        pose,
        huber,
        cutoff,
        per_channel,
        workspace_for(points),
        H,
        g,
        statistics,
    )
    return Outcome(H, g, statistics)


def ramps(channels: int) -> Array:
    """Maps that are linear in the pixel, so that their central differences are exact; double precision."""
    rng = np.random.default_rng(channels)
    slopes = rng.uniform(-3, 3, (2, channels))
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
    return np.asarray(u[..., None] * slopes[0] + v[..., None] * slopes[1] + rng.uniform(0, 50, channels))


@pytest.mark.thorough
@pytest.mark.parametrize("channels", [1, 4, 16])
@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("huber", [1e6, 2.0])
def test_gradient_is_half_the_derivative_of_the_energy(channels: int, per_channel: bool, huber: float) -> None:
    rng = np.random.default_rng(5)
    points = np.stack([rng.uniform(-0.3, 0.3, 40), rng.uniform(-0.3, 0.3, 40), rng.uniform(0.1, 0.5, 40)])
    values, weights = rng.uniform(-50, 100, (40, channels)), rng.uniform(0.5, 2, 40)
    level_map = ramps(channels)

    def energy(step: Array) -> float:
        pose = geometry.se3_exp(step) @ T
        return float(run(level_map, points, values, pose, huber, 1e9, per_channel, weights).statistics[ENERGY])

    g = run(level_map, points, values, T, huber, 1e9, per_channel, weights).g
    for k in range(6):
        h = np.eye(6)[k] * 1e-5
        assert g[k] == pytest.approx((energy(h) - energy(-h)) / 4e-5, rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("channels", [1, 4, 16])
def test_hessian_is_the_sum_of_products_of_finite_difference_jacobians(channels: int) -> None:
    point = np.array([[0.1], [-0.2], [0.4]])
    level_map, values = ramps(channels), np.random.default_rng(6).uniform(0, 20, (1, channels))

    def residual(step: Array) -> Array:
        moved = geometry.apply(geometry.se3_exp(step) @ T, np.array([[0.1, -0.2, 1.0]]) / 0.4)
        pixel = CAMERA.project(moved)[0][0]
        return np.asarray(bilinear(level_map, pixel[:1], pixel[1:])[0] - values[0])

    J = np.stack([(residual(h) - residual(-h)) / 2e-6 for h in 1e-6 * np.eye(6)], axis=-1)
    found = run(level_map, point, values, T, huber=1e9, cutoff=1e9)
    assert found.statistics[COUNT] == 1
    np.testing.assert_allclose(found.H, J.T @ J, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(found.g, J.T @ residual(np.zeros(6)), rtol=1e-6, atol=1e-5)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    channels=st.sampled_from([1, 2, 5, 16]),
    count=st.sampled_from([1, 7, BLOCK, BLOCK + 1, 3 * BLOCK - 5]),
    per_channel=st.booleans(),
    huber=st.floats(0.05, 3.0),
    ratio=st.floats(1.0, 10.0),
)
def test_agrees_with_plain_numpy_and_with_the_intensity_kernel(
    seed: int, channels: int, count: int, per_channel: bool, huber: float, ratio: float
) -> None:
    rng = np.random.default_rng(seed)
    level = FeatureLevel(rng.normal(size=(CAMERA.height, CAMERA.width, channels)).astype(np.float32), CAMERA)
    places = np.stack([rng.uniform(-0.8, 0.8, count), rng.uniform(-0.6, 0.6, count), rng.uniform(-0.2, 3.0, count)])
    values, weights = rng.normal(size=(count, channels)), rng.uniform(0.2, 5, count)
    points = FeaturePoints(places.astype(np.float32), values.astype(np.float32), weights.astype(np.float32))
    pose = geometry.se3_exp(rng.normal(size=6) * [0.1, 0.1, 0.3, 0.1, 0.1, 0.1])
    wide_map, wide_points = level.map.astype(np.float64), points.points.astype(np.float64)
    wide_values, wide_weights = points.values.astype(np.float64), points.weights.astype(np.float64)

    slow = plain.linearize(level, points, pose, huber, huber * ratio, per_channel)
    found = run(wide_map, wide_points, wide_values, pose, huber, huber * ratio, per_channel, wide_weights)
    statistics = found.statistics
    assert (statistics[COUNT], statistics[SATURATED], statistics[NOT_FINITE_POINTS]) == (slow.valid, slow.saturated, 0)
    if slow.valid:
        assert statistics[ENERGY] == pytest.approx(slow.energy, rel=1e-9)
    assert statistics[WEIGHT] == pytest.approx(slow.weight, rel=1e-9)
    assert statistics[SQUARES] == pytest.approx(slow.squares, rel=1e-9, abs=1e-12)
    np.testing.assert_allclose(found.H, slow.H, rtol=1e-8, atol=1e-8 * np.abs(slow.H).max(initial=1))
    np.testing.assert_allclose(found.g, slow.g, rtol=1e-8, atol=1e-8 * np.abs(slow.g).max(initial=1))

    if channels == 1:  # the intensity kernel knows no weights, and has its gradients stored
        alike = run(wide_map, wide_points, wide_values, pose, huber, huber * ratio, per_channel)
        H, g = np.zeros((8, 8)), np.zeros(8)
        stored, light = with_gradients(level.map).astype(np.float64), np.array([1.0, 0.0])
        arrays = (stored, wide_points, wide_values, camera_intrinsics(CAMERA), pose, light)
        energy, valid, saturated = linearize(*arrays, huber, huber * ratio, H, g)
        assert (alike.statistics[COUNT], alike.statistics[SATURATED]) == (valid, saturated)
        if valid:
            assert alike.statistics[ENERGY] == pytest.approx(energy, rel=1e-6)
        np.testing.assert_allclose(alike.H, H[:6, :6], atol=1e-5 * np.abs(H[:6, :6]).max(initial=1))
        np.testing.assert_allclose(alike.g, g[:6], atol=1e-5 * np.abs(g[:6]).max(initial=1))

    single = run(level.map, points.points, points.values, pose, huber, huber * ratio, per_channel, points.weights)
    # Single precision may put a point on the other side of a border or of the cutoff, no more.
    assert abs(single.statistics[COUNT] - slow.valid) <= 2 * channels
    if (single.statistics[COUNT], single.statistics[SATURATED]) == (slow.valid, slow.saturated) and slow.valid:
        assert single.statistics[ENERGY] == pytest.approx(slow.energy, rel=1e-3, abs=1e-6)
        np.testing.assert_allclose(single.H, slow.H, atol=2e-3 * np.abs(slow.H).max())


@pytest.mark.parametrize("per_channel", [False, True])
def test_a_point_of_weight_two_counts_as_two_points(per_channel: bool) -> None:
    rng = np.random.default_rng(2)
    points = np.stack([rng.uniform(-0.2, 0.2, 9), rng.uniform(-0.2, 0.2, 9), rng.uniform(0.1, 0.5, 9)])
    values, weights = rng.uniform(0, 50, (9, 3)), np.ones(9)
    weights[4] = 2
    twice = [0, 1, 2, 3, 4, 4, 5, 6, 7, 8]
    heavy = run(ramps(3), points, values, T, 9, 60, per_channel, weights)
    doubled = run(ramps(3), np.ascontiguousarray(points[:, twice]), values[twice], T, 9, 60, per_channel)
    assert heavy.statistics[ENERGY] == pytest.approx(doubled.statistics[ENERGY])
    np.testing.assert_allclose(heavy.H, doubled.H)
    np.testing.assert_allclose(heavy.g, doubled.g)


def test_nothing_in_view_and_maps_too_small_give_an_infinite_energy() -> None:
    none = run(ramps(2), np.zeros((3, 0)), np.zeros((0, 2)), T)
    tiny = run(np.zeros((5, 5, 2)), np.array([[0.0], [0.0], [1.0]]), np.zeros((1, 2)), np.eye(4))
    for found in (none, tiny):
        assert (found.statistics[ENERGY], found.statistics[COUNT]) == (np.inf, 0)
        assert not found.H.any()


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("offset", [(0, 0), (0, 2), (-1, 0), (2, 1), (1, -1)])
def test_a_point_that_reads_a_number_that_is_not_finite_is_told(
    per_channel: bool, bad: float, offset: tuple[int, int]
) -> None:
    points = np.array([[0.0, 0.2], [0.0, 0.2], [1.0, 1.0]])  # the first falls onto u = 39, v = 30.5
    level_map = ramps(3)
    level_map[30 + offset[0], 39 + offset[1], 1] = bad
    pose = geometry.se3_exp(np.array([0.01, 0, 0, 0, 0, 0]))
    found = run(level_map, points, np.zeros((2, 3)), pose, 9, 1e6, per_channel)
    assert found.statistics[NOT_FINITE_POINTS] == 1


@pytest.mark.thorough
def test_iterating_allocates_nothing() -> None:
    rng = np.random.default_rng(0)
    level_map = rng.normal(size=(60, 80, 4)).astype(np.float32)
    points = np.stack([rng.uniform(-0.4, 0.4, 300), rng.uniform(-0.3, 0.3, 300), np.full(300, 0.3)]).astype(np.float32)
    values, weights = rng.normal(size=(300, 4)).astype(np.float32), np.ones(300, np.float32)

    def allocations(iterations: int) -> tuple[int, int]:
        before = rtsys.get_allocation_stats().alloc
        schedule = (0.01, 0.5, 4.0, 0.001, 0.001, 0.0)  # never small enough a step
        arrays = (level_map, points, values, weights, camera_intrinsics(CAMERA))
        problem = FeatureProblem(*arrays, 1.0, False, workspace_for(points))
        used = minimise_level(problem, np.eye(4), np.zeros(2), (6, 6), 9.0, iterations, schedule)[4]
        return used, rtsys.get_allocation_stats().alloc - before

    _nrt_python.memsys_enable_stats()
    allocations(1)
    (few, first), (many, second) = allocations(1), allocations(40)
    _nrt_python.memsys_disable_stats()
    assert (few, many) == (1, 40)
    assert first == second > 0
