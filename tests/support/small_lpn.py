"""A small LPN with drawn weights, for tests of what is made of its descriptors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from made_places import NarrowResNet

from baselines.lpn.network import LpnNetwork
from baselines.lpn.options import NetworkOptions
from baselines.lpn.weights import About, save_weights

NARROW = NetworkOptions(backbone="resnet18", width=8)
ABOUT = About("lpn", 64, "drawn, no ImageNet", ("drone", "satellite"), 0, {"data": '{"made": "0"}'})


@contextmanager
def drawn_weights(folder: Path) -> Iterator[Path]:
    """Its file; while it is open, backbones are narrow."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("baselines.lpn.backbone.resnet18", NarrowResNet)
        path = folder / "lpn.safetensors"
        save_weights(path, LpnNetwork(3, NARROW).eval(), ABOUT)
        yield path
