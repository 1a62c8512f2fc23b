"""The network of CosPlace and EigenPlaces: a backbone, generalised-mean pooling, a linear layer.

    x <- x / ||x||                            at each pixel, over the channels
    g_c = (mean over pixels of x_c^p)^(1/p)   Radenovic et al., TPAMI 2018
    descriptor = W g + b, divided by its norm

Berton et al., "Rethinking Visual Geo-localization for Large-Scale Applications", CVPR 2022; "EigenPlaces", ICCV 2023,
which is the same network with another training. Tensors have the names of the authors' files.
"""

from __future__ import annotations

from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.place_networks.backbone import KNOWN, Backbone, backbone_of
from baselines.place_networks.checkpoint import filled, read_state, shape_of
from baselines.place_networks.network import PlaceNetwork
from relocbench.errors import MethodError

_LEAST = 1e-6
"""to which smaller values are raised before their power is taken"""


class UnitNorm(nn.Module):
    """Vectors along the second dimension, divided by their norm."""

    def forward(self, x: Tensor) -> Tensor:
        return functional.normalize(x, dim=1)


class GeM(nn.Module):
    """The generalised mean (B, C, 1, 1) over the pixels of a map (B, C, H, W)."""

    def __init__(self) -> None:
        super().__init__()
        self.p = nn.Parameter(torch.full((1,), 3.0))

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x.clamp(min=_LEAST).pow(self.p).mean(dim=(-2, -1), keepdim=True).pow(1 / self.p)
        return out


class GemNetwork(PlaceNetwork):
    """The network of CosPlace and EigenPlaces on a backbone."""

    def __init__(self, backbone: Backbone, dimensions: int) -> None:
        super().__init__()
        self.kind, self.on, self.dimensions = backbone, str(backbone), dimensions
        self.backbone = backbone.make()
        self.aggregation = nn.Sequential(
            UnitNorm(), GeM(), nn.Flatten(), nn.Linear(backbone.channels, dimensions), UnitNorm()
        )

    def forward(self, images: Tensor) -> Tensor:
        return cast(Tensor, self.aggregation(self.backbone(images)))


def load_gem(path: Path, method: str) -> GemNetwork:
    """The network of a file, whose backbone and number of dimensions follow from its tensors.

    Args:
        method: what the user calls it, for messages.

    Raises:
        MethodError: the file is missing, damaged, or of another network.
    """
    state = read_state(path)
    what = f"the weights of {method}: {KNOWN} as 'backbone.N', and 'aggregation.1.p' and 'aggregation.3'"
    backbone = backbone_of(state, "backbone")
    dimensions, _ = shape_of(state, "aggregation.3.weight", 2, path, what)
    if backbone is None or backbone.stages < 4:
        raise MethodError(f"its 'backbone' is unknown; expected {what}", path)
    with torch.device("meta"):
        network = GemNetwork(backbone, dimensions)
    return filled(network, state, path, f"the weights of {method} on {backbone} with {dimensions} dimensions")
