"""Which weights are trained when.

Most systems are trained in one go. PCB + RPP (Sun et al., ECCV 2018) is trained by induction: uniform parts first, then
the part classifier alone, then all; lengths of the last two stages as in the log. A later stage starts from the weights
of the one before (``network.copy_weights``), which may have another partition.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from torch import nn

from baselines.lpn.options import Partition

Group = Literal["backbone", "attention", "partition", "heads"]
"""weights that are trained together; a weight's group stands in its name"""
ALL: tuple[Group, ...] = get_args(Group)


@dataclass(frozen=True)
class Stage:
    """One stretch of a training."""

    name: str
    epochs: int
    partition: Partition
    """of the network in this stage"""
    trained: tuple[Group, ...] = ALL


def one_stage(partition: Partition) -> tuple[Stage, ...]:
    """All weights, LPN's 120 epochs."""
    return (Stage("all", 120, partition),)


INDUCED = (
    Stage("uniform", 120, "rings"),
    Stage("classifier", 60, "soft", ("partition",)),
    Stage("refined", 50, "soft"),
)
"""PCB + RPP"""

FROM_LPN = (Stage("uniform", 120, "rings"), Stage("heatmap", 120, "heatmap"))
"""the heatmap's masks on a trained LPN; the length of the second stage is not published, 120 is our own choice"""


def group_of(name: str) -> Group:
    """The group of a parameter or module by its full name, such as ``branches.air.backbone.conv1.weight``.

    Raises:
        ValueError: the name is of no group.
    """
    group = _group_or_none(name)
    if group is None:
        raise ValueError(f"'{name}' is in none of the groups {', '.join(ALL)}")
    return group


def enter(network: nn.Module, stage: Stage) -> dict[Group, list[nn.Parameter]]:
    """Set what is trained in a stage; to be called again after ``network.train()``.

    What is not trained stands still altogether: no derivatives, batch normalisation keeps its statistics and uses them,
    nothing is dropped.

    Returns:
        The parameters to be trained, by group; a group without any is left out.
    """
    trained: dict[Group, list[nn.Parameter]] = {}
    for name, module in network.named_modules():
        if (group := _group_or_none(name)) is not None:
            module.training = group in stage.trained
    for name, parameter in network.named_parameters():
        group = group_of(name)
        parameter.requires_grad_(group in stage.trained)
        if group in stage.trained:
            trained.setdefault(group, []).append(parameter)
    return trained


def _group_or_none(name: str) -> Group | None:
    return next((group for group in ALL if group in name.split(".")), None)
