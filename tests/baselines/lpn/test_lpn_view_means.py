"""Descriptors in every direction, and relative to the mean of their view."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from made_places import picture
from refusals import refused

from baselines.lpn.retriever import Lpn
from baselines.lpn.view_means import MOST_IMAGES, ViewMeans, unlabelled_files, unlabelled_images
from relocbench.arrays import Image
from relocbench.errors import MethodError
from relocbench.retrieval import ImageView


@pytest.fixture
def unlabelled(tmp_path: Path) -> Path:
    """A folder of five images of each view; those of the drone are in folders of their places."""
    for view in ("drone", "satellite"):
        for number in range(5):
            folder = tmp_path / "unlabelled" / view / (f"place{number}" if view == "drone" else "")
            folder.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / f"{number}.png"), picture(10 + number, view, 0, 64)[..., ::-1])
    return tmp_path / "unlabelled"


def views(view: str, first: int = 0, count: int = 4) -> list[ImageView]:
    return [ImageView(f"{n}", view, partial(picture, n, view, 0, 64)) for n in range(first, first + count)]


def turned(view: ImageView, quarters: int) -> Image:
    return np.ascontiguousarray(np.rot90(view.image, quarters))


def test_in_four_directions_a_turned_image_is_the_same(weights: Path) -> None:
    once, often = Lpn(weights=weights), Lpn(weights=weights, turns=4)
    images = views("satellite")
    for quarters in (1, 2, 3):
        others = [ImageView(each.key, each.view, partial(turned, each, quarters)) for each in images]
        assert np.allclose(often.describe(images), often.describe(others), atol=1e-3)
        assert not np.allclose(once.describe(images), once.describe(others), atol=1e-3)
    assert often.info["turns"] == 4


def test_descriptors_are_relative_to_the_mean_of_the_view(weights: Path, unlabelled: Path) -> None:
    plain, centred = Lpn(weights=weights), Lpn(weights=weights, unlabelled=unlabelled)
    asked = [*views("drone"), *views("satellite")]
    rows = plain.describe(asked).reshape(8, 4, 8)
    means = {view: plain.describe(views(view, 10, 5)).mean(0).reshape(4, 8) for view in ("drone", "satellite")}
    away = rows - np.stack([means[each.view] for each in asked])
    expected = away / np.linalg.norm(away, axis=-1, keepdims=True) / 2
    assert np.allclose(centred.describe(asked), expected.reshape(8, 32), atol=1e-3)
    assert np.allclose(centred.describe(asked[:1]), expected.reshape(8, 32)[:1], atol=1e-3)  # whatever comes with it
    assert centred.info["centred"]


def test_means_are_removed_however_far_views_are_apart(tmp_path: Path) -> None:
    places = np.random.default_rng(0).normal(size=(60, 16)).astype(np.float32)
    shift = {"drone": np.float32(30), "satellite": np.float32(-20)}
    described = {name: places + by for name, by in shift.items()}

    def describe(images: Any) -> Any:
        return np.stack([described[each.view][int(Path(each.key).stem)] for each in images])

    for view in shift:
        (tmp_path / view).mkdir()
        for number in range(30):
            (tmp_path / view / f"{number:02d}.png").touch()
    means = ViewMeans(tmp_path, describe, 1)
    query, gallery = (means.centred(described[view][30:], [view] * 30) for view in shift)
    assert (np.argmax(query @ gallery.T, axis=1) == np.arange(30)).all()


def test_some_images_of_many_are_enough(tmp_path: Path) -> None:
    (tmp_path / "street").mkdir()
    for number in range(3 * MOST_IMAGES):
        (tmp_path / "street" / f"{number:04d}.jpg").touch()
    for name in ("notes.txt", "._0000.jpg"):
        (tmp_path / "street" / name).touch()
    chosen = unlabelled_images(tmp_path, "street")
    assert len(chosen) == MOST_IMAGES
    assert (chosen[0].name, chosen[-1].name) == ("0000.jpg", f"{3 * MOST_IMAGES - 1:04d}.jpg")
    assert sorted(unlabelled_files(tmp_path).values()) == chosen
    assert "unlabelled/street/0000.jpg" in unlabelled_files(tmp_path)
    assert unlabelled_files(None) == {}
    assert unlabelled_files(tmp_path / "none") == {}


def test_a_linked_flight_is_one_of_the_view(tmp_path: Path) -> None:
    (tmp_path / "flight").mkdir()
    (tmp_path / "flight" / "0.png").touch()
    (tmp_path / "all" / "drone").mkdir(parents=True)
    (tmp_path / "all" / "drone" / "first").symlink_to(tmp_path / "flight")
    (tmp_path / "flight" / "back").symlink_to(tmp_path / "all" / "drone")
    assert [path.name for path in unlabelled_images(tmp_path / "all", "drone")] == ["0.png"]


def test_an_image_that_is_the_mean_has_no_descriptor(tmp_path: Path) -> None:
    (tmp_path / "drone").mkdir()
    (tmp_path / "drone" / "0.png").touch()
    only = np.eye(4, dtype=np.float32)[:1]
    rows = ViewMeans(tmp_path, lambda images: only, 1).centred(np.concatenate([only, -only]), ["drone", "drone"])
    assert np.isnan(rows[0]).all()
    assert np.allclose(rows[1], -only)
    nothing = ViewMeans(tmp_path, lambda images: np.full((1, 4), np.nan), 1)
    with refused(MethodError, tmp_path / "drone", None, "images"):
        nothing.centred(only, ["drone"])


def test_what_is_not_there_is_named(weights: Path, unlabelled: Path) -> None:
    with refused(MethodError, unlabelled / "nowhere", None, "is not a folder"):
        Lpn(weights=weights, unlabelled=unlabelled / "nowhere")
    street = ViewMeans(unlabelled, lambda images: np.zeros((len(images), 2)), 1)
    with refused(MethodError, "", None, "street"):
        street.centred(np.zeros((1, 2), np.float32), ["street"])
    (unlabelled / "satellite" / "0.png").write_bytes(b"no image")
    with refused(MethodError, "0.png"):
        Lpn(weights=weights, unlabelled=unlabelled).describe(views("satellite"))
