"""Local attention: each value of a feature map is weighted by a function of its surroundings.

    A = sigmoid(pointwise(BatchNorm(depthwise_k(X))))      X' = X * A      or      X' = X + X * A

The depth-wise convolution sees k x k pixels of one channel, the point-wise one all channels of a pixel, so that A(u)
depends only on the k x k pixels around u. On 16 x 16 maps with four rings, each ring is two pixels wide; k = 5 reaches
two pixels to each side and k = 7 three, which is into the ring after the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import torch
from torch import Tensor, nn

from baselines.initialisation import convolution, draw_weights
from baselines.options import Options, require

Stage = Literal["layer3", "layer4"]


@dataclass(frozen=True)
class AttentionOptions(Options):
    """Where attention is applied, and its form."""

    after: tuple[Stage, ...] = ()
    """stages of the backbone whose output it weights; attention after ``layer3`` is in front of ``layer4``"""
    kernel: int = 5
    """k, an odd number of pixels of the stage's map"""
    residual: bool = True
    """X + X * A instead of X * A"""

    def __post_init__(self) -> None:
        require(self, "after", lambda after: len(set(after)) == len(after), "layer3, layer4, both or none")
        require(self, "kernel", lambda k: 1 <= k <= 255 and k % 2, "an odd number of pixels up to 255")


class LocalAttention(nn.Module):
    """Local attention, whose initial weights are drawn as by He et al., 2015."""

    def __init__(self, channels: int, kernel: int, residual: bool, generator: torch.Generator) -> None:
        super().__init__()
        self.residual = residual
        self.depthwise = convolution(channels, channels, kernel, groups=channels, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.pointwise = convolution(channels, channels, 1)
        draw_weights(self, generator, "fan_in")

    def forward(self, x: Tensor) -> Tensor:
        """The weighted map (B, C, H, W) of a map (B, C, H, W)."""
        kept = x * self.weights(x)
        return x + kept if self.residual else kept

    def weights(self, x: Tensor) -> Tensor:
        """The weights A (B, C, H, W), between 0 and 1."""
        return torch.sigmoid(cast(Tensor, self.pointwise(self.norm(self.depthwise(x)))))
