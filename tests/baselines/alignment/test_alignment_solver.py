"""The coarse-to-fine solver on an analytic scene."""

from __future__ import annotations

import numpy as np
import plain_alignment as plain
import pytest
from alignment_scene import CAMERA, motion, render, to_image
from refusals import refused

from baselines.alignment.direct.settings import Settings
from baselines.alignment.direct.solver import align, align_best
from baselines.alignment.shared.depth_map import LevelPoints, coarse_points, sample_points
from baselines.alignment.shared.levenberg import CONVERGED
from baselines.alignment.shared.pyramid import Level, image_pyramid, level_camera, with_gradients
from baselines.alignment.shared.selection import select_pixels
from relocbench.arrays import Array
from relocbench.errors import MethodError
from relocbench.geometry import compose, invert, rotation_angle
from relocbench.tracking import KeyframePoints

MOTION = motion((0.25, -0.1, -0.4), (1.0, -2.0, 1.5))


@pytest.fixture(scope="module")
def reference() -> list[LevelPoints]:
    grey, depth = render(np.eye(4))
    levels = image_pyramid(to_image(grey), CAMERA)
    uv = select_pixels(levels, depth > 0, 1000, np.random.default_rng(0))
    inverse_depth = 1.0 / depth[uv[:, 1], uv[:, 0]].astype(np.float64)
    return coarse_points(KeyframePoints(uv.astype(float), inverse_depth, np.zeros(len(uv))), levels)


def query(T: Array, gain: float = 1.0, offset: float = 0.0) -> list[Level]:
    return image_pyramid(to_image(render(T)[0], gain, offset), CAMERA)


def error(T: Array, truth: Array) -> tuple[float, float]:
    delta = compose(T, invert(truth))
    centre = invert(T)[:3, 3] - invert(truth)[:3, 3]
    return float(np.linalg.norm(centre)), float(np.rad2deg(rotation_angle(delta[:3, :3])))


def test_the_pose_is_recovered_from_the_identity(reference: list[LevelPoints]) -> None:
    found = align(reference, query(MOTION), np.eye(4), Settings())
    metres, degrees = error(found.T_query_ref, MOTION)
    assert metres < 0.005
    assert degrees < 0.03
    assert not found.failure
    assert [outcome.level for outcome in found.outcomes] == [3, 2, 1, 0]
    assert found.final.end == CONVERGED
    assert found.final.valid <= found.points == len(reference[0])


def test_gain_and_offset_are_recovered_with_the_pose(reference: list[LevelPoints]) -> None:
    found = align(reference, query(MOTION, gain=0.8, offset=15), np.eye(4), Settings())
    metres, degrees = error(found.T_query_ref, MOTION)
    assert np.exp(found.a) == pytest.approx(0.8, abs=0.01)
    assert found.b == pytest.approx(15, abs=1.5)
    assert metres < 0.006
    assert degrees < 0.04


def test_without_affine_brightness_a_and_b_stay_zero(reference: list[LevelPoints]) -> None:
    found = align(reference, query(MOTION), np.eye(4), Settings(affine=False))
    assert (found.a, found.b) == (0.0, 0.0)
    assert error(found.T_query_ref, MOTION)[0] < 0.005


def test_compiled_and_plain_take_the_same_path(reference: list[LevelPoints]) -> None:
    levels = query(MOTION, 0.9, 5)
    fast = align(reference, levels, np.eye(4), Settings())
    T, a, b, iterations = plain.align(reference, levels, np.eye(4), Settings())
    np.testing.assert_allclose(fast.T_query_ref, T, atol=1e-4)
    assert fast.a == pytest.approx(a, abs=1e-4)
    assert fast.b == pytest.approx(b, abs=1e-2)
    assert abs(sum(iterations) - sum(outcome.iterations for outcome in fast.outcomes)) <= 3


def test_the_same_input_gives_the_same_bytes(reference: list[LevelPoints]) -> None:
    first, second = (align(reference, query(MOTION), np.eye(4), Settings()) for _ in range(2))
    assert first.T_query_ref.tobytes() == second.T_query_ref.tobytes()
    assert first.outcomes == second.outcomes


def test_the_cutoff_is_doubled_while_most_residuals_are_saturated(reference: list[LevelPoints]) -> None:
    found = align(reference, query(MOTION, 0.4, 120), np.eye(4), Settings(cutoff_levels=6))
    assert max(outcome.cutoff_factor for outcome in found.outcomes) > 1
    levels = [outcome.level for outcome in found.outcomes]
    assert levels[0] == levels[1]  # the level is repeated once with the base cutoff
    assert sorted(set(levels), reverse=True) == [3, 2, 1, 0]


def test_the_lowest_final_energy_wins_among_starts(reference: list[LevelPoints]) -> None:
    far = motion((1.0, 0, 0.5), (0, 8, 0))
    levels = query(MOTION)
    lost, best = align(reference, levels, far, Settings()), align_best(reference, levels, [far, MOTION], Settings())
    assert error(lost.T_query_ref, MOTION)[0] > 0.3
    assert error(best.T_query_ref, MOTION)[0] < 0.005
    assert error(align_best(reference, levels, [MOTION, far], Settings()).T_query_ref, MOTION)[0] < 0.005
    rival = align(reference, levels, MOTION, Settings())
    assert align(reference, levels, far, Settings(), rival).abandoned


def test_a_start_that_sees_nothing_is_a_stated_trouble(reference: list[LevelPoints]) -> None:
    behind = motion((0, 0, -100), (0, 0, 0))
    assert "no point falls into the query" in align(reference, query(MOTION), behind, Settings()).failure


def test_a_query_without_texture_is_a_stated_trouble(reference: list[LevelPoints]) -> None:
    blank = image_pyramid(np.full(CAMERA.size[::-1], 100, dtype=np.uint8), CAMERA)
    assert "singular" in align(reference, blank, np.eye(4), Settings()).failure


def test_a_cutoff_below_the_huber_threshold_is_refused() -> None:
    with refused(MethodError, "", None, "cutoff"):
        Settings(huber=9, cutoff=5)


def test_the_unit_of_the_values_is_free() -> None:
    """A function of the image with values near one, and thresholds to match."""

    def maps(grey: Array) -> list[Level]:
        values = np.tanh((grey[..., None] - 128) / 30).astype(np.float32)
        levels = []
        for number in range(4):
            levels.append(Level(with_gradients(values), level_camera(CAMERA, number)))
            height, width = values.shape[0] // 2 * 2, values.shape[1] // 2 * 2
            even = values[:height, :width]
            of_four = (even[::2, ::2] + even[::2, 1::2] + even[1::2, ::2] + even[1::2, 1::2]) / 4
            values = np.asarray(of_four, dtype=np.float32)
        return levels

    grey, depth = render(np.eye(4))
    levels = maps(grey)
    uv = np.random.default_rng(0).integers(5, [CAMERA.width - 5, CAMERA.height - 5], (800, 2))
    inverse_depth = 1.0 / depth[uv[:, 1], uv[:, 0]].astype(np.float64)
    points = coarse_points(KeyframePoints(uv.astype(float), inverse_depth, np.zeros(800)), levels)
    found = align(points, maps(render(MOTION)[0]), np.eye(4), Settings(huber=0.3, cutoff=2.0, affine=False))
    metres, degrees = error(found.T_query_ref, MOTION)
    assert metres < 0.005
    assert degrees < 0.03
    assert (found.a, found.b) == (0.0, 0.0)


def test_maps_of_several_channels_are_refused(reference: list[LevelPoints]) -> None:
    grey = np.zeros((*CAMERA.size[::-1], 4), np.float32)
    several = Level(with_gradients(grey), CAMERA)
    points = sample_points(np.array([[10, 20], [30, 7]]), np.array([0.5, 0.25]), several.map, CAMERA)
    with refused(MethodError, "", None, "channel"):
        align(reference, [several], np.eye(4), Settings())
    with refused(MethodError, "", None, "channel"):
        align([points], query(MOTION), np.eye(4), Settings())


def test_points_can_be_sampled_from_any_map() -> None:
    features = np.random.default_rng(0).normal(size=(*CAMERA.size[::-1], 3)).astype(np.float32)
    points = sample_points(np.array([[10, 20], [30, 7]]), np.array([0.5, 0.25]), with_gradients(features), CAMERA)
    np.testing.assert_array_equal(points.values, features[[20, 7], [10, 30]])
    assert points.points[:, 1] == pytest.approx([(30 - 158.0) / 260, (7 - 128.5) / 270, 0.25])
