"""Which pixels are chosen, and the depth that each pyramid level gets of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from alignment_scene import CAMERA, render, to_image

from baselines.alignment.shared.depth_map import (
    DIAGONAL,
    STRAIGHT,
    InverseDepthSums,
    coarse_points,
    dilate,
    halve_sums,
    splat,
)
from baselines.alignment.shared.pyramid import image_pyramid
from baselines.alignment.shared.selection import block_thresholds, choose_points, select_pixels
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints, Reference


def keyframe_points(*rows: tuple[float, float, float, float]) -> KeyframePoints:
    values = np.array(rows, dtype=np.float64)
    return KeyframePoints(values[:, :2], values[:, 2], values[:, 3])


def textured(height: int = 300, width: int = 400) -> list[Any]:
    noise = np.random.default_rng(1).integers(0, 256, (height, width)).astype(np.uint8)
    return image_pyramid(noise, Camera("pinhole", width, height, 300, 300, width / 2, height / 2))


@pytest.mark.parametrize("wanted", [50, 500, 2000])
def test_about_as_many_pixels_as_wanted_spread_over_the_image(wanted: int) -> None:
    levels = textured()
    uv = select_pixels(levels, np.ones((300, 400), dtype=bool), wanted, np.random.default_rng(0))
    assert 0.8 * wanted <= len(uv) <= wanted
    assert len(np.unique(uv, axis=0)) == len(uv)
    quarters, _, _ = np.histogram2d(uv[:, 0], uv[:, 1], bins=2, range=[[0, 400], [0, 300]])
    assert quarters.min() > 0.5 * len(uv) / 4


def test_only_candidates_are_chosen_and_never_near_the_border() -> None:
    candidates = np.random.default_rng(2).uniform(size=(300, 400)) < 0.05
    uv = select_pixels(textured(), candidates, 400, np.random.default_rng(0))
    assert len(uv) > 300
    assert candidates[uv[:, 1], uv[:, 0]].all()
    assert uv.min() >= 4
    assert (uv.max(axis=0) < [396, 296]).all()


def test_pixels_lie_where_the_gradient_is() -> None:
    grey, _ = render(np.eye(4))
    levels = image_pyramid(to_image(grey), CAMERA)
    uv = select_pixels(levels, np.ones(grey.shape, dtype=bool), 300, np.random.default_rng(0))
    strength = np.hypot(levels[0].map[..., 1], levels[0].map[..., 2])
    assert np.median(strength[uv[:, 1], uv[:, 0]]) > 1.5 * np.median(strength)


def test_of_a_scan_those_points_are_chosen_that_lie_where_the_gradient_is() -> None:
    grey, _ = render(np.eye(4))
    rng = np.random.default_rng(3)
    width, height = CAMERA.size
    uv = rng.uniform(-0.4, [width - 0.6, height - 0.6], (20_000, 2))
    scan = KeyframePoints(uv, rng.uniform(0.1, 1.0, 20_000), np.full(20_000, 0.01))
    reference = Reference("scan", 0, to_image(grey), CAMERA, sparse_points=scan)
    levels = image_pyramid(reference.image, CAMERA)
    chosen = choose_points(reference, levels, 500, np.random.default_rng(0))
    rows = [np.flatnonzero((scan.uv == each).all(axis=1)) for each in chosen.uv]
    assert len(np.unique(np.concatenate(rows))) == len(chosen) == 500
    np.testing.assert_array_equal(chosen.inverse_depth, scan.inverse_depth[np.concatenate(rows)])
    strength = np.hypot(levels[0].map[..., 1], levels[0].map[..., 2])

    def median_at(points: KeyframePoints) -> float:
        return float(np.median(strength[tuple(np.rint(points.uv[:, ::-1]).astype(int).T)]))

    assert median_at(chosen) > 1.5 * median_at(scan)


def test_of_several_points_of_a_scan_at_one_pixel_the_nearest_may_be_chosen() -> None:
    grey, _ = render(np.eye(4))
    v, u = (side.ravel().astype(float) for side in np.mgrid[10:60, 10:60])
    twice = np.concatenate([np.stack([u, v], axis=-1)] * 2)
    for first, second in ((0.5, 0.1), (0.1, 0.5)):
        inverse_depth = np.repeat([first, second], len(u))
        scan = KeyframePoints(twice, inverse_depth, np.full(2 * len(u), 0.01))
        reference = Reference("twice", 0, to_image(grey), CAMERA, sparse_points=scan)
        chosen = choose_points(reference, image_pyramid(reference.image, CAMERA), 30, np.random.default_rng(0))
        assert np.all(chosen.inverse_depth == 0.5)


def test_points_outside_the_image_and_without_gradient_are_chosen_where_there_are_no_others() -> None:
    rng = np.random.default_rng(4)
    scan = KeyframePoints(rng.uniform(-50, 300, (900, 2)), np.full(900, 0.2), np.full(900, 0.01))
    blank = Reference("blank", 0, np.full(CAMERA.size[::-1], 90, dtype=np.uint8), CAMERA, sparse_points=scan)
    chosen = choose_points(blank, image_pyramid(blank.image, CAMERA), 300, np.random.default_rng(0))
    assert len(np.unique(chosen.uv, axis=0)) == 300
    assert choose_points(blank, image_pyramid(blank.image, CAMERA), 900, np.random.default_rng(0)) is scan


def test_a_blank_image_gives_no_point() -> None:
    levels = image_pyramid(np.full(CAMERA.size[::-1], 90, dtype=np.uint8), CAMERA)
    assert len(select_pixels(levels, np.ones(CAMERA.size[::-1], dtype=bool), 100, np.random.default_rng(0))) == 0


def test_the_choice_is_the_seed_s() -> None:
    def chosen(seed: int) -> bytes:
        mask = np.ones((300, 400), dtype=bool)
        return select_pixels(textured(), mask, 700, np.random.default_rng(seed)).tobytes()

    assert chosen(4) == chosen(4)
    assert chosen(4) != chosen(5)


def test_threshold_is_the_block_median_plus_seven_over_three_by_three_blocks() -> None:
    magnitude = np.zeros((100, 96), dtype=np.float32)
    magnitude[32:64, 32:64] = 18.5  # the middle one of 3x3 blocks; four rows are left over at the bottom
    thresholds = block_thresholds(magnitude)
    assert thresholds.shape == (3, 3)
    assert thresholds[1, 1] == pytest.approx(7 + 18 / 9)
    assert thresholds[0, 0] == pytest.approx(7 + 18 / 4)
    assert thresholds[0, 1] == pytest.approx(7 + 18 / 6)


def test_points_of_one_pixel_are_averaged_by_their_certainty() -> None:
    sums = splat(keyframe_points((3.4, 5, 0.1, 0.01), (2.6, 4.6, 0.2, 0.02), (50, 5, 0.3, 0.01)), 20, 10)
    assert np.argwhere(sums.weight > 0).tolist() == [[5, 3]]
    assert sums.weighted[5, 3] / sums.weight[5, 3] == pytest.approx((0.1 * 2 + 0.2) / 3)
    assert sums.weight[5, 3] == pytest.approx(np.sqrt(1e-3) * (100 + 50))


def test_without_any_sigma_all_points_weigh_the_same() -> None:
    sums = splat(keyframe_points((3, 5, 0.1, 0), (3, 5, 0.2, 0)), 20, 10)
    assert sums.weighted[5, 3] / sums.weight[5, 3] == pytest.approx(0.15)


def test_halving_sums_both_sums() -> None:
    rng = np.random.default_rng(0)
    sums = InverseDepthSums(rng.uniform(size=(6, 8)), rng.uniform(size=(6, 8)))
    half = halve_sums(sums)
    assert half.weight.sum() == pytest.approx(sums.weight.sum())
    assert half.weighted[2, 3] == pytest.approx(sums.weighted[4:6, 6:8].sum())
    odd = halve_sums(InverseDepthSums(sums.weighted[:5, :7], sums.weight[:5, :7]))
    assert odd.weight.shape == (2, 3)


def test_dilation_fills_empty_pixels_only_from_the_neighbours_it_names() -> None:
    sums = splat(keyframe_points((4, 4, 0.1, 0), (6, 4, 0.3, 0), (5, 4, 0.7, 0)), 12, 9)
    diagonal, straight = dilate(sums, DIAGONAL), dilate(sums, STRAIGHT)
    assert diagonal.weighted[4, 5] / diagonal.weight[4, 5] == pytest.approx(0.7)
    assert diagonal.weighted[3, 5] / diagonal.weight[3, 5] == pytest.approx(0.2)
    assert (diagonal.weight > 0).sum() == 3 + 5 * 2
    assert straight.weighted[3, 5] / straight.weight[3, 5] == pytest.approx(0.7)
    assert (straight.weight > 0).sum() == 3 + 3 * 2 + 2


def test_every_level_keeps_the_depth_of_a_plane() -> None:
    image = to_image(render(np.eye(4))[0])
    rng = np.random.default_rng(3)
    uv = np.stack([rng.integers(0, CAMERA.width, 600), rng.integers(0, CAMERA.height, 600)], axis=-1).astype(float)
    levels = image_pyramid(image, CAMERA)
    points = coarse_points(KeyframePoints(uv, np.full(600, 0.125), np.zeros(600)), levels)
    assert len(points) == len(levels) == 4
    for level, mine in zip(levels, points, strict=True):
        assert len(mine) > 100
        np.testing.assert_allclose(mine.points[2], 0.125, rtol=1e-6)
        u, v = mine.uv.T
        assert u.min() >= 2
        assert v.min() >= 2
        assert u.max() < level.camera.width - 2
        assert v.max() < level.camera.height - 2
        np.testing.assert_array_equal(mine.values[:, 0], level.map[v, u, 0])
        rays, _ = level.camera.unproject(mine.uv)
        np.testing.assert_allclose(mine.points[:2].T, rays[:, :2], atol=1e-6)
