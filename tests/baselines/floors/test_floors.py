"""Retrievers that learn nothing: random order, colours, ORB words."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import permutations
from typing import Any

import cv2
import numpy as np
import pytest
from made_places import made_places
from refusals import refused

from baselines.floors import ColourHistogram, OrbBagOfWords, RandomOrder
from relocbench.errors import ConfigError, MethodError
from relocbench.evaluation.retrieval.training_validation import PlaceValidation
from relocbench.retrieval import FittingRetriever, ImageView, PlaceData, PlaceImage, Retriever

VIEWS = ("drone", "satellite")


def corners(place: int, shift: int) -> Any:
    """(96, 96, 3): squares at the place's own spots, moved a little."""
    rng = np.random.default_rng(place)
    image = np.full((96, 96, 3), 90, np.uint8)
    for _ in range(14):
        u, v = rng.integers(8, 76, 2) + shift
        side = int(rng.integers(4, 14))
        cv2.rectangle(
            image, (int(u), int(v)), (int(u) + side, int(v) + side), [int(c) for c in rng.integers(0, 255, 3)], -1
        )
    return image


def plain(value: int) -> Any:
    return np.full((96, 96, 3), value, np.uint8)


def view_of(key: str, read: Any) -> ImageView:
    return ImageView(key, "drone", read)


def corner_places(places: int = 8) -> PlaceData:
    images = [
        PlaceImage(ImageView(f"{view}{place}", view, partial(corners, place, shift)), place)
        for place in range(places)
        for shift, view in enumerate(VIEWS)
    ]
    return PlaceData(places, tuple(images), ())


@pytest.mark.parametrize("retriever", [RandomOrder(), ColourHistogram(), OrbBagOfWords()])
def test_floors_keep_the_contract(retriever: Any) -> None:
    assert isinstance(retriever, Retriever)
    assert isinstance(retriever, FittingRetriever) == isinstance(retriever, OrbBagOfWords)
    images = [each.image for each in corner_places(4).images]
    if isinstance(retriever, FittingRetriever):
        retriever.fit(images, seed=0)
    together = retriever.describe(images)
    assert np.allclose(np.linalg.norm(together, axis=1), 1)
    alone = np.concatenate([retriever.describe([image]) for image in reversed(images)])[::-1]
    assert np.allclose(together, alone, atol=1e-12)


def test_random_order_looks_at_nothing_and_depends_on_its_seed() -> None:
    def unread() -> Any:
        raise AssertionError("an image was read")

    images = [ImageView(f"{n}", "drone", unread) for n in range(300)]
    rows = RandomOrder().describe(images)
    assert np.array_equal(rows, RandomOrder(seed=0).describe(images))
    assert not np.array_equal(rows, RandomOrder(seed=1).describe(images))
    others = RandomOrder().describe([ImageView(f"{n}", "satellite", unread) for n in range(300)])
    hits = np.mean(np.argmax(rows @ others.T, axis=1) == np.arange(300))
    assert hits < 0.03  # chance is 1 in 300


@pytest.mark.thorough
def test_colours_find_places_of_other_colours() -> None:
    scores = PlaceValidation(made_places(6, 2), VIEWS)(ColourHistogram())
    assert scores.together["R@1"] > 0.8
    one, other = ColourHistogram(light=2, colour=2).describe(
        [view_of("a", partial(plain, 10)), view_of("b", partial(plain, 250))]
    )
    assert one @ other == 0  # black and white share no cell
    assert sorted(one)[-1] == 1


@pytest.mark.thorough
def test_images_of_one_view_are_retrieved_between_conditions() -> None:
    data = made_places(6, 3)
    drones = [each for each in data.images if each.image.view == "drone"]
    by_light = [replace(each, condition=f"light {number % 3}") for number, each in enumerate(drones)]
    validation = PlaceValidation(replace(data, images=tuple(by_light)), ("drone",))
    assert len(validation) == 18
    scores = validation(ColourHistogram())
    assert set(scores.by_conditions) == {f"light {a}-light {b}" for a, b in permutations(range(3), 2)}
    assert scores.together["R@1"] > 0.8
    elsewhere = [replace(each, condition="fog") if each.place < 2 else each for each in by_light]
    found = PlaceValidation(replace(data, images=tuple(elsewhere)), ("drone",))(ColourHistogram())
    assert set(found.by_conditions) == set(scores.by_conditions), "no place is shown in fog and in another condition"
    assert set(found.pairs.values()) == {4}
    with refused(ConfigError, "", None, "drone"):
        PlaceValidation(data, ("drone",))
    with refused(ConfigError, "", None, "street"):
        PlaceValidation(data, ("street",))


def test_orb_words_find_places_of_other_corners() -> None:
    data = corner_places()
    gallery = [each.image for each in data.images if each.image.view == "satellite"]
    retriever = OrbBagOfWords(words=64)
    with refused(MethodError, "", None, "fit"):
        retriever.describe(gallery)
    retriever.fit(gallery, seed=0)
    assert PlaceValidation(data, VIEWS)(retriever).together["R@1"] > 0.8
    again = OrbBagOfWords(words=64)
    again.fit(gallery, seed=0)
    assert np.array_equal(again.describe(gallery), retriever.describe(gallery))


def test_an_image_without_features_is_not_described_and_a_gallery_without_them_has_no_vocabulary() -> None:
    retriever = OrbBagOfWords(words=16)
    bare = [view_of(f"{value}", partial(plain, value)) for value in (0, 128)]
    with refused(MethodError, "", None, "ORB", 0):
        retriever.fit(bare, seed=0)
    retriever.fit([each.image for each in corner_places(3).images], seed=0)
    assert np.isnan(retriever.describe(bare)).all()


def test_a_word_that_all_images_have_says_nothing() -> None:
    images = [each.image for each in corner_places(3).images]
    retriever = OrbBagOfWords(words=2)
    retriever.fit(images, seed=0)
    assert np.isnan(retriever.describe(images)).all()  # both words are in every image: log(N / N) = 0
