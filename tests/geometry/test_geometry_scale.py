"""Properties of metric scale: what is found of random scenes, with noise and outliers, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relocbench.arrays import Array
from relocbench.geometry import Camera, Scale, ScaleError, depth_scale, so3_exp, translation_scale

PINHOLE = Camera("pinhole", 640, 480, 500.0, 510.0, 320.0, 238.0)
RADTAN = Camera("radtan", 640, 480, 500.0, 510.0, 320.0, 238.0, (-0.25, 0.08, 0.001, -0.0005, 0.01))
FISHEYE = Camera("equidistant", 640, 480, 250.0, 252.0, 320.0, 238.0, (-0.02, 0.004, -0.001, 0.0002))
CAMERAS = st.sampled_from([PINHOLE, RADTAN, FISHEYE])
SEEDS = st.integers(0, 2**32 - 1)
LENGTHS = st.floats(0.2, 3.0)


def scene(seed: int, camera: Camera, length: float, count: int = 200) -> tuple[Array, Array, Array, Array]:
    """Points (N, 3) of a keyframe, where a query sees them (N, 2), its rotation (3, 3) and translation (3,)."""
    rng = np.random.default_rng(seed)
    rotation = so3_exp(rng.normal(scale=0.1, size=3))
    translation = rng.normal(size=3)
    translation *= length / np.linalg.norm(translation)
    pixels = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], size=(count, 2))
    rays, _ = camera.unproject(pixels)
    in_query = rays * rng.uniform(4.0, 30.0, size=(count, 1))
    return (in_query - translation) @ rotation, pixels, rotation, translation


@given(SEEDS, CAMERAS, LENGTHS, st.floats(0.01, 100))
def test_exact_matches_give_the_exact_length(seed: int, camera: Camera, length: float, unit: float) -> None:
    points, pixels, rotation, translation = scene(seed, camera, length)
    found = translation_scale(points, pixels, camera, rotation, translation / unit)
    assert found.value == pytest.approx(unit, rel=1e-6)
    assert found.inliers.all()
    assert found.spread < 1e-3


@given(SEEDS, CAMERAS, LENGTHS)
def test_a_third_of_wrong_matches_and_noisy_pixels_leave_the_length(seed: int, camera: Camera, length: float) -> None:
    points, pixels, rotation, translation = scene(seed, camera, length)
    rng = np.random.default_rng(seed)
    wrong = rng.random(len(pixels)) < 1 / 3
    noisy = pixels + rng.normal(scale=1.0, size=pixels.shape)
    noisy[wrong] = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], size=(int(wrong.sum()), 2))
    found = translation_scale(points, noisy, camera, rotation, translation / length)
    assert abs(found.value - length) < max(6 * found.sigma, 0.05), (found.value, found.sigma)
    assert found.inliers[~wrong].mean() > 0.9
    assert found.inliers[wrong].mean() < 0.25
    assert 0.5 < found.spread < 3


def test_the_standard_error_is_that_of_repeated_estimates() -> None:
    found, points = [], scene(0, PINHOLE, 1.0)
    for seed in range(200):
        noisy = points[1] + np.random.default_rng(seed).normal(scale=0.7, size=points[1].shape)
        found.append(translation_scale(points[0], noisy, PINHOLE, points[2], points[3]))
    seen = np.std([each.value for each in found])
    assert seen == pytest.approx(np.mean([each.sigma for each in found]), rel=0.15)
    assert np.mean([each.value for each in found]) == pytest.approx(1.0, abs=3 * seen / np.sqrt(200))
    assert np.mean([each.spread for each in found]) == pytest.approx(0.7, rel=0.05)


@given(SEEDS, LENGTHS)
def test_matches_without_depth_or_pixel_do_not_count(seed: int, length: float) -> None:
    points, pixels, rotation, translation = scene(seed, PINHOLE, length)
    points[:40], pixels[40:80] = np.nan, np.nan
    found = translation_scale(points, pixels, PINHOLE, rotation, translation)
    assert found.value == pytest.approx(1.0, rel=1e-6)
    assert found.inliers.tolist() == [False] * 80 + [True] * 120


@given(SEEDS)
def test_a_query_at_the_keyframes_place_has_a_translation_of_no_length(seed: int) -> None:
    points, pixels, rotation, _ = scene(seed, PINHOLE, 1e-9)
    noisy = pixels + np.random.default_rng(seed).normal(scale=0.5, size=pixels.shape)
    found = translation_scale(points, noisy, PINHOLE, rotation, [0.0, 0.6, 0.8])
    assert 0 <= found.value < 5 * found.sigma < 0.1


def test_without_depth_the_fault_says_so() -> None:
    points, pixels, rotation, translation = scene(1, PINHOLE, 1.0)
    with pytest.raises(ScaleError, match=r"\b4\b.*\b5\b"):
        translation_scale(np.where(np.arange(200)[:, None] < 4, points, np.nan), pixels, PINHOLE, rotation, translation)
    with pytest.raises(ScaleError, match=r"\b0\b.*\b5\b"):
        translation_scale(np.zeros((0, 3)), np.zeros((0, 2)), PINHOLE, rotation, translation)
    with pytest.raises(ScaleError, match=r"\b2\b.*\b5\b"):
        depth_scale([1, 2, 0, 4, np.nan, -1, 3], [1, 2, 3, 0, 5, 6, np.inf])


def test_without_parallax_the_fault_says_so() -> None:
    _, pixels, rotation, translation = scene(2, PINHOLE, 1.0)
    far = pixels + np.random.default_rng(0).normal(scale=1.0, size=pixels.shape)
    rays, _ = PINHOLE.unproject(pixels)
    with pytest.raises(ScaleError, match="parallax"):
        translation_scale(1e5 * rays @ rotation, far, PINHOLE, rotation, translation)
    ahead = np.column_stack([np.zeros(9), np.zeros(9), np.arange(3.0, 12.0)])
    centre = np.tile([PINHOLE.cx, PINHOLE.cy], (9, 1))
    with pytest.raises(ScaleError, match="parallax"):
        translation_scale(ahead, centre, PINHOLE, np.eye(3), [0, 0, -1.0])


@given(SEEDS, LENGTHS)
def test_a_translation_that_is_the_other_way_round_is_told(seed: int, length: float) -> None:
    points, pixels, rotation, translation = scene(seed, PINHOLE, length)
    with pytest.raises(ScaleError, match="translation"):
        translation_scale(points, pixels, PINHOLE, rotation, -translation)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"direction": [0.0, 0.0, 0.0]}, "direction"),
        ({"direction": [np.nan, 0.0, 1.0]}, "direction"),
        ({"rotation": np.eye(4)}, "rotation"),
        ({"pixels": np.zeros((7, 2))}, "pixels"),
    ],
)
def test_impossible_arguments_are_named(change: dict[str, object], name: str) -> None:
    points, pixels, rotation, translation = scene(3, PINHOLE, 1.0)
    given_: dict[str, object] = {"pixels": pixels, "rotation": rotation, "direction": translation, **change}
    with pytest.raises(ValueError, match=name) as caught:
        translation_scale(points, camera=PINHOLE, **given_)  # type: ignore[arg-type]
    assert not isinstance(caught.value, ScaleError)


@given(SEEDS, st.floats(0.01, 100))
def test_the_scale_of_depth_bears_noise_and_wrong_values(seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(2, 80, size=400)
    model = depth / unit * np.exp(rng.normal(scale=0.05, size=400))
    wrong = rng.random(400) < 0.25
    model[wrong] *= rng.uniform(0.1, 10, size=int(wrong.sum()))
    depth[:20], model[20:40] = 0.0, np.nan
    found = depth_scale(depth, model)
    assert found.value == pytest.approx(unit, rel=0.04)
    assert not found.inliers[:40].any()
    assert found.inliers[40:][~wrong[40:]].mean() > 0.95


def test_depths_that_are_known_better_weigh_more() -> None:
    rng = np.random.default_rng(0)
    sigma = np.where(np.arange(400) < 100, 0.01, 0.5)

    def estimates(weighted: bool) -> list[Scale]:
        out = []
        for _ in range(100):
            depth = 7.0 * np.exp(rng.normal(scale=sigma))
            out.append(depth_scale(depth, np.ones(400), sigma if weighted else None))
        return out

    weighted, plain = (np.std([each.value for each in estimates(weight)]) for weight in (True, False))
    assert weighted < plain / 1.8
    with pytest.raises(ValueError, match="relative_sigma"):
        depth_scale(np.ones(9), np.ones(9), np.zeros(9))
