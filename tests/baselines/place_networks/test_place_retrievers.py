"""What the retrievers of place-recognition networks keep: norms, batches, sizes, published files, commands."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import torch
import torchvision  # type: ignore[import-untyped]
from command_line import relocbench
from drawn_places import (
    RETRIEVERS,
    described,
    made,
    pattern,
)
from refusals import refused
from repository import ROOT
from small_views import make_small_views

from baselines.place_networks import CosPlace, EigenPlaces, published
from baselines.place_networks.images import ImageSize, network_input
from relocbench.errors import MethodError
from relocbench.weights import SupportsFetching


@pytest.mark.parametrize("name", list(RETRIEVERS))
def test_descriptors_are_of_norm_1_and_of_their_image_alone(drawn: Callable[[str], Path], name: str) -> None:
    retriever = made(name, drawn(name), batch=3)
    images = [pattern(64, 96, seed) for seed in range(4)] + [pattern(96, 64, 4), pattern(80, 80, 5)]
    rows = described(retriever, *images)
    assert rows.dtype == np.float32
    assert rows.shape == (6, retriever.info["dimensions"])
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1.0, atol=1e-5)
    order = [3, 5, 0, 4, 2, 1]
    np.testing.assert_allclose(described(retriever, *(images[k] for k in order)), rows[order], atol=1e-5)
    alone = np.concatenate([described(retriever, image) for image in images])
    np.testing.assert_allclose(alone, rows, atol=1e-5)
    likeness = rows @ rows.T - np.eye(6)
    assert likeness.max() < 1 - 1e-4, "different images differ"
    assert retriever.describe([]).shape == (0, rows.shape[1])


@pytest.mark.parametrize(("name", "large", "small"), [("cosplace", 32, 31), ("netvlad", 32, 31), ("megaloc", 35, 27)])
def test_an_image_that_is_too_small_has_no_descriptor(
    drawn: Callable[[str], Path], name: str, large: int, small: int
) -> None:
    retriever = made(name, drawn(name), size=None)
    rows = described(retriever, pattern(large, 60), pattern(small, 28))
    assert np.isfinite(rows[0]).all()
    assert np.isnan(rows[1]).all()


def test_a_size_that_is_too_small_for_the_network_is_refused(drawn: Callable[[str], Path]) -> None:
    with refused(MethodError, "", None, "34x34", 6):
        made("megaloc", drawn("megaloc"), size="34x34")
    assert made("megaloc", drawn("megaloc"), size="42x42").size.width == 42


@pytest.mark.parametrize("given", [None, 48, "80x64"])
def test_images_are_resized_and_normalised_as_by_torchvision(given: int | str | None) -> None:
    image = pattern(75, 101)
    size = ImageSize.of(given).resized(75, 101)
    sides = {None: None, 48: [48], "80x64": [64, 80]}[given]
    transforms = torchvision.transforms.functional
    expected = torch.from_numpy(image).permute(2, 0, 1).float() / 255
    if sides is not None:
        expected = transforms.resize(expected, sides, antialias=True)
    expected = transforms.normalize(expected, [0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
    assert tuple(expected.shape[1:]) == size
    torch.testing.assert_close(network_input([image], size, torch.device("cpu"))[0], expected, atol=2e-5, rtol=0)


def test_sides_are_rounded_to_the_nearest_multiple() -> None:
    assert ImageSize.of("322x322").resized(480, 640, 14) == (322, 322)
    assert ImageSize.of(None).resized(480, 640, 14) == (476, 644)
    assert ImageSize.of(330).resized(480, 640, 14) == (336, 434)
    assert str(ImageSize.of("640x480")) == "640x480 px"


@pytest.mark.parametrize("text", ["", "x", "640x", "640x480x3", "large", "6e2", "-5", "٤٨٠", "9" * 5000, "640.5"])
def test_a_size_that_is_none_is_refused(text: str) -> None:
    with refused(MethodError, "", None, "size", "WIDTHxHEIGHT", "null"):
        ImageSize.of(text)


@pytest.mark.parametrize("text", ["31x64", "8193", "0"])
def test_a_size_without_bounds_is_refused(text: str) -> None:
    with refused(MethodError, "", None, 32, 8192):
        ImageSize.of(text)


def test_what_is_asked_must_be_what_the_file_holds(drawn: Callable[[str], Path]) -> None:
    weights = drawn("cosplace")
    assert CosPlace(weights=weights, backbone="ResNet18", dimensions=32).info["dimensions"] == 32
    with refused(MethodError, "", None, "ResNet18", 32, "ResNet50"):
        CosPlace(weights=weights, backbone="ResNet50")
    with refused(MethodError, "", None, 64):
        EigenPlaces(weights=weights, dimensions=64)
    with refused(MethodError, "", None, "abacus"):
        CosPlace(weights=weights, device="abacus")


def test_retrievers_are_installed_by_their_names() -> None:
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["relocbench.retrievers"]
    ours = {name: target for name, target in points.items() if target.startswith("baselines.place_networks:")}
    assert all(issubclass(made, SupportsFetching) for made in RETRIEVERS.values())
    assert {name: f"baselines.place_networks:{made.__name__}" for name, made in RETRIEVERS.items()} == ours


@pytest.mark.parametrize(
    ("name", "parameters", "file"),
    [
        ("cosplace", {}, "ResNet50_2048_cosplace.pth"),
        ("cosplace", {"backbone": "VGG16", "dimensions": 64}, "VGG16_64_cosplace.pth"),
        ("eigenplaces", {"dimensions": 512}, "ResNet50_512_eigenplaces.pth"),
        ("netvlad", {}, "pitts_WPCA4096.pth.tar"),
        ("netvlad", {"model": "mapillary_WPCA512"}, "mapillary_WPCA512.pth.tar"),
        ("megaloc", {}, "megaloc.safetensors"),
    ],
)
def test_what_is_published_is_what_is_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, parameters: dict[str, Any], file: str
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    retriever: Any = RETRIEVERS[name]
    ((path, told),) = retriever.published(**parameters).items()
    assert path == tmp_path / "hub" / "checkpoints" / file
    assert told.address.startswith("https://")
    assert told.address.endswith(f"/{file}" if name != "megaloc" else "/model.safetensors")
    with refused(MethodError, "", None, file, "fetch-weights"):
        retriever(**parameters)
    path.parent.mkdir(parents=True)
    path.touch()
    assert retriever.files(**parameters) == {"weights": path}


def test_weights_that_nobody_publishes_are_named_with_those_that_are() -> None:
    with refused(MethodError, "", None, "EigenPlaces", "ResNet152", 2048):
        EigenPlaces.published(backbone="ResNet152")
    with refused(MethodError, "", None, "CosPlace", "VGG16", 2048):
        CosPlace.published(backbone="VGG16")
    assert set(published.NETVLAD) == set(get_args(published.NetVladModel))
    assert all(len(file.sha256 or "") == 64 for file in published.NETVLAD.values())


@pytest.mark.thorough
def test_the_command_evaluates_a_network_from_its_file_to_the_page(
    drawn: Callable[[str], Path], tmp_path: Path
) -> None:
    views = make_small_views(tmp_path / "town", places=4)
    words = ("evaluate-retrieval", "-d", views, "-m", "cosplace=baselines.place_networks:CosPlace", "-j", 0)
    settings = ("--set", f"weights={drawn('cosplace')}", "--set", "size=64x64")
    done = relocbench(*words, *settings, "-o", tmp_path / "results", "-q")
    assert done.status == 0, done.err
    (record,) = (tmp_path / "results").glob("town@*/cosplace/run.yaml")
    text = record.read_text()
    assert "backbone: ResNet18" in text
    assert "image_size: 64x64 px" in text
    assert "dimensions: 32" in text
    page = relocbench("leaderboard", tmp_path / "results", "--out", tmp_path / "board", "-q")
    assert page.status == 0, page.err
    assert "cosplace" in (tmp_path / "board" / "retrieval.md").read_text()


def test_without_weights_the_command_says_which_file_goes_where(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    views = make_small_views(tmp_path / "town", places=4)
    told = relocbench(
        "evaluate-retrieval", "-d", views, "-m", "baselines.place_networks:MegaLoc", "-o", tmp_path / "results"
    )
    assert told.status == 2
    assert f"{tmp_path / 'torch'}/hub/checkpoints/megaloc.safetensors: no weights here" in told.complaint
    assert "--set megaloc.weights=FILE" in told.complaint
    assert not (tmp_path / "results").exists()
