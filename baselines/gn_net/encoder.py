"""The encoders of the feature network: maps of an image at half the resolution of one another, finest first.

    plain               stage 0: the 2^f x 2^f pixels that a pixel of level f covers become its channels, 3x3, 3x3
                        stage k: 2x2 mean, 3x3, 3x3
    efficientnet-lite0  stage k: the last map of EfficientNet-Lite0 with 1/2^(k + 1) of the resolution, 1x1

With 2x2 means, pixels of coarser maps lie at the middle of those that they cover. EfficientNet's convolutions of stride
2 are centred half a pixel beside it, in all images alike.
"""

from __future__ import annotations

from typing import cast

from torch import Tensor, nn
from torch.nn import functional

from baselines.efficientnet_lite import DEVIATION, MEAN, STAGES, EfficientNetLite0
from baselines.gn_net.options import LAST_STAGES, NetworkOptions
from baselines.initialisation import convolution, folded

_MEAN, _SPREAD = 0.45, 0.25
"""approximate mean and deviation of street images in [0, 1], by which the plain encoder's input is normalised"""


def make_encoder(options: NetworkOptions) -> nn.Module:
    """The encoder of a network, with weights that are not yet drawn.

    Called with images (B, 3, H, W) in [0, 1], of sides that are multiples of ``options.stride``, it returns a list of
    maps (B, widths[k], H / 2^(finest + k), W / 2^(finest + k)).
    """
    return PlainEncoder(options) if options.encoder == "plain" else EfficientNetEncoder(options)


class PlainEncoder(nn.ModuleList):
    """Two 3x3 convolutions a stage."""

    def __init__(self, options: NetworkOptions) -> None:
        super().__init__()
        self.finest, norm = options.finest, options.norm == "batch"
        for inside, outside in zip((3 << (2 * options.finest), *options.widths), options.widths, strict=False):
            self.append(nn.Sequential(Filter(inside, outside, norm), Filter(outside, outside, norm)))

    def forward(self, images: Tensor) -> list[Tensor]:
        x = functional.pixel_unshuffle((images - _MEAN) / _SPREAD, 1 << self.finest)
        maps: list[Tensor] = []
        for k, stage in enumerate(self):
            x = stage(functional.avg_pool2d(x, 2) if k else x)
            maps.append(x)
        return maps


class EfficientNetEncoder(nn.Module):
    """The maps of EfficientNet-Lite0, each brought to its width by a 1x1 convolution."""

    def __init__(self, options: NetworkOptions) -> None:
        super().__init__()
        self.last_stages = LAST_STAGES[: len(options.widths)]
        self.trunk = EfficientNetLite0(stages=self.last_stages[-1] + 1)
        self.lateral = nn.ModuleList(
            convolution(STAGES[stage].channels, width, 1)
            for stage, width in zip(self.last_stages, options.widths, strict=True)
        )

    def forward(self, images: Tensor) -> list[Tensor]:
        mean, deviation = (images.new_tensor(each)[:, None, None] for each in (MEAN, DEVIATION))
        maps = self.trunk((images - mean) / deviation)
        return [cast(Tensor, at(maps[stage])) for at, stage in zip(self.lateral, self.last_stages, strict=True)]


class Filter(nn.Module):
    """3x3 convolution, normalisation, ReLU."""

    def __init__(self, inside: int, outside: int, norm: bool) -> None:
        super().__init__()
        self.conv = convolution(inside, outside, 3, bias=not norm)
        self.norm: nn.Module = nn.BatchNorm2d(outside) if norm else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(self.conv(x)), inplace=True)

    def fold(self) -> None:
        """Fold the normalisation into the convolution, for inference."""
        self.conv, self.norm = folded(self.conv, self.norm)
