"""LightGlue (Lindenberger et al., ICCV 2023): matching of sparse features by attention, in kornia's module."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.device import to_device
from baselines.feature_pnp.features import Features
from baselines.learned_pnp.kornia_networks import from_kornia
from baselines.published_weights import fill, read_weights
from relocbench.arrays import Indices

_LAYERS = 9


class LightGlue:
    """The matcher with its weights.

    Args:
        weights: file of its authors for the kind of features, or the same tensors as safetensors.
        dimension: of the descriptors.
        threshold: least probability of a match.
        device: where the network runs.

    Raises:
        MethodError: kornia is not installed, or the weights are missing or of another network.
    """

    def __init__(self, weights: Path, dimension: int, threshold: float, device: str) -> None:
        made = from_kornia("LightGlue", "LightGlue")
        net = made(features=None, input_dim=dimension, n_layers=_LAYERS, filter_threshold=threshold)
        tensors = read_weights(weights)
        fill(net, {_name_in_kornia(name): tensor for name, tensor in tensors.items()}, weights)
        self.net: Any = to_device(net, device)
        self.device = device

    @torch.inference_mode()
    def __call__(self, first: Features, second: Features) -> Indices:
        """Indices (M, 2) of matches into the features of two images, each at most once, in the order of ``first``."""
        if len(first) == 0 or len(second) == 0:
            return np.zeros((0, 2), dtype=np.intp)
        found = self.net({"image0": self._input(first), "image1": self._input(second)})
        pairs = found["matches"][0].cpu().numpy().astype(np.intp)
        return np.asarray(pairs[np.argsort(pairs[:, 0], kind="stable")], dtype=np.intp)

    def _input(self, features: Features) -> dict[str, torch.Tensor]:
        return {
            "keypoints": torch.tensor(features.uv, dtype=torch.float32, device=self.device)[None],
            "descriptors": torch.tensor(features.descriptors, dtype=torch.float32, device=self.device)[None],
            "image_size": torch.tensor([features.size], dtype=torch.float32, device=self.device),
        }


def _name_in_kornia(name: str) -> str:
    """The authors' files name attention before its layer, as in ``self_attn.0.Wqkv.weight``."""
    kind, _, rest = name.partition(".")
    layer, _, rest = rest.partition(".")
    return f"transformers.{layer}.{kind}.{rest}" if kind in ("self_attn", "cross_attn") else name
