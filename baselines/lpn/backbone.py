"""The backbone: a classifier's network without its classifier, with maps at two depths, ``layer3`` and ``layer4``.

torchvision's ResNet (He et al., CVPR 2016), whose stages 3 and 4 these are, or EfficientNet-Lite0 with the maps after
its fifth and its last stage. With ``last_stride`` 1 what follows ``layer3`` does not halve the map, as in LPN and PCB;
the shapes of the weights do not depend on it. A ResNet's tensors have torchvision's names.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from typing import Literal, cast

import torch
from torch import Tensor, nn
from torchvision.models import ResNet, resnet18, resnet50  # type: ignore[import-untyped]
from torchvision.models.resnet import Bottleneck  # type: ignore[import-untyped]

from baselines.efficientnet_lite import DEVIATION, MEAN, STAGES, EfficientNetLite0
from baselines.initialisation import draw_weights, leave_undrawn
from baselines.lpn.options import BackboneName
from baselines.options import OptionError

_KEPT = ("conv1", "bn1", "layer1", "layer2", "layer3", "layer4")
_LAYER3 = 4
"""EfficientNet's last stage at a sixteenth of the resolution, counted from 0"""


class Backbone(nn.Module, ABC):
    """Feature maps of images."""

    channels: dict[str, int]
    """number of channels after each stage"""
    mean: tuple[float, ...] = (0.485, 0.456, 0.406)
    """of red, green and blue in [0, 1], by which images were normalised in the training of published weights"""
    deviation: tuple[float, ...] = (0.229, 0.224, 0.225)

    @property
    @abstractmethod
    def first_modules(self) -> list[nn.Module]:
        """What an image passes up to ``layer3``."""

    @property
    @abstractmethod
    def last_blocks(self) -> list[nn.Module]:
        """The blocks of ``layer4``, in order."""

    def frozen_modules(self, blocks: int) -> list[nn.Module]:
        """What does not learn where the backbone is frozen up to ``layer3`` and so many blocks of ``layer4``.

        Raises:
            OptionError: ``layer4`` has fewer blocks.
        """
        if not 0 <= blocks <= len(self.last_blocks):
            raise OptionError("frozen_blocks", blocks, f"0 to {len(self.last_blocks)} with this backbone")
        return [*self.first_modules, *self.last_blocks[:blocks]]

    def digest(self, blocks: int) -> bytes:
        """A digest of the weights and statistics of :meth:`frozen_modules`."""
        out = hashlib.sha256(type(self).__name__.encode())
        for module in self.frozen_modules(blocks):
            for name, tensor in sorted(module.state_dict().items()):
                if tensor.is_floating_point():
                    out.update(f"{name} {tuple(tensor.shape)}".encode())
                    out.update(tensor.detach().cpu().contiguous().numpy().tobytes())
        return out.digest()

    @abstractmethod
    def to_layer3(self, images: Tensor) -> Tensor:
        """The map (B, C3, H / 16, W / 16) after ``layer3`` of normalised images (B, 3, H, W)."""

    def through_last_blocks(self, x: Tensor, first: int, last: int) -> Tensor:
        """The map after the blocks ``first`` to ``last`` - 1 of ``layer4``, of the map in front of them."""
        for block in self.last_blocks[first:last]:
            x = block(x)
        return x

    def forward(self, images: Tensor) -> Tensor:
        """The map (B, C4, H / 16, W / 16) after ``layer4`` of normalised images; half that with ``last_stride`` 2."""
        return self.through_last_blocks(self.to_layer3(images), 0, len(self.last_blocks))


def make_backbone(name: BackboneName, last_stride: Literal[1, 2], generator: torch.Generator) -> Backbone:
    """A backbone with random weights.

    Args:
        name: which network.
        last_stride: of what follows ``layer3``.
        generator: source of the initial weights, distributed as torchvision's (He et al., 2015, fan-out). Torch's
            global generator is not used.
    """
    if name == "efficientnet-lite0":
        return EfficientNetBackbone(last_stride, generator)
    return ResNetBackbone(name, last_stride, generator)


class ResNetBackbone(Backbone):
    """torchvision's ResNet; arguments as of :func:`make_backbone`."""

    def __init__(
        self, name: Literal["resnet18", "resnet50"], last_stride: Literal[1, 2], generator: torch.Generator
    ) -> None:
        super().__init__()
        with torch.device("meta"):  # shapes only: no number is drawn
            net: ResNet = resnet50(weights=None) if name == "resnet50" else resnet18(weights=None)
        for part in _KEPT:
            self.add_module(part, getattr(net, part))
        if last_stride == 1:
            _keep_size(net.layer4)
        self.channels = {"layer3": net.fc.in_features // 2, "layer4": net.fc.in_features}
        leave_undrawn(self)
        draw_weights(self, generator, "fan_out")

    @property
    def first_modules(self) -> list[nn.Module]:
        return [self.get_submodule(name) for name in _KEPT[:-1]]

    @property
    def last_blocks(self) -> list[nn.Module]:
        return list(self.get_submodule("layer4").children())

    def to_layer3(self, images: Tensor) -> Tensor:
        x = nn.functional.relu(self._stage("bn1", self._stage("conv1", images)))
        x = nn.functional.max_pool2d(x, 3, stride=2, padding=1)
        for stage in ("layer1", "layer2", "layer3"):
            x = self._stage(stage, x)
        return x

    def _stage(self, name: str, x: Tensor) -> Tensor:
        return cast(Tensor, self.get_submodule(name)(x))


class EfficientNetBackbone(Backbone):
    """EfficientNet-Lite0; arguments as of :func:`make_backbone`."""

    mean, deviation = MEAN, DEVIATION

    def __init__(self, last_stride: Literal[1, 2], generator: torch.Generator) -> None:
        super().__init__()
        self.encoder = EfficientNetLite0(generator, last_stride=last_stride)
        self.channels = {"layer3": STAGES[_LAYER3].channels, "layer4": STAGES[-1].channels}

    @property
    def first_modules(self) -> list[nn.Module]:
        return [self.encoder.stem, *self.encoder.stages[: _LAYER3 + 1]]

    @property
    def last_blocks(self) -> list[nn.Module]:
        return [block for stage in self.encoder.stages[_LAYER3 + 1 :] for block in stage.children()]

    def to_layer3(self, images: Tensor) -> Tensor:
        return self.encoder.through(cast(Tensor, self.encoder.stem(images)), 0, _LAYER3)


def _keep_size(layer4: nn.Sequential) -> None:
    """Set the stride of the first block to 1, in its strided 3x3 convolution and in the shortcut."""
    block = layer4[0]
    striding = block.conv2 if isinstance(block, Bottleneck) else block.conv1
    for convolution in (striding, cast(nn.Sequential, block.downsample)[0]):
        cast(nn.Conv2d, convolution).stride = (1, 1)
