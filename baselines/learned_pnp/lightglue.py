"""LightGlue (Lindenberger et al., ICCV 2023), matching of sparse features by attention, and trackers that use it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from pydantic import Field

from baselines.device import to_device
from baselines.feature_pnp.features import Features
from baselines.learned_pnp import published
from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import Aliked, Disk, from_kornia
from baselines.learned_pnp.superpoint import SuperPoint
from baselines.learned_pnp.trackers import NetworkPnp
from baselines.published_weights import by_place, fill, find_weights, read_weights
from relocbench.arrays import Indices
from relocbench.weights import PublishedFile

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


@dataclass(kw_only=True, eq=False)
class LightGluePnp(NetworkPnp):
    """Learned features, LightGlue (Lindenberger et al., ICCV 2023), MAGSAC perspective-n-point, robust refinement.

    Args:
        matcher_weights: file of the weights that match these features, likewise.
        features: largest number of keypoints in each image; the authors' default is 2048.
        threshold: least probability of a match.
    """

    dimension: ClassVar[int]
    """of the descriptors"""
    matcher_file: ClassVar[PublishedFile]

    matcher_weights: Path | None = None
    features: Annotated[int, Field(ge=4, le=20000)] = 2048
    threshold: Annotated[float, Field(ge=0, lt=1)] = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = self.files(**vars(self))["matcher_weights"]
        self._matcher = LightGlue(weights, self.dimension, self.threshold, self.device)

    @classmethod
    def files(cls, weights: Path | None = None, matcher_weights: Path | None = None, **_: Any) -> dict[str, Path]:
        matcher = find_weights(cls.matcher_file, matcher_weights, cls.name, "matcher_weights")
        return {**super().files(weights), "matcher_weights": matcher}

    @classmethod
    def published(cls, **_: Any) -> dict[Path, PublishedFile]:
        return by_place(cls.authors_file, cls.matcher_file)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return self._matcher(reference, query)


class AlikedLightGluePnp(LightGluePnp):
    """ALIKED (Zhao et al., IEEE TIM 2023), model n16, by LightGlue."""

    name: ClassVar[str] = "aliked-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = Aliked
    dimension: ClassVar[int] = 128
    authors_file: ClassVar[PublishedFile] = published.ALIKED["n16"]
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["aliked"]


class DiskLightGluePnp(LightGluePnp):
    """DISK (Tyszkiewicz et al., NeurIPS 2020) by LightGlue."""

    name: ClassVar[str] = "disk-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = Disk
    dimension: ClassVar[int] = 128
    authors_file: ClassVar[PublishedFile] = published.DISK
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["disk"]


class SuperPointLightGluePnp(LightGluePnp):
    """SuperPoint (DeTone et al., CVPR Workshops 2018) by LightGlue."""

    name: ClassVar[str] = "superpoint-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = SuperPoint
    dimension: ClassVar[int] = 256
    authors_file: ClassVar[PublishedFile] = published.SUPERPOINT
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["superpoint"]
