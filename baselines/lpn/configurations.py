"""The systems by name: those of a log of trials that improve on LPN, and their baselines.

``logged`` holds R@1 and AP in percent that the log reports (for ``lpn-dwdr``: that are published) for drone ->
satellite on University-1652 with ResNet-50. The numbers serve comparison only. Re-runs of LPN scatter by about 0.3 R@1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from baselines.lpn.attention import AttentionOptions
from baselines.lpn.decorrelation import DecorrelationOptions
from baselines.lpn.losses import LossOptions
from baselines.lpn.options import NetworkOptions
from baselines.lpn.partition_loss import PartitionLossOptions
from baselines.lpn.stages import FROM_LPN, INDUCED, Stage, one_stage
from relocbench.errors import ConfigError, available


class Logged(NamedTuple):
    """Reported metrics, percent."""

    r_at_1: float
    ap: float


@dataclass(frozen=True)
class Configuration:
    """One system: its network, losses, stages of training, and re-ranking."""

    name: str
    about: str
    """description in one line, for tables"""
    network: NetworkOptions = field(default_factory=NetworkOptions)
    """the network of the last stage"""
    loss: LossOptions = field(default_factory=LossOptions)
    """the losses of all stages; stages whose partition has no masks omit the partition loss"""
    stages: tuple[Stage, ...] = one_stage("rings")
    rerank_top: int = 0
    """number of candidates of each ranking that are re-ranked by aligned parts (``dmli``)"""
    paired: bool = False
    """whether each row of a batch shows the same building by drone and by satellite"""
    views: tuple[str, ...] = ("drone", "satellite")
    """views that are learnt from unless others are named"""
    backbone_rate: float = 1e-4
    """learning rate of the backbone"""
    rate: float = 1e-3
    """learning rate of everything else"""
    logged: Logged | None = None

    def network_in(self, stage: Stage) -> NetworkOptions:
        """The network's options in a stage, which has a partition of its own."""
        return replace(self.network, partition=stage.partition)

    def loss_in(self, stage: Stage) -> LossOptions:
        """The losses of a stage."""
        if stage.partition != "rings":
            return self.loss
        return replace(self.loss, partition=replace(self.loss.partition, weight=0.0))


def configuration(name: str) -> Configuration:
    """The configuration of a name.

    Raises:
        ConfigError: there is no configuration of that name.
    """
    if name not in CONFIGURATIONS:
        raise ConfigError(f"no configuration '{name}'{available(name, CONFIGURATIONS)}")
    return CONFIGURATIONS[name]


_HEATMAP = NetworkOptions(partition="heatmap")


def _attention(*after: str, kernel: int = 5, residual: bool = True) -> NetworkOptions:
    return NetworkOptions(attention=AttentionOptions(after, kernel, residual))  # type: ignore[arg-type]


def _masks(name: str, about: str, loss: PartitionLossOptions, logged: Logged | None = None) -> Configuration:
    return Configuration(name, about, _HEATMAP, LossOptions(partition=loss), FROM_LPN, logged=logged)


_ALL = (
    Configuration("global-average", "mean over the whole map, one head", NetworkOptions(parts=1)),
    Configuration("lpn", "LPN: four square rings", logged=Logged(75.93, 79.14)),
    Configuration(
        "lpn-branch5",
        "LPN + local branch after layer3, 5x5 (read as local attention with residual)",
        _attention("layer3"),
        logged=Logged(76.20, 79.41),
    ),
    Configuration(
        "lpn-branch7",
        "LPN + local branch after layer3, 7x7 (read as local attention with residual)",
        _attention("layer3", kernel=7),
        logged=Logged(76.15, 79.41),
    ),
    Configuration(
        "lpn-attention-residual",
        "LPN + local attention after layer3 and layer4, with residual (5x5: the log names no size)",
        _attention("layer3", "layer4"),
        logged=Logged(75.95, 79.22),
    ),
    Configuration(
        "lpn-attention",
        "LPN + local attention after layer3 and layer4, without residual (5x5: the log names no size)",
        _attention("layer3", "layer4", residual=False),
        logged=Logged(75.15, 78.34),
    ),
    Configuration("lpn-dmli", "LPN, first 100 sorted anew by aligned parts", rerank_top=100),
    Configuration(
        "lpn-rpp",
        "soft partition, induced: rings, part classifier, all",
        NetworkOptions(partition="soft"),
        stages=INDUCED,
        logged=Logged(56.50, 61.88),
    ),
    Configuration(
        "lpn-heatmap",
        "masks from a heatmap, from LPN's weights",
        _HEATMAP,
        stages=FROM_LPN,
        logged=Logged(58.02, 62.96),
    ),
    Configuration(
        "lpn-heatmap-scratch",
        "masks from a heatmap, from the backbone's weights",
        _HEATMAP,
        stages=one_stage("heatmap"),
        logged=Logged(48.22, 53.33),
    ),
    _masks(
        "lpn-heatmap-log",
        "masks from a heatmap + the log's partition loss",
        PartitionLossOptions(weight=1.0, form="original"),
        Logged(63.55, 67.97),
    ),
    _masks(
        "lpn-heatmap-power",
        "masks from a heatmap + partition loss, power of the variance (reconstruction)",
        PartitionLossOptions(weight=1.0, form="power"),
    ),
    _masks(
        "lpn-heatmap-power-relative",
        "masks from a heatmap + partition loss, power of variance / mean over pixels (reconstruction)",
        PartitionLossOptions(weight=1.0, form="power", over="pixels", relative=True),
    ),
    _masks(
        "lpn-heatmap-exponential",
        "masks from a heatmap + partition loss, exponential of the variance (reconstruction)",
        PartitionLossOptions(weight=1.0, form="exponential"),
    ),
    _masks(
        "lpn-heatmap-exponential-relative",
        "masks from a heatmap + partition loss, exponential of variance / mean over pixels (reconstruction)",
        PartitionLossOptions(weight=1.0, form="exponential", over="pixels", relative=True),
    ),
    Configuration(
        "lpn-dwdr",
        "LPN with true ring means + decorrelation of channels (DWDR)",
        NetworkOptions(ring_mean="ring"),
        LossOptions(decorrelation=DecorrelationOptions(weight=0.1)),
        paired=True,
        backbone_rate=3e-4,
        rate=3e-3,
        logged=Logged(81.51, 84.11),
    ),
    Configuration(
        "street",
        "the mean over the whole map, of drives along streets",
        NetworkOptions(backbone="efficientnet-lite0", parts=1, street="shared"),
        views=("street",),
    ),
)

CONFIGURATIONS = {each.name: each for each in _ALL}
"""by name, in the order of the table"""
FROM_ABOVE = tuple(each.name for each in _ALL if "satellite" in each.views)
"""the names of those for drone and satellite images"""

REPLACED_PARTITION_LOSS = Logged(71.38, 75.29)
"""what the log reports for its replacement of the partition loss, whose formula is not public; it may be compared with
the reconstructions, but belongs to none of them"""
