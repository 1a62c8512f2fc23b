"""LPN as a retriever: descriptors from files of weights, re-ranking, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from made_places import picture
from refusals import refused
from safetensors.torch import save_file
from small_lpn import ABOUT, NARROW

from baselines.lpn.descriptor import parts_of
from baselines.lpn.dmli import aligned_distance
from baselines.lpn.images import resized
from baselines.lpn.network import LpnNetwork
from baselines.lpn.retriever import GlobalAverage, Lpn
from baselines.lpn.weights import load_weights, save_weights
from relocbench.arrays import Image
from relocbench.errors import ConfigError, MethodError
from relocbench.retrieval import ImageView, RerankingRetriever, Retriever


def views(count: int = 5, view: str = "drone", side: int = 64) -> list[ImageView]:
    return [ImageView(f"{n}", view, partial(picture, n, view, 0, side)) for n in range(count)]


def mirror_image(view: ImageView) -> Image:
    return view.image[:, ::-1].copy()


def test_descriptors_are_those_of_the_network_with_mirror_images(weights: Path) -> None:
    retriever = Lpn(weights=weights, batch=2)
    assert isinstance(retriever, Retriever)
    assert isinstance(retriever, RerankingRetriever)
    asked = [*views(3), *views(2, "satellite")]
    rows = retriever.describe(asked)
    assert rows.shape == (5, 4 * 8)
    assert np.allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-4)
    images = torch.stack([torch.from_numpy(each.image.copy()).permute(2, 0, 1) / 255 for each in asked])
    network, _ = load_weights(weights)
    parts = network.embed("drone", images) + network.embed("drone", images.flip(-1))
    expected = torch.nn.functional.normalize(parts, dim=-1).flatten(1) / 2
    assert np.allclose(rows, expected.detach().numpy(), atol=1e-4)
    mirrored = [replace(each, read=partial(mirror_image, each)) for each in asked]
    assert np.allclose(rows, retriever.describe(mirrored), atol=1e-4)


def test_images_of_any_shape_are_resized_to_what_was_trained_with(weights: Path) -> None:
    retriever = Lpn(weights=weights)
    wide = ImageView("w", "drone", lambda: np.repeat(picture(0, "drone", 0, 128), 2, axis=1))
    square = ImageView("s", "drone", lambda: resized(wide.image, 64))
    assert np.allclose(retriever.describe([wide]), retriever.describe([square]), atol=1e-4)
    flat = np.full((300, 200, 3), 77, np.uint8)
    assert (resized(flat, 64) == 77).all()
    fine = np.tile(np.array([0, 255], np.uint8), (256, 128))[..., None].repeat(3, axis=2)
    assert np.abs(resized(fine, 64)[:, 4:-4].astype(int) - 127).max() < 12  # smoothed, not aliased to stripes


def test_rankings_are_sorted_anew_by_aligned_parts(weights: Path) -> None:
    assert Lpn(weights=weights).rerank_top == 0
    assert Lpn(weights=weights, rerank=7).rerank_top == 7
    retriever = Lpn(weights=weights, config="lpn-dmli")
    assert retriever.rerank_top == 100
    rows = retriever.describe(views())
    scores = retriever.rerank(rows[0], rows[1:])
    query, others = parts_of(torch.from_numpy(rows[0]), 4), parts_of(torch.from_numpy(rows[1:]), 4)
    assert np.allclose(scores, [-float(aligned_distance(query, other)) for other in others], atol=1e-4)
    assert np.argmax(retriever.rerank(rows[2], rows)) == 2


def test_without_weights_it_says_how_to_make_them(weights: Path) -> None:
    with refused(MethodError, "", None, "relocbench train lpn --config lpn --dataset D --out OUT"):
        Lpn()
    with refused(MethodError, "", None, "--config global-average"):
        GlobalAverage()
    with refused(MethodError, "", None, "lpn", "global-average", "parts"):
        GlobalAverage(weights=weights)
    with refused(MethodError, "", None, "lpn-rpp", "partition"):
        Lpn(weights=weights, config="lpn-rpp")
    with refused(ConfigError, "", None, "lpm"):
        Lpn(weights=weights, config="lpm")
    with refused(MethodError, "", None, "street", "drone", "satellite"):
        Lpn(weights=weights).describe(views(1, "street"))


def test_results_can_say_where_the_backbone_started(weights: Path) -> None:
    info = Lpn(weights=weights).info
    assert info["backbone_start"] == "drawn, no ImageNet"
    assert (info["configuration"], info["backbone"], info["image_size"]) == ("lpn", "resnet18", 64)
    json.dumps(info)


def test_files_that_are_no_weights_are_refused(weights: Path, tmp_path: Path) -> None:
    cut, other = tmp_path / "cut.safetensors", tmp_path / "other.safetensors"
    cut.write_bytes(weights.read_bytes()[:1000])
    save_file({"x": torch.zeros(2)}, other)
    for path in (tmp_path / "none.safetensors", cut, other):
        with refused(MethodError, path):
            load_weights(path)
    broken = LpnNetwork(3, NARROW)
    with torch.no_grad():
        next(broken.parameters()).fill_(float("nan"))
    save_weights(other, broken, ABOUT)
    with refused(MethodError, other):
        load_weights(other)
    save_weights(other, LpnNetwork(3, NARROW).eval(), ABOUT)
    assert other.read_bytes() == weights.read_bytes()
