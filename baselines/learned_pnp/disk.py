"""DISK (Tyszkiewicz et al., NeurIPS 2020): keypoints learned by policy gradient, in kornia's module."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from torch import Tensor, nn

from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import from_kornia
from baselines.published_weights import fill, read_weights

_ENTRY = "extractor"
"""of the authors' file, beside what training needs"""


class Disk(NetworkDetector):
    """The detector with its weights; see :class:`NetworkDetector`. Keypoints are whole pixels of the shrunk image."""

    name: ClassVar[str] = "DISK"

    def load(self, weights: Path) -> nn.Module:
        net: nn.Module = from_kornia("DISK", self.name)()
        fill(net, read_weights(weights, _ENTRY), weights)
        return net

    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.net(image, n=self.features, pad_if_not_divisible=True)
        return found.keypoints, found.detection_scores, found.descriptors
