"""The options of the feature network, which are stored with its weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from baselines.options import Options, require

EncoderName = Literal["plain", "efficientnet-lite0"]

LAST_STAGES = (0, 1, 2, 4, 5)
"""the last stages of EfficientNet-Lite0 with 1/2, 1/4 .. 1/32 of the image's size; the seventh, of 1/32 too, is left
out"""
_MOST_WIDTHS, _MOST_CHANNELS, _COARSEST = 12, 8192, 6
"""far beyond any network that is trained; a weights file that asks for more is not genuine"""


@dataclass(frozen=True)
class NetworkOptions(Options):
    """Shape of the feature network."""

    widths: tuple[int, ...] = (32, 48, 64, 96, 128)
    """channels of the stages, finest resolution first; each stage halves the resolution"""
    finest: int = 1
    """level of the finest feature map and of the encoder's first stage: 0 is the image's own resolution, 1 half of it;
    the pixels of a 2^finest square enter the network as channels of one pixel"""
    dim: int = 16
    """D: channels of each feature map"""
    levels: int = 4
    """number of feature maps, from level ``finest`` on"""
    norm: Literal["batch", "none"] = "batch"
    """normalisation after each 3x3 convolution; batch normalisation is a fixed scaling at inference, so that a feature
    depends only on its surroundings"""
    normalise: Literal["none", "unit"] = "none"
    """``unit``: the D features of each pixel are divided by their norm, and residuals and derivatives are taken from
    the normalised map; features that are all zero stay zero"""
    confidence: bool = False
    """each level also tells how much a point counts in alignment, in (0, 1), at each pixel of the reference"""
    encoder: EncoderName = "plain"
    """``plain``: two 3x3 convolutions a stage; ``efficientnet-lite0``: its stages, for which ImageNet weights exist"""

    def __post_init__(self) -> None:
        require(self, "widths", lambda widths: widths and min(widths) >= 1, "at least one, all positive")
        require(
            self,
            "widths",
            lambda widths: len(widths) <= _MOST_WIDTHS and max(widths) <= _MOST_CHANNELS,
            f"at most {_MOST_WIDTHS}, none above {_MOST_CHANNELS}",
        )
        require(self, "finest", lambda finest: 0 <= finest <= _COARSEST, f"0 to {_COARSEST}")
        require(self, "dim", lambda dim: dim <= _MOST_CHANNELS, f"{_MOST_CHANNELS} or less")
        require(self, "dim", lambda dim: dim >= 2, "2 or more: one channel cannot place a pixel both ways")
        most = len(self.widths)
        require(self, "levels", lambda levels: 1 <= levels <= most, f"1 to {most}, the number of widths")
        if self.encoder == "efficientnet-lite0":
            require(self, "finest", lambda finest: finest == 1, "1 with this encoder")
            require(self, "norm", lambda norm: norm == "batch", "batch with this encoder")
            require(self, "widths", lambda widths: len(widths) <= len(LAST_STAGES), f"at most {len(LAST_STAGES)}")

    @property
    def least_parameters(self) -> int:
        """A lower bound of the number of parameters: those of 3x3 convolutions of the encoder or of the decoder."""
        if self.encoder != "plain":
            return sum(9 * width * width for width in self.widths[:-1])
        inputs = (3 << (2 * self.finest), *self.widths)
        return sum(9 * (inside + outside) * outside for inside, outside in zip(inputs, self.widths, strict=False))

    @property
    def stride(self) -> int:
        """Images are padded to a multiple of this number of pixels inside the network."""
        return 1 << (self.finest + len(self.widths) - 1)

    @property
    def smallest_side(self) -> int:
        """The side, in pixels, of an image whose coarsest feature map has one pixel."""
        return 1 << (self.finest + self.levels - 1)
