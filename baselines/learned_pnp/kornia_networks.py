"""Detectors whose networks are those of the package kornia, which is optional.

ALIKED: Zhao et al., IEEE TIM 2023, keypoints and descriptors by deformable convolutions. DISK: Tyszkiewicz et al.,
NeurIPS 2020, keypoints learned by policy gradient. XFeat: Potje et al., CVPR 2024, for processors without a GPU.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from torch import Tensor, nn

from baselines.learned_pnp.detector import NetworkDetector
from baselines.published_weights import fill, read_weights
from relocbench.errors import MethodError

AlikedModel = Literal["n16", "n16rot", "n32", "t16"]
_DISK_ENTRY = "extractor"
"""of the authors' file, beside what training needs"""


def from_kornia(name: str, network: str) -> Any:
    """What kornia's ``kornia.feature`` has by a name; nothing is downloaded.

    Args:
        network: what the user calls it, for the message.

    Raises:
        MethodError: kornia is not installed.
    """
    try:
        import kornia.feature
    except ModuleNotFoundError as bad:
        if bad.name is None or bad.name.partition(".")[0] != "kornia":
            raise
        raise MethodError(f"{network} needs the package kornia: pip install 'relocbench[learned]'") from bad
    return getattr(kornia.feature, name)


@dataclass(eq=False)
class Aliked(NetworkDetector):
    """The detector with its weights; see :class:`NetworkDetector`.

    Args:
        model: variant that the weights are of.
    """

    name: ClassVar[str] = "ALIKED"

    model: AlikedModel = "n16"

    def load(self, weights: Path) -> nn.Module:
        # A threshold of 0 selects the strongest maxima.
        made = from_kornia("ALIKED", self.name)
        net: nn.Module = made(f"aliked-{self.model}", max_num_keypoints=self.features, detection_threshold=0.0)
        fill(net, read_weights(weights), weights)
        return net

    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.net(image)
        return found.keypoints, found.keypoint_scores, found.descriptors


class Disk(NetworkDetector):
    """The detector with its weights; see :class:`NetworkDetector`. Keypoints are whole pixels of the shrunk image."""

    name: ClassVar[str] = "DISK"

    def load(self, weights: Path) -> nn.Module:
        net: nn.Module = from_kornia("DISK", self.name)()
        fill(net, read_weights(weights, _DISK_ENTRY), weights)
        return net

    def find(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        (found,) = self.net(image, n=self.features, pad_if_not_divisible=True)
        return found.keypoints, found.detection_scores, found.descriptors


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
