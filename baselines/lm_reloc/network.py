"""The pose network: from two images to the pose between them.

    encode       a frozen feature network, the same for both images
    describe     1x1 convolution to descriptors of unit norm
    correlate    all places of the keyframe with all places of the query
    convolve     convolutions without padding: the map shrinks
    regress      two linear layers to three Euler angles and a translation

After CorrPoseNet of LM-Reloc (von Stumberg et al., 3DV 2020), whose encoder is a ResNet that is trained with the rest.
"""

from __future__ import annotations

import copy
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils import skip_init

from baselines.gn_net.network import FeatureNet
from baselines.initialisation import convolution, folded
from baselines.lm_reloc.correlation import correlate, descriptors
from baselines.lm_reloc.options import NUMBERS, PoseNetOptions

ROTATION_UNIT, TRANSLATION_UNIT = 0.1, 1.0
"""radians and metres of an output of 1"""


class PoseNetwork(nn.Module):
    """Poses from maps of two images, which :meth:`encode` makes of images.

    Args:
        options: the network's shape.
        generator: source of the initial weights, but for those of the encoder; by default of seed 0.
    """

    def __init__(self, options: PoseNetOptions, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.options = options
        self.encoder = FeatureNet(options.encoder).requires_grad_(False)
        self.describer = convolution(options.encoder.widths[options.stage], options.descriptor, 1)
        layers: list[nn.Module] = []
        for inside, outside, kernel in zip(
            (options.inputs, *options.channels), options.channels, options.kernels, strict=False
        ):
            layers += [_Shrinking(inside, outside, kernel), nn.ReLU(inplace=True)]
        self.convolutions = nn.Sequential(*layers)
        self.first = _linear(options.channels[-1] * options.last_places**2, options.hidden)
        self.last = _linear(options.hidden, NUMBERS)
        units = torch.tensor([ROTATION_UNIT] * 3 + [TRANSLATION_UNIT] * 3)
        self.register_buffer("units", units, persistent=False)
        self._draw_weights(generator or torch.Generator().manual_seed(0))

    @torch.no_grad()
    def encode(self, images: Tensor) -> Tensor:
        """The encoder's maps (B, C, G, G) of images (B, 3, S, S) in [0, 1]."""
        return self.encoder.stages(images, self.options.stage)[0]

    def describe(self, maps: Tensor, seen: Tensor) -> Tensor:
        """Descriptors (B, D, G, G) of maps (B, C, G, G), zero where ``seen`` (B, G, G) is false."""
        return descriptors(self.describer(maps), seen)

    def forward(self, ref: Tensor, query: Tensor, depth_ref: Tensor) -> Tensor:
        """Predict poses.

        Args:
            ref, query: descriptors (B, D, G, G).
            depth_ref: (B, 2, G, G) inverse depth in 1/m and whether it is known; not looked at without ``depth``.

        Returns:
            (B, 6) Euler angles and translation of ``T_query_ref``, see :mod:`baselines.lm_reloc.euler`.
        """
        x = correlate(ref, query)
        if self.options.depth:
            x = torch.cat([x, depth_ref], dim=1)
        x = torch.relu(self.first(self.convolutions(x).flatten(1)))
        return cast(Tensor, self.last(x)) * cast(Tensor, self.units)

    def train(self, mode: bool = True) -> PoseNetwork:
        """As for any module, but the encoder stays as it is."""
        super().train(mode)
        self.encoder.eval()
        return self

    @property
    def parameters_count(self) -> int:
        """The number of parameters, with those of the encoder."""
        return sum(parameter.numel() for parameter in self.parameters())

    def for_tracking(self) -> PoseNetwork:
        """A copy for inference, with batch normalisation folded into the convolutions."""
        net = copy.deepcopy(self).eval().requires_grad_(False)
        net.encoder = net.encoder.for_tracking()
        for module in net.modules():
            if isinstance(module, _Shrinking):
                module.fold()
        return net

    def _draw_weights(self, generator: torch.Generator) -> None:
        """Initialise as He et al., 2015; the first predictions are near the identity."""
        for layer in (self.describer, *self.convolutions, self.first, self.last):
            of = layer.conv if isinstance(layer, _Shrinking) else layer
            if isinstance(of, nn.Conv2d | nn.Linear):
                nn.init.kaiming_normal_(of.weight, nonlinearity="relu", generator=generator)
                if of.bias is not None:
                    nn.init.zeros_(of.bias)
        with torch.no_grad():
            self.last.weight.mul_(0.1)


class _Shrinking(nn.Module):
    """A convolution without padding, and batch normalisation."""

    def __init__(self, inside: int, outside: int, kernel: int) -> None:
        super().__init__()
        self.conv = skip_init(nn.Conv2d, inside, outside, kernel, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(outside)

    def forward(self, x: Tensor) -> Tensor:
        return cast(Tensor, self.norm(self.conv(x)))

    def fold(self) -> None:
        self.conv, self.norm = folded(cast(nn.Conv2d, self.conv), self.norm)


def _linear(inside: int, outside: int) -> nn.Linear:
    return cast(nn.Linear, skip_init(nn.Linear, inside, outside))
