"""What GN-Net's training is fed: pairs drawn evenly, cuts that are exact, augmentation that moves no pixel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_pairs import TINY, MadePairs
from refusals import refused

from baselines.gn_net.training.augmentation import augment
from baselines.gn_net.training.batches import Batch, Batches
from baselines.gn_net.training.crops import cut_pair, mirrored, scaled
from baselines.gn_net.training.drawing import EvenDraw
from baselines.gn_net.training.options import AugmentationOptions, TrainOptions
from baselines.options import options_from_dict
from baselines.training.loop import batches_in_order
from relocbench.arrays import Array
from relocbench.errors import ConfigError
from relocbench.training import TrainingPair

UNEVEN = [("dry", "dry")] * 7 + [("dry", "wet")] * 2 + [("night", "wet")]


def options(**changed: Any) -> TrainOptions:
    return options_from_dict(TrainOptions, {**TINY, **changed})


def coordinates_image(width: int, height: int) -> np.ndarray:
    """Each pixel holds its own column and row."""
    v, u = np.mgrid[:height, :width]
    return np.stack([u, v, np.zeros_like(u)], axis=-1).astype(np.uint8)


def test_pairs_are_drawn_evenly_over_combinations_and_then_over_pairs() -> None:
    data = MadePairs(UNEVEN)
    draw = EvenDraw(data, seed=3)
    drawn = [draw[n] for n in range(3 * 14)]
    by_condition = Counter((data.label(i).condition_ref, data.label(i).condition_query) for i in drawn)
    assert set(by_condition.values()) == {14}
    assert draw.combinations == len(by_condition) == 3
    by_pair = Counter(drawn)
    assert [by_pair[i] for i in range(10)] == [2] * 7 + [7] * 2 + [14]
    for start in range(0, len(drawn), 3):
        assert (
            len({(data.label(i).condition_ref, data.label(i).condition_query) for i in drawn[start : start + 3]}) == 3
        )


def test_a_draw_depends_on_its_number_and_the_seed_alone() -> None:
    data = MadePairs(UNEVEN)
    first, again, other = EvenDraw(data, 0), EvenDraw(data, 0), EvenDraw(data, 1)
    assert [first[n] for n in range(60)] == [again[n] for n in reversed(range(60))][::-1]
    assert [first[n] for n in range(60)] != [other[n] for n in range(60)]


@pytest.mark.thorough
@given(st.integers(1, 99), st.integers(0, 99), st.integers(0, 3))
def test_a_dataset_gets_its_share_of_the_draws(percent: int, second: int, seed: int) -> None:
    second = min(second, 99 - percent)
    names = ["town"] * 8 + ["photographs"] * 7 + ["walk"] * 5
    data = MadePairs(UNEVEN * 2, datasets=names)
    shares = {"walk": percent / 100} | ({"photographs": second / 100} if second else {})
    draw = EvenDraw(data, seed, shares)
    drawn = [data.label(draw[n]).dataset for n in range(200)]
    for name, share in shares.items():
        for count in (50, 100, 200):
            assert abs(drawn[:count].count(name) - share * count) < 2
    if not second:
        others = [draw[n] for n in range(400) if data.label(draw[n]).dataset != "walk"]
        alone = EvenDraw(MadePairs((UNEVEN * 2)[:15], datasets=names[:15]), seed)
        assert others == [alone[n] for n in range(len(others))], "the rest is drawn as if it were all"


@pytest.mark.parametrize(
    ("shares", "names"),
    [
        ({"streets": 0.5}, ("shares.streets", "town", "walk")),
        ({"town": 0.5, "walk": 0.4}, ("shares", 0.9)),
        ({"town": 1.0}, ("shares", 1, "walk")),
    ],
)
def test_shares_that_cannot_be_are_refused(shares: Mapping[str, float], names: tuple[object, ...]) -> None:
    with refused(ConfigError, "", None, *names):
        EvenDraw(MadePairs(datasets=["town", "walk"] * 2), 0, shares)


def test_a_share_is_of_the_dataset_that_its_name_tells() -> None:
    data = MadePairs(datasets=["town@a1", "town@b2", "walk@c3"] * 2)
    for name in ("walk", "walk@c3"):
        draw = EvenDraw(data, 0, {name: 0.5})
        assert {data.label(draw[number]).dataset for number in range(1, 40, 2)} == {"walk@c3"}
    with refused(ConfigError, "", None, "shares.town", 2, "town@a1"):
        EvenDraw(data, 0, {"town": 0.5})


def test_shares_are_above_0_and_at_most_1() -> None:
    for shares in ({"town": 0.0}, {"town": 0.6, "walk": 0.6}):
        with refused(ConfigError, "", None, "shares", 0, 1):
            options(shares=shares)


@pytest.mark.parametrize("seed", range(5))
def test_a_cut_shifts_pixels_and_correspondences_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u_ref = rng.integers(0, (200, 120), (300, 2)).astype(np.float32)
    u_query = (u_ref + rng.integers(-9, 10, u_ref.shape)).astype(np.float32)
    images = coordinates_image(200, 120), coordinates_image(210, 130)
    tags = np.arange(len(u_ref))
    cut = cut_pair(*images, u_ref, u_query, 48, (1.0, 1.0), 0.4, np.random.default_rng(seed))
    assert cut.image_ref.shape == cut.image_query.shape == (48, 48, 3)
    assert len(cut.u_ref) > 0
    seen = []
    for at_ref, at_query in zip(cut.u_ref.astype(int), cut.u_query.astype(int), strict=True):
        ref = cut.image_ref[at_ref[1], at_ref[0], :2]
        query = cut.image_query[at_query[1], at_query[0], :2]
        rows = tags[np.all(u_ref == ref, axis=1) & np.all(u_query == query, axis=1)]
        assert len(rows) > 0
        seen.append(rows[0])
    corner_ref, corner_query = cut.image_ref[0, 0, :2], cut.image_query[0, 0, :2]
    assert np.array_equal(cut.u_still + corner_query, cut.u_ref + corner_ref)  # the same place of the whole images
    inside = np.all((u_ref >= corner_ref) & (u_ref < corner_ref + 48.0), axis=1)
    inside &= np.all((u_query >= corner_query) & (u_query < corner_query + 48.0), axis=1)
    assert len(seen) == inside.sum()


@pytest.mark.parametrize("factor", [0.5, 0.63, 1.0, 1.4])
def test_scaling_keeps_pixels_on_what_they_show(factor: float) -> None:
    """The image shows its own coordinates; away from the border, where a ramp ends, they are found again."""
    u = np.random.default_rng(0).uniform(5, (90, 60), (200, 2)).astype(np.float32)
    image, moved = scaled(2 * coordinates_image(96, 66), u, factor)
    assert image.shape[:2] == (round(66 * factor), round(96 * factor))
    low = np.floor(moved).astype(int)
    a, b = (moved - low).T[..., None]
    values = image[..., :2] / 2.0

    def at(du: int, dv: int) -> Array:
        shown: Array = values[low[:, 1] + dv, low[:, 0] + du]
        return shown

    shown = (1 - b) * ((1 - a) * at(0, 0) + a * at(1, 0)) + b * ((1 - a) * at(0, 1) + a * at(1, 1))
    assert np.abs(shown - u).max() < 0.4  # stored values are whole numbers, of half a pixel each
    assert np.abs((shown - u).mean(0)).max() < 0.1


def test_mirroring_keeps_pixels_on_what_they_show() -> None:
    image = coordinates_image(31, 20)
    u = np.array([[0, 3], [30, 19], [12, 7]], dtype=np.float32)
    other, moved = mirrored(image, u)
    assert np.array_equal(moved, [[30, 3], [0, 19], [18, 7]])
    shown = other[moved[:, 1].astype(int), moved[:, 0].astype(int), :2]
    assert np.array_equal(shown, u)
    back, again = mirrored(other, moved)
    assert np.array_equal(back, image)
    assert np.array_equal(again, u)


def test_both_images_of_a_pair_are_mirrored_or_neither() -> None:
    data = MadePairs([("dry", "wet")])
    never, always, sometimes = (Batches(data, options(mirror=share, swap=0.0, batch=1)) for share in (0.0, 1.0, 0.5))
    same = [torch.equal(never[step].images_ref, sometimes[step].images_ref) for step in range(6)]
    assert True in same
    assert False in same
    for step, plain in enumerate(same):
        expected = never if plain else always
        for one, other in zip(sometimes[step], expected[step], strict=True):
            assert torch.equal(one, other)


def test_an_image_smaller_than_the_cut_is_continued() -> None:
    image = coordinates_image(20, 16)
    u = np.array([[3, 4], [19, 15]], dtype=np.float32)
    cut = cut_pair(image, image, u, u, 32, (1.0, 1.0), 0.4, np.random.default_rng(0))
    assert np.array_equal(cut.image_ref[:16, :20], image)
    assert np.array_equal(cut.image_ref[20, 25], image[15, 19])
    assert np.array_equal(cut.u_ref, u)


def test_a_pair_without_correspondences_gives_an_empty_cut() -> None:
    nothing = np.zeros((0, 2), dtype=np.float32)
    image = coordinates_image(60, 50)
    cut = cut_pair(image, image, nothing, nothing, 32, (0.7, 1.0), 0.4, np.random.default_rng(0))
    assert cut.u_ref.shape == (0, 2)


def test_the_place_in_the_square_does_not_tell_which_point_it_is() -> None:
    """Without a move of its own the query's square shows each point where the reference's does."""
    image = coordinates_image(250, 250)
    u = np.random.default_rng(0).uniform(5, 240, (400, 2)).astype(np.float32)

    def moved(apart: float) -> np.ndarray:
        cuts = [cut_pair(image, image, u, u, 64, (1.0, 1.0), apart, np.random.default_rng(seed)) for seed in range(60)]
        return np.array([np.median(cut.u_query - cut.u_ref, axis=0) for cut in cuts])

    assert np.abs(moved(0.0)).max() == 0
    off = moved(0.4)
    assert 20 < np.abs(off).max() <= 0.4 * 64 + 0.5
    assert np.all(np.abs(off.mean(axis=0)) < 6)
    assert np.all(off.std(axis=0) > 10)


def test_augmentation_changes_light_and_moves_nothing() -> None:
    image = np.full((40, 64, 3), 0.25, dtype=np.float32)
    image[:, 32:] = 0.7
    image[20:, :] += 0.15
    plain = AugmentationOptions(probability=1.0, noise=0.0, vignetting=0.0)
    means = []
    for seed in range(20):
        changed = augment(image, plain, np.random.default_rng(seed))
        assert changed.dtype == np.float32
        assert changed.shape == image.shape
        assert 0 <= changed.min() <= changed.max() <= 1
        grey = changed.mean(-1)
        across, down = np.abs(np.diff(grey, axis=1)).sum(0), np.abs(np.diff(grey, axis=0)).sum(1)
        assert (int(np.argmax(across)), int(np.argmax(down))) == (31, 19)
        means.append(float(grey.mean()))
    assert np.std(means) > 0.02
    first, again = (augment(image, AugmentationOptions(), np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(first, again)


def test_no_strength_is_no_change() -> None:
    image = np.random.default_rng(0).random((8, 9, 3)).astype(np.float32)
    names = ("gain", "offset", "gamma", "contrast", "colour", "grey", "noise", "blur", "vignetting")
    none = AugmentationOptions(probability=1.0, **dict.fromkeys(names, 0.0))
    assert np.allclose(augment(image, none, np.random.default_rng(0)), image, atol=1e-6)


def test_batches_are_the_same_with_and_without_augmentation_but_for_the_pixels_values() -> None:
    with_it = Batches(MadePairs(), options())[3]
    without = Batches(MadePairs(), options(augmentation={"probability": 0.0}))[3]
    assert torch.equal(with_it.u_ref, without.u_ref)
    assert torch.equal(with_it.u_query, without.u_query)
    assert torch.equal(with_it.mask, without.mask)
    assert not torch.equal(with_it.images_ref, without.images_ref)


def test_correspondences_of_a_batch_show_the_same_texture() -> None:
    """Without augmentation the query is the reference, moved and darkened: I_q = I_r // 2 + 20."""
    batch = Batches(MadePairs(), options(augmentation={"probability": 0.0}, scale=[1.0, 1.0], swap=0.0))[1]
    for pair in range(2):
        u_ref, u_query = batch.u_ref[pair][batch.mask[pair]], batch.u_query[pair][batch.mask[pair]]
        assert len(u_ref) > 10
        ref, query = (255 * look_up(i[pair], u) for i, u in ((batch.images_ref, u_ref), (batch.images_query, u_query)))
        assert (query - (ref / 2 + 20)).abs().max() < 1.01


class WithSigma(MadePairs):
    """Correspondences in the image's left half are known to 3 px, others to 0.1 px or not told."""

    def load(self, index: int) -> TrainingPair:
        pair = super().load(index)
        sigma = np.where(pair.u_ref[:, 0] < 32, 3.0, np.where(np.arange(200) % 2, 0.1, np.nan))
        return replace(pair, sigma_px=sigma.astype(np.float32))


def test_correspondences_that_are_not_sure_are_left_out() -> None:
    chosen = options(augmentation={"probability": 0.0}, scale=[1.0, 1.0], swap=0.0, mirror=0.0, crop=64, points=200)
    batch = Batches(WithSigma(), chosen)[0]
    for pair in range(2):
        u_ref = batch.u_ref[pair][batch.mask[pair]]
        assert len(u_ref) > 30
        assert u_ref[:, 0].min() >= 32


def look_up(image: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    from baselines.gn_net.sampling import sample

    return sample(image, u).values


@pytest.mark.thorough
def test_any_number_of_workers_gives_the_same_bytes() -> None:
    batches = Batches(MadePairs(UNEVEN), options(steps=5))
    alone = list(batches_in_order(batches, 0, len(batches), workers=0, pin_memory=False))
    assert len(alone) == 5
    for workers in (1, 2):
        helped = list(batches_in_order(batches, 0, len(batches), workers=workers, pin_memory=False))
        assert all(same(a, b) for a, b in zip(alone, helped, strict=True))
    assert all(same(a, b) for a, b in zip(alone[3:], batches_in_order(batches, 3, len(batches), 0, False), strict=True))
    assert not same(alone[0], alone[1])


def same(a: Batch, b: Batch) -> bool:
    return all(torch.equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize(
    ("changed", "names"),
    [
        ({"batch": 0}, ("batch", 0, 1)),
        ({"batch": "four"}, ("batch", "four")),
        ({"crop": 4}, ("crop", 4, 16)),
        ({"scale": [1.0, 0.5]}, ("scale", "[1.0, 0.5]")),
        ({"ema": 1.0}, ("ema", "1.0")),
        ({"ema": float("nan")}, ("ema", "nan")),
        ({"swap": 1.5}, ("swap", 1.5, 0, 1)),
        ({"learning_rate": 0.0}, ("learning_rate", "0.0")),
        ({"loss": {"level_weights": [1.0]}}, ("loss.level_weights", "[1.0]", "network.levels")),
        ({"loss": {"descent": {"damping": -1}}}, ("loss.descent.damping", "-1.0")),
        ({"augmentation": {"grey": 2.0}}, ("augmentation.grey", "2.0", 0, 1)),
        ({"augmentation": {"gray": 0.1}}, ("augmentation.gray",)),
    ],
)
def test_options_that_make_no_sense_are_refused(changed: dict[str, Any], names: tuple[object, ...]) -> None:
    with refused(ConfigError, "", None, *names):
        options(**changed)
