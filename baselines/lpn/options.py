"""The options of the network, which are stored with its weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from baselines.lpn.attention import AttentionOptions
from baselines.lpn.heatmap import HeatmapOptions
from baselines.lpn.rings import RingMean
from baselines.lpn.soft_partition import SoftPartitionOptions
from baselines.options import Options
from relocbench.errors import ConfigError

BackboneName = Literal["resnet18", "resnet50"]
Partition = Literal["rings", "soft", "heatmap"]

_MOST_PARTS, _MOST_WIDTH = 256, 65536
"""far beyond any network that is trained; a weights file that asks for more is not genuine"""


@dataclass(frozen=True)
class NetworkOptions(Options):
    """Shape of the network; the defaults are LPN's.

    Raises:
        ConfigError: no network can have these options.
    """

    backbone: BackboneName = "resnet50"
    """``resnet18`` for small datasets"""
    last_stride: Literal[1, 2] = 1
    """stride of the last stage; with 1 the last map of an image of 256 pixels has 16 x 16"""
    parts: int = 4
    """P; one ring is the whole map"""
    partition: Partition = "rings"
    ring_mean: RingMean = "square"
    """``square``: as in the authors' LPN code (``rings``); ``ring``: the mean over the ring, as in their DWDR code"""
    soft: SoftPartitionOptions = field(default_factory=SoftPartitionOptions)
    heatmap: HeatmapOptions = field(default_factory=HeatmapOptions)
    attention: AttentionOptions = field(default_factory=AttentionOptions)
    street: Literal["none", "separate", "shared"] = "none"
    """whether the street view has a branch of its own, shares that of drone and satellite, or is absent"""
    width: int = 512
    """D, the size of a part's embedding"""
    dropout: float = 0.75
    """share of the embedding that is dropped in front of the classifier in training"""

    def __post_init__(self) -> None:
        if self.backbone not in ("resnet18", "resnet50"):
            raise ConfigError(f"backbone is '{self.backbone}', expected resnet18 or resnet50")
        if self.last_stride not in (1, 2):
            raise ConfigError(f"last_stride is {self.last_stride}, expected 1 or 2")
        if self.partition not in ("rings", "soft", "heatmap"):
            raise ConfigError(f"partition is '{self.partition}', expected rings, soft or heatmap")
        if self.parts < 1 or (self.parts < 2 and self.partition != "rings"):
            raise ConfigError(f"parts is {self.parts}, expected 1 or more with rings, 2 or more with masks")
        if self.ring_mean not in ("square", "ring"):
            raise ConfigError(f"ring_mean is '{self.ring_mean}', expected square or ring")
        if self.street not in ("none", "separate", "shared"):
            raise ConfigError(f"street is '{self.street}', expected none, separate or shared")
        if self.parts > _MOST_PARTS or self.width > _MOST_WIDTH:
            raise ConfigError(f"parts are at most {_MOST_PARTS}, width at most {_MOST_WIDTH}")
        if self.width < 1 or not 0 <= self.dropout < 1:
            raise ConfigError("width is at least 1, dropout is 0 or more and below 1")

    @property
    def least_parameters(self) -> int:
        """A lower bound of the number of parameters: those of the heads' first layers on 512 channels."""
        return self.parts * self.width * 512
