"""Partition by masks that are computed from a heatmap of activations.

    h(u) = sum over c of X_c(u)      M = softmax over P of conv(relu(conv(h)))      part p = mean over u of M_p(u) X(u)

h has one channel, so that a mask depends on the activation around a pixel and, by the zero padding, on its distance
from the border. Width and kernel sizes of the two convolutions are not published; 16 channels and 3 x 3 pixels are our
own choice. The sum over 2048 channels is 2048 times their mean, which makes the initial softmax nearly one-hot; ``heat
= "mean"`` divides by the number of channels, which is our own alternative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.initialisation import convolution, draw_weights
from baselines.lpn.pooling import PartMean, Parts, masked_means
from baselines.options import Options, require


@dataclass(frozen=True)
class HeatmapOptions(Options):
    """Options of the network that computes the masks."""

    heat: Literal["sum", "mean"] = "sum"
    """whether h is the sum of the channels or their mean"""
    hidden: int = 16
    """number of channels between the two convolutions"""
    kernel: int = 3
    """size of both convolutions, an odd number of pixels"""
    mean: PartMean = "all"
    """``all``: mean over all pixels; ``mask``: weighted mean, divided by the sum of the mask"""

    def __post_init__(self) -> None:
        require(self, "hidden", lambda hidden: 1 <= hidden <= 4096, "1 to 4096 channels")
        require(self, "kernel", lambda k: 1 <= k <= 255 and k % 2, "an odd number of pixels up to 255")


class HeatmapPartition(nn.Module):
    """The network that computes the masks of P parts, drawn as by He et al., 2015, and pooling by them."""

    def __init__(self, parts: int, options: HeatmapOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.options = options
        self.first = convolution(1, options.hidden, options.kernel)
        self.second = convolution(options.hidden, parts, options.kernel)
        draw_weights(self, generator, "fan_in")

    def masks(self, x: Tensor) -> Tensor:
        """The masks (B, P, H, W) of a map (B, C, H, W); they sum to 1 over P."""
        heat = heatmap(x) if self.options.heat == "sum" else heatmap(x) / x.shape[1]
        return cast(Tensor, self.second(functional.relu(self.first(heat)))).softmax(1)

    def forward(self, x: Tensor) -> Parts:
        """The features (B, P, C) and masks of the parts of a map (B, C, H, W)."""
        masks = self.masks(x)
        return Parts(masked_means(x, masks, self.options.mean), masks)


def heatmap(x: Tensor) -> Tensor:
    """The heatmap h (B, 1, H, W), the sum over the channels of a map (B, C, H, W)."""
    return x.sum(1, keepdim=True)
