"""XFeat (Potje et al., CVPR 2024): features for processors without a GPU, in kornia's module."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from torch import Tensor, nn

from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import from_kornia
from baselines.published_weights import fill, read_weights


class XFeat(NetworkDetector):
    """The detector with its weights; see :class:`NetworkDetector`. Keypoints are whole pixels of the shrunk image."""

    name: ClassVar[str] = "XFeat"
    # kornia would shrink to such a size itself, and multiply pixels by the ratio of the sizes: up to half a pixel off.
    multiple: ClassVar[int] = 32

    def load(self, weights: Path) -> nn.Module:
        net = from_kornia("XFeat", self.name)(top_k=self.features)
        fill(net.net, read_weights(weights), weights)
        made: nn.Module = net.eval()
        return made

    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.net.detectAndCompute(image)
        return found["keypoints"], found["scores"], found["descriptors"]
