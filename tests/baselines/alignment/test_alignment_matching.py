"""Gauss-Newton on single pixels: known shifts, its basin, feature maps, brightness, and when there is no answer."""

from __future__ import annotations

import numpy as np
import pytest
from pixel_views import CAMERA, HEIGHT, INTENSITY, WIDTH, levels, offsets, pixels, share_found, view

from baselines.alignment.matching import DSO_PATTERN, SINGLE_PIXEL, MatchSettings, match_pixels
from baselines.alignment.shared.pyramid import image_pyramid
from baselines.dso import Dso
from relocbench.tracking import Query, Reference, SupportsMatching


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.37, -0.61), (-3.25, 2.5)])
def test_a_known_shift_is_found_to_a_fraction_of_a_pixel(shift: tuple[float, float]) -> None:
    uv = pixels()
    end = match_pixels(levels(view()), levels(view(shift)), uv, uv, INTENSITY)
    # Where the pattern sees next to one direction only the pixel is uncertain; nine of ten are not.
    assert share_found(end, uv + shift, 0.1) > 0.9
    # Between pixels the look-up is bilinear, which the waves are not.
    assert np.nanmedian(np.linalg.norm(end - uv - shift, axis=-1)) < 0.05


def test_the_share_found_falls_with_the_offset_and_ends_beyond_the_basin() -> None:
    uv, reference, query = pixels(), levels(view()), levels(view((1.5, 0.75)))
    truth = uv + np.array([1.5, 0.75])
    shares = [
        share_found(match_pixels(reference, query, uv, truth + offsets(len(uv), px), INTENSITY), truth, 1.0)
        for px in (1, 4, 16, 60)
    ]
    assert shares[0] > 0.9
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < 0.1


def test_coarse_levels_widen_the_basin() -> None:
    uv, reference, query = pixels(), levels(view()), levels(view())
    start = uv + offsets(len(uv), 8)
    one = share_found(match_pixels(reference[:1], query[:1], uv, start, INTENSITY), uv, 1.0)
    all_of_them = share_found(match_pixels(reference, query, uv, start, INTENSITY), uv, 1.0)
    assert one < 0.5 * all_of_them


@pytest.mark.thorough
def test_four_feature_channels_place_a_single_pixel() -> None:
    uv, shift = pixels(), (-1.3, 2.2)
    reference, query = (levels(*(view(s, seed) for seed in range(4))) for s in ((0.0, 0.0), shift))
    end = match_pixels(reference, query, uv, uv, MatchSettings(SINGLE_PIXEL))
    # By one pixel's four numbers alone, over waves of 9 px and more: some slopes lead elsewhere.
    assert share_found(end, uv + shift, 0.1) > 0.75


def test_one_step_on_features_is_the_formula() -> None:
    """x - (J^T J + eps I)^-1 J^T r at a pixel centre, where bilinear look-up is the map itself."""
    reference, query = (
        levels(*(view((0.0, 0.0), s) for s in range(3)))[:1],
        levels(*(view((0.4, 0.2), s) for s in range(3)))[:1],
    )
    u = np.array([[100.0, 80.0]])
    at = query[0].map[80, 100].astype(np.float64)
    r, J = at[:3] - reference[0].map[80, 100, :3], np.stack([at[3:6], at[6:9]], axis=-1)
    H = J.T @ J
    expected = u[0] - np.linalg.solve(H + 0.03 * np.trace(H) / 2 * np.eye(2), J.T @ r)
    end = match_pixels(reference, query, u, u, MatchSettings(damping=0.03, iterations=1, longest_step=100.0))
    np.testing.assert_allclose(end[0], expected, atol=1e-9)


def test_the_scale_of_features_does_not_matter() -> None:
    uv = pixels()
    ends = []
    for scale in (1.0, 1e-3):
        reference, query = (levels(*(scale * view(s, seed) for seed in range(2))) for s in ((0.0, 0.0), (0.5, 0.5)))
        ends.append(match_pixels(reference, query, uv, uv, MatchSettings()))
    # float32 maps: the products round differently.
    assert np.median(np.abs(ends[0] - ends[1])) < 1e-4


@pytest.mark.parametrize(
    ("gain", "offset", "withstands"),
    [(1.0, 0.0, {"none", "affine"}), (0.5, 40.0, {"affine"}), (1.8, -60.0, {"affine"})],
)
def test_residuals_are_invariant_to_the_brightness_model(gain: float, offset: float, withstands: set[str]) -> None:
    uv, shift = pixels(), (1.2, -0.8)
    reference, query = levels(view()), levels(gain * view(shift) + offset)
    for brightness in ("none", "affine"):
        found = share_found(
            match_pixels(reference, query, uv, uv, MatchSettings(DSO_PATTERN, brightness)), uv + shift, 0.2
        )
        assert found > 0.85 if brightness in withstands else found < 0.4, brightness


def test_pixels_without_contrast_out_of_the_image_or_not_finite_get_no_answer() -> None:
    flat = np.full((HEIGHT, WIDTH), 100.0)
    uv = np.array([[100.0, 100.0]])
    assert np.isnan(match_pixels(levels(flat), levels(flat), uv, uv, INTENSITY)).all()
    reference, query = levels(view()), levels(view())
    for u, start in (((1.0, 1.0), (50.0, 50.0)), ((50.0, 50.0), (-30.0, 50.0)), ((50.0, 50.0), (np.nan, 50.0))):
        assert np.isnan(match_pixels(reference, query, np.array([u]), np.array([start]), INTENSITY)).all()


def test_pixels_do_not_influence_each_other_and_inputs_are_left_alone() -> None:
    uv, reference, query = pixels(), levels(view()), levels(view((2.0, 1.0)))
    start = uv + offsets(len(uv), 2)
    kept = start.copy()
    together = match_pixels(reference, query, uv, start, INTENSITY)
    np.testing.assert_array_equal(start, kept)
    apart = match_pixels(reference, query, uv[::-3], start[::-3], INTENSITY)
    np.testing.assert_array_equal(apart, together[::-3])
    assert match_pixels(reference, query, np.zeros((0, 2)), np.zeros((0, 2)), INTENSITY).shape == (0, 2)


def test_too_few_residuals_and_wrong_shapes_are_refused() -> None:
    one, two = levels(view()), levels(view(), view())
    uv = pixels()
    with pytest.raises(ValueError, match=r"\b1\b.*pattern"):
        match_pixels(one, one, uv, uv, MatchSettings())
    with pytest.raises(ValueError, match="channels"):
        match_pixels(one, two, uv, uv, INTENSITY)
    with pytest.raises(ValueError, match=r"\(N, 2\)"):
        match_pixels(one, one, uv, uv[:-1], INTENSITY)


def test_dso_matches_pixels_of_its_keyframe_under_another_light() -> None:
    uv, shift = pixels(), (3.0, -1.5)
    dark = 0.6 * view(shift) + 20.0
    here, there = (np.rint(np.clip(image, 0, 255)).astype(np.uint8) for image in (view(), dark))
    depth = np.full((HEIGHT, WIDTH), 4.0, dtype=np.float32)
    dso, blind = Dso(), Dso(affine=False)
    assert isinstance(dso, SupportsMatching)
    reference, query = Reference("r", 0, here, CAMERA, depth=depth), Query("q", 1, there, CAMERA)
    end = dso.match(dso.prepare(reference), query, uv, uv)
    assert share_found(end, uv + shift, 0.5) > 0.8
    assert share_found(blind.match(blind.prepare(reference), query, uv, uv), uv + shift, 0.5) < 0.5


def test_a_pixel_that_starts_where_it_belongs_stays_there() -> None:
    """Shifted by 8 px the images agree to the last bit on four levels."""
    image = np.rint(64.0 + 0.5 * np.clip(view(), -100, 350)).astype(np.uint8)
    reference, query = image_pyramid(image, CAMERA, 4), image_pyramid(np.roll(image, 8, axis=1), CAMERA, 4)
    uv = pixels(60.0)
    truth = uv + np.array([8.0, 0.0])
    np.testing.assert_allclose(match_pixels(reference, query, uv, truth, INTENSITY), truth, atol=1e-9)
