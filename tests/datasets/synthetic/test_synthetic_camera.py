"""The effects of a drive's own camera, each on a made-up image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relocbench.arrays import Array, Floats
from relocbench.datasets.core.images import through_jpeg
from relocbench.datasets.synthetic.camera import processing
from relocbench.datasets.synthetic.camera.drops import sliding_drops, through_drops
from relocbench.datasets.synthetic.camera.lens import behind_dirt, clearness, defocus, disk, scatter, vignette
from relocbench.datasets.synthetic.camera.motion_blur import blur_along, image_velocity, motion_blur
from relocbench.datasets.synthetic.camera.photograph import (
    exposure_ev,
    grey_levels,
    temperature_ev,
    through_lens,
    with_noise,
)
from relocbench.datasets.synthetic.camera.shot import Drifting, Shot, camera_twists, drift
from relocbench.datasets.synthetic.conditions.imaging import DARK_RANGES, RANGES, Imaging, Range, draw_imaging
from relocbench.geometry import Camera, apply, invert, se3_exp

HEIGHT, WIDTH = 48, 64
CAMERA = Camera("pinhole", WIDTH, HEIGHT, 50.0, 55.0, 30.0, 25.0)
STILL = np.zeros(6)
LUMA = np.array([0.2126, 0.7152, 0.0722])
seeds = st.integers(0, 2**31 - 1)


def scene(seed: int = 0) -> Floats:
    """Light (H, W, 3) with edges, colours and one bright lamp."""
    rng = np.random.default_rng(seed)
    blocks = rng.uniform(0.02, 0.8, (6, 8, 3))
    light = np.kron(blocks, np.ones((8, 8, 1))).astype(np.float32)
    light[10:12, 40:42] = 20.0
    return light


def flat(value: float) -> Floats:
    return np.full((HEIGHT, WIDTH, 3), value, dtype=np.float32)


def dot(y: int = 24, x: int = 32) -> Floats:
    """A white point on black."""
    light = flat(0.0)
    light[y, x] = 1.0
    return light


def centroid(light: Floats) -> Array:
    v, u = np.mgrid[: light.shape[0], : light.shape[1]]
    grey = light.sum(axis=-1, dtype=np.float64)
    out: Array = np.array([(u * grey).sum(), (v * grey).sum()]) / grey.sum()
    return out


def shot(time_s: float = 3.0, lens: int = 0, /, **imaging: float) -> Shot:
    return Shot(Imaging.model_validate(imaging), time_s, STILL, lens)


# Motion


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.floats(2, 50))
def test_pixels_move_as_points_seen_by_the_moving_camera(parts: list[float], metres: float) -> None:
    twist = np.array(parts) * [10, 10, 10, 1, 1, 1]
    depth = np.full((HEIGHT, WIDTH), metres, dtype=np.float32)
    velocity = image_velocity(depth, CAMERA, twist)
    pixels = np.array([[3.0, 5.0], [60.0, 40.0], [30.0, 25.0]])
    rays, _ = CAMERA.unproject(pixels)
    seconds = 1e-4
    moved = []
    for sign in (-0.5, 0.5):
        T_now_then = invert(se3_exp(sign * seconds * twist))
        moved.append(CAMERA.project(apply(T_now_then, rays * metres))[0])
    expected = (moved[1] - moved[0]) / seconds
    found = np.array([velocity[int(v), int(u)] for u, v in pixels])
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=0.02)


def test_blur_is_symmetric_about_the_time_of_the_pose() -> None:
    sideways, depth = np.array([8.0, 0, 0, 0, 0, 0]), np.full((HEIGHT, WIDTH), 4.0, dtype=np.float32)
    blurred = motion_blur(dot(), depth, CAMERA, sideways, 0.08)  # 8 px
    np.testing.assert_allclose(centroid(blurred), [32, 24], atol=1e-4)
    np.testing.assert_allclose(blurred[24, 25:40], blurred[24, 25:40][::-1], atol=1e-6)
    np.testing.assert_allclose(blurred, motion_blur(dot(), depth, CAMERA, -sideways, 0.08), atol=1e-6)
    assert blurred.sum() == pytest.approx(3.0, rel=1e-4)
    assert np.count_nonzero(blurred[24, :, 0] > 0.01) == pytest.approx(9, abs=1)
    assert not blurred[:24].any()


def test_near_things_blur_more_than_far_ones_and_the_sky_only_where_the_camera_turns() -> None:
    depth = np.full((HEIGHT, WIDTH), 40.0, dtype=np.float32)
    depth[24:], depth[:8] = 2.0, 0.0
    light = flat(0.0)
    light[:, 32] = 1.0
    moved = motion_blur(light, depth, CAMERA, np.array([8.0, 0, 0, 0, 0, 0]), 0.03)
    assert moved[4, 32, 0] == pytest.approx(1.0)
    assert moved[40, 32, 0] < 0.4 < moved[16, 32, 0]
    turned = motion_blur(light, depth, CAMERA, np.array([0, 0, 0, 0, 2.0, 0]), 0.03)
    assert turned[4, 32, 0] < 0.6


def test_without_motion_or_without_time_nothing_blurs() -> None:
    light, depth = scene(), np.full((HEIGHT, WIDTH), 3.0, dtype=np.float32)
    fast = np.array([8.0, 1, 2, 0.3, 0.2, 0.1])
    assert motion_blur(light, depth, CAMERA, STILL, 0.03) is light
    assert motion_blur(light, depth, CAMERA, fast, 0.0) is light
    np.testing.assert_allclose(blur_along(flat(0.4), np.full((HEIGHT, WIDTH, 2), 7, np.float32)), 0.4, rtol=1e-5)


def test_velocities_are_those_of_the_poses() -> None:
    twist = np.array([0.3, -0.2, 8.0, 0.02, 0.3, -0.01])
    poses = np.array([se3_exp(0.1 * k * twist) for k in range(4)])
    np.testing.assert_allclose(camera_twists(poses, 0.1), np.tile(twist, (4, 1)), atol=1e-9)
    assert not camera_twists(poses[:1], 0.1).any()


# Lens


@pytest.mark.parametrize("radius", [0.3, 1.0, 2.5])
def test_a_point_out_of_focus_is_a_disk_around_it(radius: float) -> None:
    kernel = disk(radius)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-7)
    blurred = defocus(dot(), radius)
    np.testing.assert_allclose(centroid(blurred), [32, 24], atol=1e-4)
    v, u = np.nonzero(blurred[..., 0] > 1e-6)
    assert np.hypot(u - 32, v - 24).max() <= radius + 1.5
    np.testing.assert_allclose(defocus(flat(0.3), radius), 0.3, rtol=1e-5)


def test_corners_lose_the_light_that_was_asked_for() -> None:
    share = vignette(HEIGHT, WIDTH, 0.4)
    assert share[0, 0] == pytest.approx(0.6, abs=1e-5)
    assert share.max() == pytest.approx(1.0, abs=1e-3)
    assert np.all(np.diff(share[24, 32:]) < 0)
    np.testing.assert_allclose(share, share[::-1, ::-1], atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0, 0.4), st.floats(0, 0.4))
def test_scattered_light_is_neither_made_nor_lost(seed: int, bloom: float, veil: float) -> None:
    light = scene(seed)
    light[10:12, 40:42] = 3.0
    np.testing.assert_allclose(scatter(light, bloom, veil).mean(axis=(0, 1)), light.mean(axis=(0, 1)), rtol=0.02)


def test_bloom_is_around_the_lamp_and_the_veil_is_everywhere() -> None:
    light = flat(0.02)
    light[10:12, 40:42] = 20.0
    glowing, veiled = scatter(light, 0.1, 0.0), scatter(light, 0.0, 0.1)
    assert glowing[13, 41, 0] > 2 * light[13, 41, 0]
    assert glowing[40, 5, 0] == pytest.approx(0.02, rel=1e-3)
    assert glowing[10, 40, 0] < light[10, 40, 0]
    assert veiled[40, 5, 0] > light[40, 5, 0]


def test_dirt_takes_light_away_and_more_of_it_takes_more() -> None:
    clean, some, much = (clearness(HEIGHT, WIDTH, amount, 7, 0) for amount in (0.0, 0.4, 1.0))
    np.testing.assert_allclose(clean, 1.0)
    assert np.all(much <= some + 1e-6)
    assert 0 < much.min() < some.min() < 0.95
    assert not np.allclose(much, clearness(HEIGHT, WIDTH, 1.0, 8, 0))
    assert not np.allclose(much, clearness(HEIGHT, WIDTH, 1.0, 7, 1))
    dirty = behind_dirt(flat(0.5), much)
    assert np.all(dirty <= 0.5 + 1e-6)
    assert dirty.mean() < 0.48
    np.testing.assert_array_equal(behind_dirt(scene(), clean), scene())


@settings(max_examples=20, deadline=None)
@given(seeds, st.floats(0, 1000))
def test_drops_stay_or_slide_down_until_others_take_their_place(seed: int, time_s: float) -> None:
    now, soon = (sliding_drops(HEIGHT, WIDTH, 0.5, seed, 0, time_s + later) for later in (0.0, 0.1))
    same = now.stretch == soon.stretch
    assert np.mean(same) > 0.8
    down = soon.centre[same] - now.centre[same]
    assert np.all(down[:, 0] == 0)
    assert np.all((down[:, 1] >= -1e-3) & (down[:, 1] <= 0.012 * HEIGHT + 1e-3))
    more = sliding_drops(HEIGHT, WIDTH, 0.8, seed, 0, time_s)
    np.testing.assert_array_equal(more.centre[: len(now.centre)], now.centre)


def test_drops_show_something_else_in_their_place() -> None:
    drops = sliding_drops(HEIGHT, WIDTH, 0.3, 5, 0, 2.0)
    changed = np.abs(through_drops(scene(), drops) - scene()).max(axis=-1) > 0.01
    v, u = np.nonzero(changed)
    nearest = np.hypot(u[:, None] - drops.centre[:, 0], v[:, None] - drops.centre[:, 1]) / drops.radius
    assert 0.01 < changed.mean() < 0.6
    assert nearest.min(axis=1).max() < 2


# Along the drive


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(0, 10_000), st.sampled_from(list(Drifting)))
def test_drifts_are_bounded_and_smooth(seed: int, time_s: float, what: Drifting) -> None:
    now, soon = drift(seed, what, time_s), drift(seed, what, time_s + 0.1)
    assert -1 <= now <= 1
    assert abs(soon - now) <= 0.09 + 1e-9


def test_white_balance_and_exposure_drift_smoothly_and_on_their_own() -> None:
    times = np.arange(0, 60, 0.1)
    drifting = {"temperature_ev": 0.2, "white_balance_drift_ev": 0.3, "exposure_ev": -0.5, "exposure_drift_ev": 0.4}
    warmth = np.array([temperature_ev(shot(t, **drifting)) for t in times])
    stops = np.array([exposure_ev(shot(t, **drifting)) for t in times])
    assert np.abs(warmth - 0.2).max() <= 0.3
    assert np.abs(stops + 0.5).max() <= 0.4
    assert np.ptp(warmth) > 0.15
    assert np.abs(np.diff(warmth)).max() < 0.03
    assert abs(np.corrcoef(warmth, stops)[0, 1]) < 0.95
    assert temperature_ev(shot(9.0, temperature_ev=0.2)) == 0.2


# Sensor and processing


def test_noise_has_the_variance_of_the_model_and_keeps_the_mean() -> None:
    rng = np.random.default_rng(3)
    for level in (0.0, 0.25, 1.0):
        light = np.full((200, 200, 3), level, dtype=np.float32)
        noisy = with_noise(light, 0.01, 0.05, rng)
        assert noisy.mean() == pytest.approx(level, abs=1e-3)
        assert noisy.std() == pytest.approx(np.sqrt(0.01**2 + 0.05**2 * level), rel=0.02)
    np.testing.assert_array_equal(with_noise(flat(0.2), 0.0, 0.0, rng), flat(0.2))


@given(st.floats(-3, 3), st.floats(-2, 2))
def test_white_balance_shifts_colours_by_stops_and_keeps_the_luminance_of_grey(warm: float, green: float) -> None:
    gains = processing.white_balance(warm, green).astype(float)
    assert gains @ LUMA == pytest.approx(1.0, abs=1e-5)
    stops = np.log2(gains)
    assert stops[0] - stops[2] == pytest.approx(warm, abs=1e-4)
    assert stops[1] - (stops[0] + stops[2]) / 2 == pytest.approx(green, abs=1e-4)


@settings(max_examples=60, deadline=None)
@given(st.floats(1, 20), st.floats(1, 4), st.floats(0.2, 4))
def test_responses_rise_from_black_to_white(white: float, gamma: float, contrast: float) -> None:
    light = np.linspace(-0.1, 1.2 * white, 300, dtype=np.float32)
    levels = processing.response(light, white, gamma, contrast)
    assert levels[0] == 0
    # The S of a contrast below 1 is steep at white, where it enlarges the rounding of single precision.
    np.testing.assert_allclose(levels[light >= white], 1.0, atol=max(1e-5, 2.4e-7**contrast))
    assert np.all(np.diff(levels) >= -1e-5)
    assert np.all(np.isfinite(levels))


def test_parameters_of_the_response_are_what_they_say() -> None:
    light = np.linspace(0, 1, 101, dtype=np.float32)
    np.testing.assert_allclose(processing.response(light, 1.0, 1.0, 1.0), light, atol=1e-6)
    np.testing.assert_allclose(processing.response(light, 1.0, 2.0, 1.0), np.sqrt(light), atol=1e-6)
    near = np.array([0.499, 0.501], dtype=np.float32)
    steep = processing.response(near, 1.0, 1.0, 1.7)
    assert (steep[1] - steep[0]) / 0.002 == pytest.approx(1.7, rel=0.01)
    soft = processing.response(np.array([0.9, 2.0], dtype=np.float32), 4.0, 2.2, 1.0)
    assert soft[0] < soft[1] < 1


def test_luma_and_colour_differences_make_the_image_again() -> None:
    levels = scene()[:, :39]
    luma, chroma = processing.to_luma_chroma(levels)
    np.testing.assert_allclose(processing.to_rgb(luma, chroma), levels, atol=1e-5)
    grey = processing.to_rgb(luma, 0 * chroma)
    np.testing.assert_allclose(grey, np.repeat(luma[..., None], 3, axis=-1), atol=1e-6)


def step_edge(noise: float = 0.0) -> Floats:
    luma = np.full((HEIGHT, WIDTH), 0.3, dtype=np.float32)
    luma[:, 32:] = 0.7
    return (luma + np.random.default_rng(1).normal(0, noise, luma.shape)).astype(np.float32) if noise else luma


def test_sharpening_overshoots_at_edges_and_leaves_flat_parts() -> None:
    blurred = defocus(np.repeat(step_edge()[..., None], 3, axis=-1), 2.0)[..., 0]
    sharp = processing.sharpen(blurred, 1.5, 1.0)
    assert np.diff(sharp[20]).max() > 1.2 * np.diff(blurred[20]).max()
    assert sharp.min() < 0.29
    assert sharp.max() > 0.71
    np.testing.assert_allclose(sharp[:, :20], 0.3, atol=1e-5)
    np.testing.assert_array_equal(processing.sharpen(blurred, 0.0, 1.0), blurred)


def test_denoising_lowers_noise_and_keeps_edges() -> None:
    noisy = step_edge(0.02)
    clean = processing.denoise(noisy, 0.08)
    assert clean[:, :28].std() < 0.5 * noisy[:, :28].std()
    assert clean[:, 34].mean() - clean[:, 29].mean() > 0.38
    np.testing.assert_array_equal(processing.denoise(noisy, 0.0), noisy)


def test_smoothing_of_colour_leaves_the_brightness() -> None:
    image = grey_levels(scene(), shot(), np.random.default_rng(0)).astype(float)
    smooth = grey_levels(scene(), shot(chroma_denoising_px=3.0), np.random.default_rng(0)).astype(float)
    inside = (image > 5) & (image < 250) & (smooth > 5) & (smooth < 250)
    kept = inside.all(axis=-1)
    assert np.abs((smooth - image)[kept] @ LUMA).max() < 1.5
    assert (
        np.abs(np.diff(smooth[..., 0] - smooth[..., 2], axis=1)).max()
        < np.abs(np.diff(image[..., 0] - image[..., 2], axis=1)).max()
    )


def test_lower_quality_of_compression_is_farther_from_the_image() -> None:
    image = grey_levels(scene(), shot(shot_noise=0.02), np.random.default_rng(0))
    errors = [np.abs(through_jpeg(image, q).astype(float) - image).mean() for q in (95, 60, 10)]
    assert 0 < errors[0] < errors[1] < errors[2]
    assert through_jpeg(image, 60.4).tobytes() == through_jpeg(image, 60).tobytes()


# The whole camera

EFFECTS = {
    "defocus_px": 1.5,
    "vignetting": 0.5,
    "bloom": 0.1,
    "veiling_glare": 0.1,
    "dirt": 0.5,
    "drops": 0.4,
    "read_noise": 0.05,
    "shot_noise": 0.05,
    "temperature_ev": 0.5,
    "tint_ev": 0.3,
    "white_balance_drift_ev": 1.0,
    "white_level": 1.5,
    "gamma": 1.5,
    "contrast": 1.5,
    "denoising": 0.3,
    "chroma_denoising_px": 2.0,
    "sharpening": 1.0,
    "saturation": 0.3,
    "jpeg_quality": 20.0,
}
ELSEWHERE = {
    "exposure_ms": "motion_blur, by the renderer",
    "exposure_ev": "exposure_ev, by the renderer",
    "exposure_drift_ev": "exposure_ev, by the renderer",
    "seed": "chooses",
    "sharpening_px": "of sharpening",
}


def photographed(noise_seed: int = 1, /, **imaging: float) -> Array:
    taken = shot(**imaging)
    return grey_levels(through_lens(scene(), taken), taken, np.random.default_rng(noise_seed)).astype(float)


@pytest.mark.parametrize("name", EFFECTS)
def test_each_factor_changes_the_image_alone(name: str) -> None:
    assert np.abs(photographed(**{name: EFFECTS[name]}) - photographed()).mean() > 0.2


def test_every_factor_of_the_camera_is_tried() -> None:
    assert EFFECTS.keys() | ELSEWHERE.keys() == Imaging.model_fields.keys()
    assert RANGES.keys() == Imaging.model_fields.keys() - {"seed"}
    assert DARK_RANGES.keys() <= RANGES.keys()


def test_a_camera_without_effects_shows_the_light_by_its_response_alone() -> None:
    expected = processing.response(scene(), 3.0, 2.2, 1.0) * 255
    assert np.abs(photographed() - expected).max() <= 0.51


def test_the_same_shot_is_the_same_image() -> None:
    drawn = draw_imaging(np.random.default_rng(4), dark=False).model_dump(exclude_none=True)
    everything = {**drawn, **EFFECTS}
    assert np.array_equal(photographed(**everything), photographed(**everything))
    assert not np.array_equal(photographed(**everything), photographed(2, **everything))
    assert not np.array_equal(photographed(**everything), photographed(**{**everything, "seed": 9}))


# Drawing


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_drawn_factors_are_within_their_ranges(seed: int, dark: bool) -> None:
    imaging = draw_imaging(np.random.default_rng(seed), dark=dark)
    neutral = Imaging()
    for name, by_day in RANGES.items():
        drawn = DARK_RANGES.get(name, by_day) if dark else by_day
        value = getattr(imaging, name)
        if value != getattr(neutral, name):
            assert drawn.low * 0.999 - 1e-4 <= value <= drawn.high * 1.001 + 1e-4
        else:
            assert drawn.share < 1 or drawn.low <= (value or 0) <= drawn.high


def test_cameras_differ_and_effects_are_as_frequent_as_asked() -> None:
    cameras = [draw_imaging(np.random.default_rng([1, k]), dark=False) for k in range(400)]
    assert len(set(cameras)) == 400
    assert np.mean([c.drops > 0 for c in cameras]) == pytest.approx(RANGES["drops"].share, abs=0.07)
    assert np.mean([c.jpeg_quality is not None for c in cameras]) == pytest.approx(0.8, abs=0.07)
    by_night = [draw_imaging(np.random.default_rng([1, k]), dark=True) for k in range(100)]
    assert min(c.exposure_ms for c in by_night) > np.median([c.exposure_ms for c in cameras])


def test_a_range_is_drawn_from_evenly_or_by_its_logarithm() -> None:
    rng = np.random.default_rng(0)
    even = np.array([Range(1.0, 100.0).draw(rng) for _ in range(2000)], dtype=float)
    logarithmic = np.array([Range(1.0, 100.0, logarithmic=True).draw(rng) for _ in range(2000)], dtype=float)
    assert np.median(even) == pytest.approx(50.5, rel=0.07)
    assert np.median(logarithmic) == pytest.approx(10.0, rel=0.15)
