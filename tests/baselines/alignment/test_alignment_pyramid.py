"""The image pyramid: what a level shows, where its pixels are, what its gradients are."""

from __future__ import annotations

import numpy as np
import plain_alignment as plain
import pytest
from plain_alignment import bilinear
from refusals import refused

from baselines.alignment.shared.pyramid import image_pyramid, level_camera, with_gradients
from relocbench.errors import MethodError
from relocbench.geometry import Camera


def noise(height: int, width: int, *more: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (height, width, *more)).astype(np.uint8)


def camera(height: int, width: int) -> Camera:
    return Camera("pinhole", width, height, 300.0, 310.0, width / 2, height / 2 - 3)


@pytest.mark.parametrize(
    ("height", "width", "levels"),
    [(512, 512, 4), (400, 800, 4), (480, 640, 4), (370, 1226, 5), (70, 71, 1), (71, 71, 2), (7, 900, 2), (2, 3, 1)],
)
def test_levels_end_at_5000_pixels_whatever_the_size(height: int, width: int, levels: int) -> None:
    pyramid = image_pyramid(noise(height, width), camera(height, width))
    assert len(pyramid) == levels
    for number, level in enumerate(pyramid):
        assert level.map.shape == (height >> number, width >> number, 3)
        assert (level.camera.height, level.camera.width) == level.map.shape[:2]
        assert level.map.dtype == np.float32


def test_a_pixel_is_the_mean_of_the_four_below_and_sits_at_their_centre() -> None:
    image = noise(91, 121)
    fine, coarse = image_pyramid(image, camera(91, 121))[:2]
    np.testing.assert_allclose(coarse.map[10, 20, 0], image[20:22, 40:42].mean(), rtol=1e-6)
    ray, _ = coarse.camera.unproject([20, 10])
    pixel, _ = fine.camera.project(ray)
    np.testing.assert_allclose(pixel, [40.5, 20.5])


def test_level_intrinsics_follow_the_half_pixel_rule() -> None:
    scaled = level_camera(camera(480, 640), 3)
    assert scaled.fx == 300.0 / 8
    assert scaled.cx == pytest.approx((320 + 0.5) / 8 - 0.5)
    assert scaled.cy == pytest.approx((237 + 0.5) / 8 - 0.5)


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_gradients_are_halved_central_differences_and_zero_on_the_rim(channels: int) -> None:
    values = np.random.default_rng(2).normal(size=(9, 11, channels)).astype(np.float32)
    out = with_gradients(values)
    np.testing.assert_array_equal(out[..., :channels], values)
    dx, dy = out[..., channels : 2 * channels], out[..., 2 * channels :]
    np.testing.assert_array_equal(dx[1:-1, 1:-1], (values[1:-1, 2:] - values[1:-1, :-2]) / 2)
    np.testing.assert_array_equal(dy[1:-1, 1:-1], (values[2:, 1:-1] - values[:-2, 1:-1]) / 2)
    rim = np.ones((9, 11), dtype=bool)
    rim[1:-1, 1:-1] = False
    assert not dx[rim].any()
    assert not dy[rim].any()


def test_an_interpolated_gradient_is_the_central_difference_of_the_interpolated_image() -> None:
    level_map = with_gradients(noise(20, 20, 1).astype(np.float32))
    rng = np.random.default_rng(3)
    px, py = rng.uniform(3, 15, (2, 50))
    here = bilinear(level_map, px, py)
    right, left = bilinear(level_map, px + 1, py), bilinear(level_map, px - 1, py)
    np.testing.assert_allclose(here[:, 1], (right[:, 0] - left[:, 0]) / 2, atol=1e-4)


def test_colour_becomes_luma() -> None:
    image = noise(40, 50, 3)
    level = image_pyramid(image, camera(40, 50))[0]
    np.testing.assert_allclose(level.map[..., 0], image @ np.array([0.299, 0.587, 0.114]), atol=1e-3)


def test_the_plain_pyramid_is_the_same() -> None:
    image = noise(123, 217)
    for fast, slow in zip(
        image_pyramid(image, camera(123, 217)), plain.image_pyramid(image, camera(123, 217)), strict=True
    ):
        np.testing.assert_allclose(fast.map, slow.map, atol=1e-4)
        assert fast.camera == slow.camera


def test_a_distorted_camera_is_refused_by_name() -> None:
    distorted = Camera("radtan", 50, 40, 30, 30, 25, 20, (0.1, 0, 0, 0))
    with refused(MethodError, "", None, "pinhole", "radtan"):
        image_pyramid(noise(40, 50), distorted)


def test_an_image_of_another_size_than_its_camera_is_refused() -> None:
    with refused(MethodError, "", None, "40x50"):
        image_pyramid(noise(41, 50), camera(40, 50))
