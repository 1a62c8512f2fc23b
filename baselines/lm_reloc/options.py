"""The options of the pose network, which are stored with its weights."""

from __future__ import annotations

from dataclasses import dataclass, field

from baselines.gn_net.options import NetworkOptions
from baselines.options import OptionError, Options, above_0, require

_MOST_SIDE, _MOST_CHANNELS, _MOST_LAYERS, _MOST_KERNEL, _MOST_FOCAL = 1024, 4096, 12, 15, 1e5
"""far beyond any network that is trained; a weights file that asks for more is not genuine"""
NUMBERS = 6
"""that a pose is predicted as"""


@dataclass(frozen=True)
class PoseNetOptions(Options):
    """Shape of the pose network.

    Raises:
        OptionError: no network can have these options.
    """

    side: int = 256
    """pixels; side of the square images that the network sees"""
    focal: float = 128.0
    """pixels; focal length of these images: with half of the side they show 90 degrees"""
    stage: int = 3
    """stage of the encoder's decoder whose map is correlated; on level finest + stage"""
    descriptor: int = 64
    """channels of a descriptor"""
    channels: tuple[int, ...] = (96, 64, 64, 64)
    """of the convolutions on the correlations"""
    kernels: tuple[int, ...] = (1, 5, 5, 5)
    """pixels; sides of these convolutions, which are not padded, so that the map shrinks"""
    hidden: int = 128
    """numbers between the last convolution and the pose"""
    depth: bool = False
    """whether the keyframe's inverse depth at each place is an input too, which it is not in LM-Reloc"""
    encoder: NetworkOptions = field(default_factory=NetworkOptions)
    """shape of the feature network, whose weights are not trained"""

    def __post_init__(self) -> None:
        above_0(self, "focal")
        require(self, "focal", lambda focal: focal <= _MOST_FOCAL, f"{_MOST_FOCAL:g} or less")
        require(self, "descriptor hidden", lambda n: 1 <= n <= _MOST_CHANNELS, f"1 to {_MOST_CHANNELS}")
        last = len(self.encoder.widths) - 1
        require(self, "stage", lambda stage: 0 <= stage <= last, f"0 to {last}, the encoder's last stage")
        stride = self.encoder.stride
        require(
            self,
            "side",
            lambda side: stride <= side <= _MOST_SIDE and side % stride == 0,
            f"a multiple of {stride}, which the encoder needs, up to {_MOST_SIDE}",
        )
        require(
            self,
            "channels",
            lambda channels: (
                1 <= len(channels) <= _MOST_LAYERS and 1 <= min(channels) <= max(channels) <= _MOST_CHANNELS
            ),
            f"1 to {_MOST_LAYERS}, each 1 to {_MOST_CHANNELS}",
        )
        require(
            self,
            "kernels",
            lambda kernels: (
                len(kernels) == len(self.channels)
                and all(1 <= kernel <= _MOST_KERNEL and kernel % 2 for kernel in kernels)
            ),
            f"as many as channels, odd and up to {_MOST_KERNEL}",
        )
        if self.last_places < 1:
            most = self.places - 1
            raise OptionError("kernels", self.kernels, f"sides that shrink the map of {self.places} by {most} at most")

    @property
    def places(self) -> int:
        """Places along each side of the map that is correlated."""
        return self.side >> (self.encoder.finest + self.stage)

    @property
    def last_places(self) -> int:
        """Places along each side of the last convolution's map."""
        return self.places - sum(kernel - 1 for kernel in self.kernels)

    @property
    def inputs(self) -> int:
        """Channels of the first convolution: a correlation with each place, and inverse depth where it is used."""
        return self.places**2 + 2 * self.depth

    @property
    def least_parameters(self) -> int:
        """A lower bound of the number of parameters: the encoder's, the convolutions' and the first linear layer's."""
        inputs = (self.inputs, *self.channels)
        layers = zip(inputs, self.channels, self.kernels, strict=False)
        convolutions = sum(inside * outside * kernel**2 for inside, outside, kernel in layers)
        return self.encoder.least_parameters + convolutions + self.channels[-1] * self.last_places**2 * self.hidden
