"""Changes of light and made-up weather: other grey values, no moved edge, and what is asked for."""

from __future__ import annotations

from typing import get_args

import cv2
import numpy as np
import pytest

from relocbench.arrays import Image
from relocbench.datasets.moved_views.drawing import View, drawn_keyframe
from relocbench.datasets.moved_views.kinds import WORDS, Change
from relocbench.datasets.moved_views.light import changed
from relocbench.datasets.moved_views.pictures import sight_of
from relocbench.datasets.moved_views.weather import SCENERY, Sight

SIZE = 128, 96


def street_sight() -> Sight:
    """A road below the camera, and walls around it."""
    keyframe = drawn_keyframe((200, 150), 150.0, SIZE, "street", np.random.default_rng(5))
    return sight_of(keyframe, View(keyframe.camera, np.eye(4)))


def photograph() -> Image:
    """A blue sky above grey walls with dark windows, and a dark road."""
    image = np.full((*SIZE[::-1], 3), 150, dtype=np.uint8)
    image[:24] = (110, 160, 230)
    image[64:] = 90
    for u in range(10, 120, 24):
        image[34:48, u : u + 8] = 60
    return image


def of(change: Change, seed: int, sight: Sight | None = None) -> Image:
    return changed(photograph(), change, np.random.default_rng(seed), lambda: sight or street_sight())


def test_every_change_has_words_for_its_condition() -> None:
    assert set(WORDS) == set(get_args(Change))


@pytest.mark.thorough
def test_a_change_is_that_of_its_seed_changes_grey_values_and_moves_no_edge() -> None:
    image, sight = photograph(), street_sight()
    assert changed(image, "none", np.random.default_rng(0), street_sight) is image
    steps = np.abs(np.diff(image[34:48].astype(float).mean(axis=2), axis=1)).mean(axis=0)
    for change in WORDS:
        if change == "none":
            continue
        sharper = []
        for seed in range(6):
            other = of(change, seed, sight)
            assert np.array_equal(other, of(change, seed, sight))
            assert other.shape == image.shape
            assert np.abs(other.astype(float) - image).mean() > 3
            found = np.abs(np.diff(cv2.GaussianBlur(other, (1, 9), 0)[38:44].astype(float).mean(axis=(0, 2))))
            sharper.append(found[steps > 20].mean() / found[steps == 0].mean())
        assert np.median(sharper) > 2, change


def test_nights_are_dark_with_a_dark_sky_and_lamps() -> None:
    for change in ("night", "lamplight"):
        assert np.mean([of(change, seed).mean() for seed in range(8)]) < 0.8 * photograph().mean()
    nights = [of("lamplight", seed).astype(float) for seed in range(8)]
    assert np.median([night[:15].mean() for night in nights]) < 70
    assert np.median([night.max() for night in nights]) > 200


def test_fog_takes_contrast_from_what_is_far_and_snow_whitens_the_ground() -> None:
    sight = street_sight()
    far = np.nan_to_num(sight.points.copy())
    fog = [of("fog", seed, sight).astype(float) for seed in range(8)]
    nearer = [
        of("fog", seed, Sight(far * np.where(np.arange(SIZE[0]) < 64, 0.3, 1.0)[:, None], 100.0)) for seed in range(8)
    ]
    left, right = slice(0, 50), slice(76, 128)
    contrast = [[view[34:48, part].astype(float).std() for part in (left, right)] for view in nearer]
    assert np.mean(contrast, axis=0)[0] > 1.2 * np.mean(contrast, axis=0)[1]
    assert np.mean([view[34:48].std() for view in fog]) < 0.8 * photograph()[34:48].std()
    snow = [of("snow", seed, sight).astype(float)[80:].mean() for seed in range(8)]
    assert np.mean(snow) > photograph()[80:].mean() + 40


def test_a_low_sun_comes_from_another_side_with_each_seed() -> None:
    views = [cv2.GaussianBlur(of("low-sun", seed), (0, 0), 5.0).astype(float) for seed in range(4)]
    for k, one in enumerate(views):
        assert all(np.abs(one - other).mean() > 5 for other in views[k + 1 :])


def test_where_nothing_is_seen_changes_still_give_a_picture() -> None:
    nothing = Sight(np.full((*SIZE[::-1], 3), np.nan), 80.0)
    for change in SCENERY:
        assert of(change, 0, nothing).shape == photograph().shape
