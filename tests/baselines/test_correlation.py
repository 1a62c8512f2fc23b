"""Keyframe and query look alike around the keyframe's points at the true pose, whatever the exposure and the camera."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.correlation import LARGEST_COUNT, GreyImage, correlations, strong_pixels
from relocbench.arrays import Array
from relocbench.geometry import Camera, make_transform, so3_exp

PINHOLE = Camera("pinhole", 160, 120, 100.0, 100.0, 79.5, 59.5)
RADTAN = Camera("radtan", 160, 120, 100.0, 100.0, 79.5, 59.5, (-0.2, 0.03, 0.0, 0.0))
DEPTH = 5.0


def wall(camera: Camera, T_cam_world: Array, gain: float = 1.0, offset: float = 0.0) -> GreyImage:
    """A textured wall at z = 5 m of the world, as a camera sees it that stays parallel to it."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays, _ = camera.unproject(np.stack([u, v], axis=-1))
    points = rays * (DEPTH - np.linalg.inv(T_cam_world)[2, 3]) + np.linalg.inv(T_cam_world)[:3, 3]
    x, y = points[..., 0], points[..., 1]
    grey = 128 + 40 * np.sin(9 * x + 2 * np.sin(3 * y)) + 40 * np.cos(8 * y + np.sin(4 * x))
    return GreyImage((gain * grey + offset).astype(np.float32), camera)


def pixels(camera: Camera) -> Array:
    v, u = np.mgrid[20 : camera.height - 20 : 5, 20 : camera.width - 20 : 5].astype(np.float64)
    return np.stack([u.ravel(), v.ravel()], axis=-1)


@pytest.mark.parametrize("camera", [PINHOLE, RADTAN])
def test_the_true_pose_looks_alike_and_others_do_not(camera: Camera) -> None:
    T_query_ref = make_transform(np.eye(3), [0.15, -0.1, 0.2])
    reference, query = wall(camera, np.eye(4)), wall(camera, T_query_ref, gain=0.4, offset=60.0)
    uv = pixels(camera)
    depth = np.full(len(uv), DEPTH)
    right = correlations(T_query_ref, uv, depth, reference, query)
    assert np.median(right) > 0.98
    wrong = make_transform(so3_exp([0.0, 0.0, 0.0]), [0.45, -0.1, 0.2])
    assert np.mean(correlations(wrong, uv, depth, reference, query)) < np.mean(right) - 0.5


def test_what_leaves_the_view_or_has_no_contrast_counts_as_different() -> None:
    reference, uv = wall(PINHOLE, np.eye(4)), pixels(PINHOLE)
    depth = np.full(len(uv), DEPTH)
    behind = make_transform(np.eye(3), [0.0, 0.0, -20.0])
    assert not correlations(behind, uv, depth, reference, reference).any()
    flat = GreyImage(np.full((120, 160), 90.0, np.float32), PINHOLE)
    assert not correlations(np.eye(4), uv, depth, reference, flat).any()
    assert not correlations(np.eye(4), np.array([[159.0, 119.0]]), np.array([DEPTH]), reference, reference).any()


def test_at_most_so_many_points_are_looked_at() -> None:
    reference = wall(PINHOLE, np.eye(4))
    uv = np.repeat(pixels(PINHOLE), 4, axis=0)
    found = correlations(np.eye(4), uv, np.full(len(uv), DEPTH), reference, reference)
    assert len(uv) > LARGEST_COUNT == len(found)
    np.testing.assert_allclose(found, 1.0)


def test_an_image_at_half_its_size_shows_what_the_whole_one_does() -> None:
    whole = wall(PINHOLE, np.eye(4))
    half = GreyImage.half_of(whole.values.astype(np.uint8), PINHOLE)
    assert half.values.shape == (60, 80)
    uv, depth = (pixels(PINHOLE) + 0.5) / 2 - 0.5, np.full(len(pixels(PINHOLE)), DEPTH)
    T_query_ref = make_transform(np.eye(3), [0.15, -0.1, 0.2])
    moved = GreyImage.half_of(wall(PINHOLE, T_query_ref).values.astype(np.uint8), PINHOLE)
    assert np.median(correlations(T_query_ref, uv, depth, half, moved)) > 0.9


def test_each_cell_gives_its_pixel_of_the_largest_gradient() -> None:
    values = np.full((21, 30), 50.0, np.float32)
    values[3, 5] = 200.0  # the gradient is largest beside it
    values[12:, 17:] = 90.0
    found = strong_pixels(GreyImage(values, PINHOLE))
    assert found[0].tolist() in ([5.0, 2.0], [4.0, 3.0], [6.0, 3.0], [5.0, 4.0])
    cells = [tuple(cell) for cell in (found // 8).astype(int).tolist()]
    assert cells == [(0, 0), (2, 1)]
    assert len(strong_pixels(GreyImage(np.zeros((40, 40), np.float32), PINHOLE))) == 0
