"""What a training can be told; YAML keys and ``--set`` names are these fields."""

from __future__ import annotations

from dataclasses import dataclass, field

from baselines.gn_net.losses import LossOptions
from baselines.gn_net.options import NetworkOptions
from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError


@dataclass(frozen=True)
class AugmentationOptions:
    """Strengths of photometric changes, each image on its own; 0 leaves one out. Geometry is never touched.

    Raises:
        ConfigError: a negative strength, or a probability above 1.
    """

    probability: float = 0.8
    """that an image is changed at all"""
    gain: float = 0.3
    """log of a factor on all channels, uniform in +- this"""
    offset: float = 0.05
    """added to all channels, uniform in +- this"""
    gamma: float = 0.3
    """log of an exponent, uniform in +- this"""
    contrast: float = 0.3
    """log of a factor about the image's mean, uniform in +- this"""
    colour: float = 0.1
    """log of a factor on each channel, uniform in +- this; and on the saturation, in +- three times this"""
    grey: float = 0.1
    """probability of no colour at all"""
    noise: float = 0.03
    """standard deviation of each pixel's noise, uniform in 0 .. this"""
    blur: float = 1.0
    """pixels; sigma of a Gaussian, uniform in 0 .. this, on half of the images"""
    vignetting: float = 0.3
    """share of the light that is lost in the corners, uniform in 0 .. this"""

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        strengths = (self.gain, self.offset, self.gamma, self.contrast, self.colour, self.noise, self.blur)
        if min(strengths) < 0 or not all(0 <= share <= 1 for share in (self.probability, self.grey, self.vignetting)):
            raise ConfigError("strengths of augmentation are 0 or more; probability, grey and vignetting at most 1")


@dataclass(frozen=True)
class TrainOptions:
    """Everything that decides what is learnt, but for the data.

    Raises:
        ConfigError: a value that makes no sense.
    """

    steps: int = 2000
    batch: int = 4
    """pairs a step; as many combinations of conditions, if there are so many"""
    crop: int = 224
    """pixels; side of the squares that are cut out of both images"""
    apart: float = 0.4
    """share of the side; the query's square is moved off the reference's by at most so much, so that the place in the
    square says nothing about which point it is"""
    scale: tuple[float, float] = (0.6, 1.0)
    """images are scaled by a factor between these before they are cut, both of a pair alike; (1, 1) for never"""
    points: int = 1024
    """correspondences a pair, drawn among those that both cuts hold"""
    max_sigma: float = 1.0
    """pixels; correspondences whose true place is known less surely are left out, where the data tells"""
    swap: float = 0.5
    """probability that reference and query change their roles"""
    mirror: float = 0.5
    """probability that both images are mirrored left to right: a second town for nothing"""
    learning_rate: float = 3e-3
    """of Adam, at its highest"""
    warm_up: int = 100
    """steps in which the rate rises from 0"""
    final_rate: float = 0.01
    """of the highest rate, reached at the last step along a half cosine"""
    weight_decay: float = 1e-4
    """of AdamW; 0 is Adam"""
    clip: float = 10.0
    """largest norm of the gradient; 0 for no limit"""
    ema: float = 0.999
    """the weights that are validated and kept are the running mean of those that are trained, by this factor a step; 0
    for the trained ones themselves"""
    mixed_precision: bool | None = None
    """the network's forward pass in bfloat16, losses never; null: where it runs on a GPU. Processors that have
    instructions for it (AVX512-BF16, AMX) gain as well, others lose"""
    seed: int = 0
    """of first weights, pairs, cuts, augmentation, starts and negatives"""
    log_every: int = 20
    validate_every: int = 500
    """steps; also after the last"""
    checkpoint_every: int = 100
    """steps; also after each validation"""
    augmentation: AugmentationOptions = field(default_factory=AugmentationOptions)
    loss: LossOptions = field(default_factory=LossOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        counts = (self.steps, self.batch, self.points, self.log_every, self.validate_every, self.checkpoint_every)
        if min(counts) < 1 or self.warm_up < 0 or self.seed < 0:
            raise ConfigError("steps, batch, points and intervals are 1 or more, warm_up and seed 0 or more")
        if not 0 < self.scale[0] <= self.scale[1]:
            raise ConfigError(f"scale is {self.scale}, expected two positive factors, the smaller one first")
        if not (0 <= self.apart < 1 and 0 <= self.ema < 1) or not all(
            0 <= share <= 1 for share in (self.swap, self.mirror, self.final_rate)
        ):
            raise ConfigError("apart, swap, mirror, ema and final_rate lie between 0 and 1, apart and ema below 1")
        if min(self.learning_rate, self.max_sigma) <= 0 or min(self.weight_decay, self.clip) < 0:
            raise ConfigError("learning_rate and max_sigma are positive, weight_decay and clip are 0 or more")
        smallest = 4 * self.network.smallest_side
        if self.crop < smallest:
            raise ConfigError(f"crop is {self.crop}, the network's coarsest level needs {smallest} or more")
        if len(self.loss.level_weights) != self.network.levels:
            raise ConfigError(
                f"loss.level_weights has {len(self.loss.level_weights)} entries, "
                f"the network has {self.network.levels} levels"
            )
