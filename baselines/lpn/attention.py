"""Local attention: how much of each number of a feature map is kept, decided by its surroundings.

    A = sigmoid(pointwise(BatchNorm(depthwise_k(X))))      X' = X * A      or      X' = X + X * A

The depth-wise convolution sees k x k pixels of one channel, the point-wise one all channels of a pixel, so that A(u)
depends on the k x k pixels about u and on nothing else. With 16 x 16 maps and four rings, rings are two pixels wide: k
= 5 reaches two pixels, k = 7 three, and so into the ring after the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import torch
from torch import Tensor, nn

from baselines.lpn.drawing import convolution, draw_weights
from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError

Stage = Literal["layer3", "layer4"]


@dataclass(frozen=True)
class AttentionOptions:
    """Where there is attention, and of which kind.

    Raises:
        ConfigError: a value that makes no sense.
    """

    after: tuple[Stage, ...] = ()
    """stages of the backbone whose output it acts on; what comes after ``layer3`` goes into ``layer4``"""
    kernel: int = 5
    """k, pixels of the stage's map; odd"""
    residual: bool = True
    """X + X * A instead of X * A"""

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        if len(set(self.after)) != len(self.after) or not set(self.after) <= {"layer3", "layer4"}:
            raise ConfigError(f"attention after {self.after}, expected layer3, layer4 or both")
        if not 1 <= self.kernel <= 255 or self.kernel % 2 == 0:
            raise ConfigError(f"the attention's kernel is {self.kernel}, expected an odd number of pixels up to 255")


class LocalAttention(nn.Module):
    """Local attention on maps of ``channels`` channels.

    Args:
        generator: where the first weights are drawn from (He et al. 2015).
    """

    def __init__(self, channels: int, kernel: int, residual: bool, generator: torch.Generator) -> None:
        super().__init__()
        self.residual = residual
        self.depthwise = convolution(channels, channels, kernel, groups=channels, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.pointwise = convolution(channels, channels, 1)
        draw_weights(self, generator, "fan_in")

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) of the same."""
        kept = x * self.weights(x)
        return x + kept if self.residual else kept

    def weights(self, x: Tensor) -> Tensor:
        """A: (B, C, H, W), between 0 and 1."""
        return torch.sigmoid(cast(Tensor, self.pointwise(self.norm(self.depthwise(x)))))
