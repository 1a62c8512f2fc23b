"""Place-recognition networks with weights that nobody trained, and images for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

import baselines.place_networks as place_networks
from baselines.place_networks.backbone import Backbone, BackboneName
from baselines.place_networks.dinov2 import VitShape
from baselines.place_networks.gem import GemNetwork
from baselines.place_networks.megaloc import MegaLocNetwork
from baselines.place_networks.netvlad import NetVladNetwork
from baselines.place_networks.retrievers import PlaceRetriever
from relocbench.arrays import Image
from relocbench.retrieval import ImageView

State = dict[str, Tensor]
VIT = VitShape(channels=128, hidden=96, blocks=2, patch=14, grid=5)
CLUSTERS = 6
NETVLAD = ("encoder", "pool")
RETRIEVERS: dict[str, type[PlaceRetriever]] = {
    made.name: made for made in (getattr(place_networks, name) for name in place_networks.__all__)
}


def drawn_state(make: Callable[[], nn.Module]) -> State:
    """Numbers for a network that keep the size of what passes through it, from NumPy, whose streams do not change."""
    rng = np.random.default_rng(0)
    with torch.device("meta"):
        network = make()
    state: State = {}
    for name, value in network.state_dict().items():
        shape, last = tuple(value.shape), name.rpartition(".")[2]
        if last == "num_batches_tracked":
            state[name] = torch.tensor(7)
        elif last in ("p", "running_var", "gamma") or (last == "weight" and len(shape) == 1):
            state[name] = torch.tensor(rng.uniform(0.5, 1.5, shape), dtype=torch.float32)
        else:
            spread = (2 / max(np.prod(shape[1:]), 1)) ** 0.5 if len(shape) > 1 else 0.1
            state[name] = torch.from_numpy(rng.standard_normal(shape, dtype=np.float32)) * float(spread)
    return state


@cache
def gem_state(name: BackboneName = "ResNet18", dimensions: int = 32) -> State:
    return drawn_state(lambda: GemNetwork(Backbone(name), dimensions))


def netvlad_state(
    backbone: Backbone = Backbone("ResNet18", 3),
    bias: bool = False,
    whitened: int | None = None,
    layout: tuple[str, str] = NETVLAD,
) -> State:
    return drawn_state(lambda: NetVladNetwork(backbone, 5, bias, whitened, layout))


def megaloc_state() -> State:
    return drawn_state(lambda: MegaLocNetwork(VIT, hidden=40, clusters=CLUSTERS, features=24, token=16, dimensions=48))


STATES: dict[str, Callable[[], State]] = {
    "cosplace": gem_state,
    "eigenplaces": gem_state,
    "netvlad": netvlad_state,
    "megaloc": megaloc_state,
}
SIZES: dict[str, int | str | None] = {"cosplace": None, "eigenplaces": None, "netvlad": None, "megaloc": "70x70"}


def saved(state: Mapping[str, Any], path: Path) -> Path:
    torch.save(state, path)
    return path


def pattern(height: int, width: int, seed: int = 0) -> Image:
    """Blocks of random colours."""
    blocks = np.random.default_rng(seed).integers(0, 256, (height // 8 + 1, width // 8 + 1, 3), dtype=np.uint8)
    return np.repeat(np.repeat(blocks, 8, axis=0), 8, axis=1)[:height, :width].copy()


def view(image: Image) -> ImageView:
    return ImageView("key", "street", lambda: image)


def made(name: str, weights: Path, **parameters: Any) -> PlaceRetriever:
    """A retriever whose images are as small as its network takes them, unless their size is given."""
    return RETRIEVERS[name](**{"weights": weights, "size": SIZES[name], **parameters})


def described(retriever: PlaceRetriever, *images: Image) -> NDArray[np.floating]:
    return retriever.describe([view(image) for image in images])
