"""The backbone: torchvision's ResNet without its classifier, with the outputs of stages 3 and 4.

He et al., CVPR 2016. With ``last_stride`` 1 the first block of stage 4 does not halve the map, as in LPN and PCB; the
shapes of the weights do not depend on it. Tensors have torchvision's names.
"""

from __future__ import annotations

from typing import Literal, cast

import torch
from torch import Tensor, nn
from torchvision.models import ResNet, resnet18, resnet50  # type: ignore[import-untyped]
from torchvision.models.resnet import Bottleneck  # type: ignore[import-untyped]

from baselines.initialisation import draw_weights
from baselines.lpn.options import BackboneName

_KEPT = ("conv1", "bn1", "layer1", "layer2", "layer3", "layer4")


class Backbone(nn.Module):
    """Feature maps of images.

    Args:
        name: which ResNet.
        last_stride: of stage 4.
        generator: source of the initial weights, distributed as torchvision's (He et al., 2015, fan-out). Torch's
            global
            generator is not used.
    """

    def __init__(self, name: BackboneName, last_stride: Literal[1, 2], generator: torch.Generator) -> None:
        super().__init__()
        with torch.device("meta"):  # shapes only: no number is drawn
            net: ResNet = resnet50(weights=None) if name == "resnet50" else resnet18(weights=None)
        for part in _KEPT:
            self.add_module(part, getattr(net, part))
        if last_stride == 1:
            _keep_size(net.layer4)
        self.channels: dict[str, int] = {"layer3": net.fc.in_features // 2, "layer4": net.fc.in_features}
        """number of channels after each stage"""
        self.to_empty(device="cpu")
        draw_weights(self, generator, "fan_out")

    def to_layer3(self, images: Tensor) -> Tensor:
        """The map (B, C / 2, H / 16, W / 16) after stage 3 of normalised images (B, 3, H, W)."""
        x = nn.functional.relu(self._stage("bn1", self._stage("conv1", images)))
        x = nn.functional.max_pool2d(x, 3, stride=2, padding=1)
        for stage in ("layer1", "layer2", "layer3"):
            x = self._stage(stage, x)
        return x

    def to_layer4(self, x: Tensor) -> Tensor:
        """The map (B, C, H / 16, W / 16) after stage 4 of one after stage 3; half that size with ``last_stride`` 2."""
        return self._stage("layer4", x)

    def forward(self, images: Tensor) -> Tensor:
        """The map after stage 4 of normalised images."""
        return self.to_layer4(self.to_layer3(images))

    def _stage(self, name: str, x: Tensor) -> Tensor:
        return cast(Tensor, self.get_submodule(name)(x))


def _keep_size(layer4: nn.Sequential) -> None:
    """Set the stride of the first block to 1, in its strided 3x3 convolution and in the shortcut."""
    block = layer4[0]
    striding = block.conv2 if isinstance(block, Bottleneck) else block.conv1
    for convolution in (striding, cast(nn.Sequential, block.downsample)[0]):
        cast(nn.Conv2d, convolution).stride = (1, 1)
