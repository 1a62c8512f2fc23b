"""What all networks that detect and describe keypoints share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor, nn

from baselines.device import to_device
from baselines.feature_cache import FeatureCache
from baselines.feature_pnp.features import Features
from baselines.learned_pnp.images import network_input
from relocbench.arrays import Image


@dataclass(eq=False)
class NetworkDetector(ABC):
    """A network that finds keypoints in an image, with a descriptor of norm 1 for each.

    Args:
        weights: file of its authors, or the same tensors as safetensors.
        features: largest number of keypoints.
        longest_px: larger images are shrunk to this size of the longer side first.
        device: where the network runs.
        cache_size: number of images whose features are kept, those used last, for the next time that one comes.

    Raises:
        MethodError: kornia is needed and not installed, or the weights are missing or of another network.
    """

    name: ClassVar[str]
    channels: ClassVar[Literal[1, 3]] = 3
    multiple: ClassVar[int] = 1
    """both sides of an image are shrunk to multiples of so many pixels"""

    weights: Path
    features: int
    longest_px: int
    device: str
    cache_size: int = 0

    def __post_init__(self) -> None:
        self._cache: FeatureCache[Features] = FeatureCache(self.cache_size)
        self.net: Any = to_device(self.load(self.weights), self.device)

    @abstractmethod
    def load(self, weights: Path) -> nn.Module:
        """The network with its weights, on the CPU."""

    @abstractmethod
    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Keypoints (N, 2), pixels with centres at integers, responses (N,) and descriptors (N, D) in an image
        (1, channels, H, W)."""

    def __call__(self, image: Image) -> Features:
        """The features of a grey (H, W) or RGB (H, W, 3) image, strongest first.

        Raises:
            MethodError: the image is smaller than 64 pixels.
        """
        return self._cache.get(image, self._compute)

    @torch.inference_mode()
    def _compute(self, image: Image) -> Features:
        tensor, factor = network_input(
            image, self.channels, self.longest_px, self.name, self.device, multiple=self.multiple
        )
        keypoints, scores, descriptors = self.find(tensor)
        uv = (keypoints.double().cpu().numpy() + 0.5) * factor - 0.5
        response = scores.double().cpu().numpy()
        scale = np.full(len(uv), max(float(factor.max()), 1.0))
        size = image.shape[1], image.shape[0]
        features = Features(uv, scale, response, descriptors.float().cpu().numpy(), size)
        return features.take(np.lexsort((uv[:, 0], uv[:, 1], -response)))
