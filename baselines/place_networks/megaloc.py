"""MegaLoc (Berton and Masone, CVPR Workshops 2025): DINOv2 and SALAD's aggregation by optimal transport.

SALAD (Izquierdo and Civera, CVPR 2024) assigns each of n patches to m clusters or to a dustbin. With scores S
(m + 1, n), whose last row is the dustbin's score, it is P_ij = exp(S_ij + u_i + v_j), where u and v are such that

    sum over j of P_ij = 1 for clusters and n - m for the dustbin,      sum over i of P_ij = 1 for patches,

as three iterations of Sinkhorn's leave it, the latter exactly. Of features f (l, n), V_k = sum over j of P_kj f_j. The
descriptor is a linear map of the class token's features and all V_k, each of norm 1, divided by its norm.

Tensors have the names of the authors' files: those of ``model.safetensors``, and those of ``megaloc.torch``, in which
DINOv2 is ``backbone.model`` and has the mask token of its training as well.
"""

from __future__ import annotations

from math import log
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.place_networks.checkpoint import filled, read_state, shape_of
from baselines.place_networks.dinov2 import DinoV2, VitShape
from baselines.place_networks.network import PlaceNetwork
from relocbench.errors import MethodError

_ITERATIONS = 3
_WHAT = (
    "the weights of MegaLoc: DINOv2 without registers as 'backbone' or 'backbone.model', "
    "'aggregator.agg' and 'aggregator.linear'"
)


def assignment(scores: Tensor, dustbin: Tensor) -> Tensor:
    """SALAD's assignment (B, m, n) of n patches to m clusters from scores (B, m, n); n must exceed m.

    Args:
        dustbin: its score, a number.
    """
    batch, clusters, patches = scores.shape
    s = torch.cat([scores, dustbin.expand(batch, 1, patches)], dim=1)
    mass = s.new_zeros(clusters + 1)
    mass[-1] = log(patches - clusters)
    u, v = s.new_zeros(batch, clusters + 1), s.new_zeros(batch, patches)
    for _ in range(_ITERATIONS):
        u = mass - torch.logsumexp(s + v[:, None, :], dim=2)
        v = -torch.logsumexp(s + u[:, :, None], dim=1)
    return (s + u[:, :, None] + v[:, None, :])[:, :-1].exp()


class Salad(nn.Module):
    """Vectors (B, g + l m) of norm 1 of class tokens (B, C) and maps (B, C, h, w).

    Args:
        channels, hidden: C, and the channels of the hidden layers.
        clusters, features, token: m, l and g.
    """

    def __init__(self, channels: int, hidden: int, clusters: int, features: int, token: int) -> None:
        super().__init__()

        def at_each_patch(outputs: int) -> nn.Sequential:
            # The second layer dropped numbers in training.
            return nn.Sequential(
                nn.Conv2d(channels, hidden, 1), nn.Identity(), nn.ReLU(), nn.Conv2d(hidden, outputs, 1)
            )

        self.token_features = nn.Sequential(nn.Linear(channels, hidden), nn.ReLU(), nn.Linear(hidden, token))
        self.cluster_features = at_each_patch(features)
        self.score = at_each_patch(clusters)
        self.dust_bin = nn.Parameter(torch.ones(()))

    def forward(self, token: Tensor, maps: Tensor) -> Tensor:
        f = self.cluster_features(maps).flatten(2)
        p = assignment(self.score(maps).flatten(2), self.dust_bin)
        v = functional.normalize(f @ p.mT, dim=1).flatten(1)
        t = functional.normalize(self.token_features(token), dim=1)
        return functional.normalize(torch.cat([t, v], dim=1), dim=1)


class _Aggregator(nn.Module):
    def __init__(self, salad: Salad, length: int, dimensions: int) -> None:
        super().__init__()
        self.agg = salad
        self.linear = nn.Linear(length, dimensions)

    def forward(self, token: Tensor, maps: Tensor) -> Tensor:
        return cast(Tensor, self.linear(self.agg(token, maps)))


class MegaLocNetwork(PlaceNetwork):
    """DINOv2 and SALAD; the sides of images are multiples of the patch's."""

    def __init__(
        self, backbone: VitShape, hidden: int, clusters: int, features: int, token: int, dimensions: int
    ) -> None:
        super().__init__()
        self.clusters, self.dimensions, self.patch = clusters, dimensions, backbone.patch
        self.on = f"DINOv2, {backbone.blocks} blocks of {backbone.channels} channels"
        self.least = f"more than {clusters} patches of {backbone.patch}x{backbone.patch} pixels"
        self.backbone = DinoV2(backbone)
        salad = Salad(backbone.channels, hidden, clusters, features, token)
        self.aggregator = _Aggregator(salad, token + features * clusters, dimensions)

    def forward(self, images: Tensor) -> Tensor:
        return functional.normalize(self.aggregator(*self.backbone(images)), dim=1)

    def takes(self, height: int, width: int) -> bool:
        return (height // self.patch) * (width // self.patch) > self.clusters


def load_megaloc(path: Path) -> MegaLocNetwork:
    """The network of a file, whose sizes follow from its tensors.

    Raises:
        MethodError: the file is missing, damaged, or of another network.
    """
    state = {name.replace("backbone.model.", "backbone.", 1): tensor for name, tensor in read_state(path).items()}
    state.pop("backbone.mask_token", None)
    backbone = VitShape.of(state, "backbone")
    if backbone is None:
        raise MethodError(f"its 'backbone' is unknown; expected {_WHAT}", path)
    hidden, _ = shape_of(state, "aggregator.agg.token_features.0.weight", 2, path, _WHAT)
    token, _ = shape_of(state, "aggregator.agg.token_features.2.weight", 2, path, _WHAT)
    features = shape_of(state, "aggregator.agg.cluster_features.3.weight", 4, path, _WHAT)[0]
    clusters = shape_of(state, "aggregator.agg.score.3.weight", 4, path, _WHAT)[0]
    dimensions, _ = shape_of(state, "aggregator.linear.weight", 2, path, _WHAT)
    with torch.device("meta"):
        network = MegaLocNetwork(backbone, hidden, clusters, features, token, dimensions)
    return filled(network, state, path, "the weights of MegaLoc")
