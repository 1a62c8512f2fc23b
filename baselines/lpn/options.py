"""The options of the network, which are stored with its weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from baselines.lpn.attention import AttentionOptions
from baselines.lpn.heatmap import HeatmapOptions
from baselines.lpn.rings import RingMean
from baselines.lpn.soft_partition import SoftPartitionOptions
from baselines.options import Options, require, share_below_1

BackboneName = Literal["resnet18", "resnet50", "efficientnet-lite0"]
Partition = Literal["rings", "soft", "heatmap"]

_MOST_PARTS, _MOST_WIDTH = 256, 65536
"""far beyond any network that is trained; a weights file that asks for more is not genuine"""


@dataclass(frozen=True)
class NetworkOptions(Options):
    """Shape of the network; the defaults are LPN's."""

    backbone: BackboneName = "resnet50"
    """``resnet18`` for small datasets; ``efficientnet-lite0``, whose ImageNet weights come with the extra
    ``pretrained``, for processors"""
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
        least = 1 if self.partition == "rings" else 2
        require(
            self,
            "parts",
            lambda parts: least <= parts <= _MOST_PARTS,
            f"{least} to {_MOST_PARTS} with partition {self.partition}",
        )
        require(self, "width", lambda width: 1 <= width <= _MOST_WIDTH, f"1 to {_MOST_WIDTH}")
        share_below_1(self, "dropout")

    @property
    def least_parameters(self) -> int:
        """A lower bound of the number of parameters: those of the heads' first layers on 320 channels."""
        return self.parts * self.width * 320
