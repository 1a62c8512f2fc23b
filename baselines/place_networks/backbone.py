"""Backbones of place-recognition networks: the layers of torchvision's ResNets and VGG16 up to a convolution.

He et al., CVPR 2016; Simonyan and Zisserman, ICLR 2015. Layers are numbered as CosPlace, pytorch-NetVlad and the Deep
Visual Geo-localization Benchmark save them: those of a ResNet are conv1, bn1, relu, maxpool, layer1 to layer4; those of
VGG16 are its features without the last ReLU and pooling.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torchvision.models  # type: ignore[import-untyped]
from torch import Tensor, nn

BackboneName = Literal["VGG16", "ResNet18", "ResNet50", "ResNet101", "ResNet152"]
_BLOCKS: dict[BackboneName, tuple[int, ...]] = {
    "ResNet18": (2, 2, 2, 2),
    "ResNet50": (3, 4, 6, 3),
    "ResNet101": (3, 4, 23, 3),
    "ResNet152": (3, 8, 36, 3),
}
"""of layer1 to layer4"""
_FIRST_STAGE = 4
"""number of layer1"""
KNOWN = f"a backbone of torchvision ({', '.join(get_args(BackboneName))}) up to its last convolution"


@dataclass(frozen=True)
class Backbone:
    """Which backbone, and up to which layer."""

    name: BackboneName
    stages: int = 4
    """of a ResNet; 3 leaves layer4 out"""

    @property
    def channels(self) -> int:
        """Number of channels of its map."""
        widest = 512 if self.name in ("VGG16", "ResNet18") else 2048
        return widest >> (4 - self.stages)

    def __str__(self) -> str:
        return self.name if self.stages == 4 else f"{self.name} without layer4"

    def make(self) -> nn.Sequential:
        """The layers, with torch's initial weights; below ``torch.device("meta")`` they take no memory."""
        network = getattr(torchvision.models, self.name.lower())(weights=None)
        if self.name == "VGG16":
            return nn.Sequential(*list(network.features.children())[:-2])
        return nn.Sequential(*list(network.children())[: _FIRST_STAGE + self.stages])


def backbone_of(state: Mapping[str, Tensor], prefix: str) -> Backbone | None:
    """The backbone whose layers a state dict has below a prefix, by the names and the first convolution.

    None if it is none of the known ones. Not all shapes are compared.
    """
    first = state.get(f"{prefix}.0.weight")
    if first is None:
        return None
    if tuple(first.shape) == (64, 3, 3, 3):
        return Backbone("VGG16")
    stages = [f"{prefix}.{_FIRST_STAGE + stage}." for stage in range(4)]
    counts = tuple(
        len({name.removeprefix(begin).partition(".")[0] for name in state if name.startswith(begin)})
        for begin in stages
    )
    kept = counts if counts[-1] else counts[:-1]
    for name, known in _BLOCKS.items():
        if known[: len(kept)] == kept:
            return Backbone(name, len(kept))
    return None
