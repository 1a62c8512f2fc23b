"""ALIKED (Zhao et al., IEEE TIM 2023): keypoints and descriptors by deformable convolutions, in kornia's module."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from torch import Tensor, nn

from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import from_kornia
from baselines.published_weights import fill, read_weights

AlikedModel = Literal["n16", "n16rot", "n32", "t16"]


class Aliked(NetworkDetector):
    """The detector with its weights; see :class:`NetworkDetector`.

    Args:
        model: variant that the weights are of.
    """

    name: ClassVar[str] = "ALIKED"

    def __init__(
        self,
        weights: Path,
        features: int,
        longest_px: int,
        device: str,
        model: AlikedModel = "n16",
        cache_size: int = 0,
    ) -> None:
        self.model = model
        super().__init__(weights, features, longest_px, device, cache_size)

    def load(self, weights: Path) -> nn.Module:
        # A threshold of 0 selects the strongest maxima.
        made = from_kornia("ALIKED", self.name)
        net: nn.Module = made(f"aliked-{self.model}", max_num_keypoints=self.features, detection_threshold=0.0)
        fill(net, read_weights(weights), weights)
        return net

    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.net(image)
        return found.keypoints, found.keypoint_scores, found.descriptors
