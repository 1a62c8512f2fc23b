"""LPN's networks are small in all tests here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from made_places import NarrowResNet
from small_lpn import ABOUT, NARROW

from baselines.lpn.network import LpnNetwork
from baselines.lpn.weights import save_weights


@pytest.fixture(scope="module", autouse=True)
def narrow() -> Iterator[None]:
    """ResNet-18 with few channels and blocks, but where a test takes the whole one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.lpn.backbone.resnet18", NarrowResNet)
        yield


@pytest.fixture
def without_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take longer than these trainings."""
    monkeypatch.setattr("baselines.lpn.training.loop.draw_curves", lambda *_: None)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drawn weights of a small LPN."""
    path = tmp_path_factory.mktemp("weights") / "lpn.safetensors"
    save_weights(path, LpnNetwork(3, NARROW).eval(), ABOUT)
    return path
