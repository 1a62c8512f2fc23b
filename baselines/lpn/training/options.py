"""What a training can be told; YAML keys and ``--set`` names are these fields."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from baselines.lpn.configurations import Configuration, configuration
from baselines.lpn.losses import LossOptions
from baselines.lpn.network import VIEWS, View
from baselines.lpn.options import NetworkOptions
from baselines.lpn.stages import Stage
from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError

_SCRATCH_RATE = 3e-3
"""of all weights where the backbone's are drawn: the recipe's rates are for weights that know pictures already. A guess
from three short trainings of ``lpn`` on rendered places that differed in more than their rates: at 1e-2 (128 pixels,
dropout 0.75, no warm-up) the loss rose above chance, at 3e-3 (96 pixels, dropout 0.25, 50 steps of warm-up) it fell, at
1e-3 (96 pixels, dropout 0.75) it fell slowly."""
_ALIGNMENT = 16


@dataclass(frozen=True)
class TrainOptions:
    """Everything that decides what is learnt, but for the data. The defaults are the recipe of LPN's authors.

    Raises:
        ConfigError: a value that makes no sense.
    """

    configuration: str = "lpn"
    """which system; decides the stages and the usual values of all other options"""
    views: tuple[View, ...] = ("drone", "satellite")
    """that are learnt from; each must be in the data, and what else is there is left out and told"""
    size: int = 256
    """pixels; images are resized to size x size"""
    epochs: dict[str, int] = field(default_factory=dict)
    """of each stage, by name"""
    steps_per_epoch: int = 0
    """0: as many as the view with fewest images fills, as the authors' loader stops there"""
    batch: int = 8
    """images of each view a step"""
    paired: bool = False
    """batches show the same places row by row in drone and satellite, half of them led by either"""
    backbone_weights: str = ""
    """file of torchvision's ResNet, such as its ImageNet weights, or of another training of LPN, whose backbone is
    taken; empty: the backbone's weights are drawn"""
    start: str = ""
    """file of an LPN network to start from; a configuration that begins with a stage of rings leaves that stage out"""
    backbone_rate: float | None = None
    """learning rate of the backbone; null: 1e-4 (the recipe's) if it has weights, 3e-3 if they are drawn"""
    rate: float | None = None
    """of all that is new; null: 1e-3 (the recipe's) if the backbone has weights, 3e-3 if they are drawn"""
    momentum: float = 0.9
    """Nesterov's"""
    weight_decay: float = 5e-4
    warm_up: int = 0
    """steps of each stage in which the rates rise from 0"""
    decay_after: float = 80 / 120
    """share of a stage's epochs after which the rates fall"""
    decay: float = 0.1
    """by this factor"""
    clip: float = 0.0
    """largest norm of the gradient; 0 for no limit"""
    pad: int = 10
    """pixels that are added on each side, by repeating the border, before a square of the size is cut out"""
    flip: float = 0.5
    """probability of the mirror image"""
    satellite_turn_deg: float = 90.0
    """a satellite image is turned by an angle between minus and plus this; what comes in from outside is black"""
    mixed_precision: bool | None = None
    """the network's forward pass in bfloat16, losses never; null: where it runs on a GPU. Processors that have
    instructions for it (AVX512-BF16, AMX) gain as well, others lose"""
    seed: int = 0
    """of first weights, batches, augmentation and dropout"""
    log_every: int = 20
    """steps"""
    validate_every: int = 10
    """epochs; also after the last of each stage"""
    checkpoint_every: int = 200
    """steps; also after each validation and stage"""
    loss: LossOptions = field(default_factory=LossOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        usual = configuration(self.configuration)
        if self.epochs.keys() - {stage.name for stage in usual.stages}:
            stages = ", ".join(stage.name for stage in usual.stages)
            raise ConfigError(f"epochs is {self.epochs}, stages of '{self.configuration}' are {stages}")
        counts = (self.log_every, self.validate_every, self.checkpoint_every, *self.epochs.values())
        if min(counts) < 1 or min(self.steps_per_epoch, self.warm_up, self.seed, self.pad) < 0 or self.batch < 2:
            raise ConfigError("epochs and intervals are 1 or more, batch 2 or more, warm_up, pad and seed 0 or more")
        if not self.views or len(set(self.views)) < len(self.views):
            raise ConfigError(f"views is {list(self.views)}, expected some of {', '.join(VIEWS)}, each once")
        if "street" in self.views and self.network.street == "none":
            raise ConfigError("views has street, network.street is none; expected separate or shared")
        if self.network.partition != usual.network.partition:
            raise ConfigError(
                f"network.partition is '{usual.network.partition}' in '{self.configuration}'; name another"
            )
        if self.size < _ALIGNMENT:
            raise ConfigError(f"size is {self.size} pixels, expected {_ALIGNMENT} or more")
        if (
            not all(0 <= share <= 1 for share in (self.decay_after, self.decay, self.flip))
            or not 0 <= self.momentum < 1
        ):
            raise ConfigError("decay_after, decay, flip and momentum lie between 0 and 1, momentum below 1")
        rates = [rate for rate in (self.backbone_rate, self.rate) if rate is not None]
        if min([1.0, *rates]) <= 0 or min(self.weight_decay, self.clip, self.satellite_turn_deg) < 0:
            raise ConfigError("rates are positive, weight_decay, clip and satellite_turn_deg are 0 or more")
        if self.paired and (self.batch % 2 or not {"drone", "satellite"} <= set(self.views)):
            raise ConfigError("paired batches hold an even number of images of drone and satellite")
        if self.loss.decorrelation.weight > 0 and not self.paired:
            raise ConfigError("loss.decorrelation needs paired=true")

    @property
    def system(self) -> Configuration:
        """The configuration with the network and the losses of these options."""
        return replace(configuration(self.configuration), network=self.network, loss=self.loss)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Those to be trained, with the epochs of these options."""
        stages = configuration(self.configuration).stages
        left = stages[1:] if self.start and len(stages) > 1 else stages
        return tuple(replace(stage, epochs=self.epochs.get(stage.name, stage.epochs)) for stage in left)

    def with_rates(self) -> TrainOptions:
        """The options with the rates that null stands for."""
        usual, drawn = configuration(self.configuration), not (self.backbone_weights or self.start)
        backbone, new = (_SCRATCH_RATE, _SCRATCH_RATE) if drawn else (usual.backbone_rate, usual.rate)
        return replace(self, backbone_rate=self.backbone_rate or backbone, rate=self.rate or new)


def usual_options(name: str) -> TrainOptions:
    """The options of a configuration.

    Raises:
        ConfigError: there is none of that name.
    """
    system = configuration(name)
    return TrainOptions(
        configuration=name,
        epochs={stage.name: stage.epochs for stage in system.stages},
        paired=system.paired,
        loss=system.loss,
        network=system.network,
    )
