"""What a network can be told, checked once and stored with its weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError

_MOST_WIDTHS, _MOST_CHANNELS, _COARSEST = 12, 8192, 6
"""far beyond any network that is trained; a file of weights that asks for more is not what it says"""


@dataclass(frozen=True)
class NetworkOptions:
    """Shape of the feature network.

    Raises:
        ConfigError: a combination that no network can have.
    """

    widths: tuple[int, ...] = (32, 48, 64, 96, 128)
    """channels of the encoder, finest resolution first; one pooling between neighbours"""
    finest: int = 1
    """level of the finest feature map, and of the encoder's first resolution: 0 is the image's own, 1 half of it; the
    pixels of a 2^finest square go into the network as channels of one"""
    dim: int = 16
    """D: channels of each feature map"""
    levels: int = 4
    """feature maps that come out, levels ``finest`` to ``finest + levels - 1``"""
    norm: Literal["batch", "none"] = "batch"
    """after each 3x3 convolution; batch normalisation is a fixed scaling at run time, so that a feature depends on its
    surroundings and not on the rest of the image"""
    normalise: Literal["none", "unit"] = "none"
    """``unit``: each pixel's D features are divided by their norm; residuals and derivatives are both taken from the
    divided map; a pixel without any feature stays zero"""

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        if not self.widths or min(self.widths) < 1:
            raise ConfigError(f"widths is {self.widths}, expected at least one, all positive")
        if len(self.widths) > _MOST_WIDTHS or max(self.widths) > _MOST_CHANNELS:
            raise ConfigError(f"widths are at most {_MOST_WIDTHS}, and none is above {_MOST_CHANNELS}")
        if not 0 <= self.finest <= _COARSEST:
            raise ConfigError(f"finest is {self.finest}, expected 0 to {_COARSEST}")
        if self.dim > _MOST_CHANNELS:
            raise ConfigError(f"dim is {self.dim}, expected {_MOST_CHANNELS} or less")
        if self.dim < 2:
            raise ConfigError(f"dim is {self.dim}, expected 2 or more: one channel cannot place a pixel both ways")
        if not 1 <= self.levels <= len(self.widths):
            raise ConfigError(f"levels is {self.levels}, expected 1 to {len(self.widths)}, the number of widths")
        if self.norm not in ("batch", "none"):
            raise ConfigError(f"norm is '{self.norm}', expected batch or none")
        if self.normalise not in ("none", "unit"):
            raise ConfigError(f"normalise is '{self.normalise}', expected none or unit")

    @property
    def least_parameters(self) -> int:
        """Number of weights in the encoder's 3x3 convolutions, which every network of these options has at least."""
        inputs = (3 << (2 * self.finest), *self.widths)
        return sum(9 * (inside + outside) * outside for inside, outside in zip(inputs, self.widths, strict=False))

    @property
    def stride(self) -> int:
        """2^depth: images are padded to a multiple of it inside the network."""
        return 1 << (self.finest + len(self.widths) - 1)

    @property
    def smallest_side(self) -> int:
        """Pixels of an image whose coarsest feature map has one pixel."""
        return 1 << (self.finest + self.levels - 1)
