"""NetVLAD (Arandjelovic et al., CVPR 2016): residuals of local features to soft-assigned centres.

    a_k(x) = softmax over k of (w_k x + b_k)                 x of norm 1, at each pixel
    V_k = sum over pixels of a_k(x) (x - c_k)                then each V_k, and all of them together, have norm 1

With whitening, the descriptor is P V + q, divided by its norm. Read are the tensors as pytorch-NetVlad and
Patch-NetVLAD name them (``encoder``, ``pool``, ``WPCA``) and as the Deep Visual Geo-localization Benchmark does
(``backbone``, ``aggregation``); the MATLAB files of the authors, which hloc reads, are of another layout.
"""

from __future__ import annotations

from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.place_networks.backbone import KNOWN, Backbone, backbone_of
from baselines.place_networks.checkpoint import State, filled, read_state, shape_of
from baselines.place_networks.network import PlaceNetwork
from relocbench.errors import MethodError

_LAYOUTS = (("encoder", "pool"), ("backbone", "aggregation"))
"""names of the backbone and of the layer"""
_WHITENING = "WPCA.0"


class NetVladLayer(nn.Module):
    """Vectors (B, K D) of norm 1 of maps (B, D, H, W), cluster after cluster."""

    def __init__(self, clusters: int, channels: int, bias: bool) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, clusters, 1, bias=bias)
        self.centroids = nn.Parameter(torch.empty(clusters, channels))

    def forward(self, maps: Tensor) -> Tensor:
        x = functional.normalize(maps, dim=1)
        a = self.conv(x).flatten(2).softmax(dim=1)
        # sum of a_k (x - c_k) = sum of a_k x - c_k sum of a_k
        v = a @ x.flatten(2).mT - a.sum(dim=-1, keepdim=True) * self.centroids
        return functional.normalize(functional.normalize(v, dim=2).flatten(1), dim=1)


class NetVladNetwork(PlaceNetwork):
    """NetVLAD on a backbone.

    Args:
        clusters: K.
        bias: whether soft assignment has one.
        whitened: number of dimensions after whitening; None for none.
        layout: names of the backbone and of the layer in files.
    """

    def __init__(
        self, backbone: Backbone, clusters: int, bias: bool, whitened: int | None, layout: tuple[str, str]
    ) -> None:
        super().__init__()
        self.on = str(backbone)
        length = clusters * backbone.channels
        self.dimensions = whitened or length
        self._layout = layout
        self.add_module(layout[0], backbone.make())
        self.add_module(layout[1], NetVladLayer(clusters, backbone.channels, bias))
        if whitened is not None:
            self.WPCA = nn.Sequential(nn.Conv2d(length, whitened, 1))
        self._whitens = whitened is not None

    def forward(self, images: Tensor) -> Tensor:
        backbone, layer = map(self.get_submodule, self._layout)
        vectors = cast(Tensor, layer(backbone(images)))
        if not self._whitens:
            return vectors
        projection = cast(nn.Conv2d, self.WPCA[0])
        return functional.normalize(functional.linear(vectors, projection.weight.flatten(1), projection.bias), dim=1)


def load_netvlad(path: Path) -> NetVladNetwork:
    """The network of a file; its backbone, clusters and whitening follow from its tensors.

    Raises:
        MethodError: the file is missing, damaged, or of another network.
    """
    state = read_state(path)
    what = f"the weights of NetVLAD: {KNOWN} as 'encoder.N', and 'pool.conv.weight' and 'pool.centroids'"
    layout = next((names for names in _LAYOUTS if f"{names[1]}.centroids" in state), _LAYOUTS[0])
    clusters, _ = shape_of(state, f"{layout[1]}.centroids", 2, path, what)
    backbone = backbone_of(state, layout[0])
    if backbone is None:
        raise MethodError(f"its '{layout[0]}' is unknown; expected {what}", path)
    whitened = _whitened(state, path, what)
    with torch.device("meta"):
        network = NetVladNetwork(backbone, clusters, f"{layout[1]}.conv.bias" in state, whitened, layout)
    return filled(network, state, path, f"the weights of NetVLAD on {backbone} with {clusters} clusters")


def _whitened(state: State, path: Path, what: str) -> int | None:
    """Number of dimensions after whitening, None without it. Raises MethodError."""
    if not any(name.startswith("WPCA") for name in state):
        return None
    return shape_of(state, f"{_WHITENING}.weight", 4, path, what)[0]
