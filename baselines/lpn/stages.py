"""The stages of a training, and which weights each of them trains.

Most systems are trained in one stage. PCB + RPP (Sun et al., ECCV 2018) is trained by induction: uniform parts first,
then the part classifier alone, then everything; the lengths of the last two stages are those of the log. A stage starts
from the weights of the one before (``network.copy_weights``), whose partition may differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from torch import nn

from baselines.lpn.options import Partition

Group = Literal["backbone", "attention", "partition", "heads"]
"""groups of weights that are trained together; the name of a weight contains its group"""
ALL: tuple[Group, ...] = get_args(Group)


@dataclass(frozen=True)
class Stage:
    """One stage of a training."""

    name: str
    epochs: int
    partition: Partition
    """of the network in this stage"""
    trained: tuple[Group, ...] = ALL


def one_stage(partition: Partition) -> tuple[Stage, ...]:
    """A single stage of LPN's 120 epochs that trains all weights."""
    return (Stage("all", 120, partition),)


INDUCED = (
    Stage("uniform", 120, "rings"),
    Stage("classifier", 60, "soft", ("partition",)),
    Stage("refined", 50, "soft"),
)
"""PCB + RPP"""

FROM_LPN = (Stage("uniform", 120, "rings"), Stage("heatmap", 120, "heatmap"))
"""masks from a heatmap on a trained LPN; the length of the second stage is not published, 120 is our own choice"""


def group_of(name: str) -> Group:
    """The group of a parameter or module with a full name such as ``branches.air.backbone.conv1.weight``.

    Raises:
        ValueError: the name belongs to no group.
    """
    group = _group_or_none(name)
    if group is None:
        raise ValueError(f"'{name}' is in none of the groups {', '.join(ALL)}")
    return group


def enter(network: nn.Module, stage: Stage, frozen: Sequence[nn.Module] = ()) -> dict[Group, list[nn.Parameter]]:
    """Prepare a network for a stage; call it after ``network.train()``.

    Groups that are not trained, and modules that are ``frozen`` in all stages, have no derivatives, batch normalisation
    uses and keeps its statistics, and there is no dropout.

    Returns:
        The parameters to be trained, by group; groups without parameters are omitted.
    """
    trained: dict[Group, list[nn.Parameter]] = {}
    for name, module in network.named_modules():
        if (group := _group_or_none(name)) is not None:
            module.training = group in stage.trained
    for module in frozen:
        module.eval()
    kept = {id(parameter) for module in frozen for parameter in module.parameters()}
    for name, parameter in network.named_parameters():
        group = group_of(name)
        learns = group in stage.trained and id(parameter) not in kept
        parameter.requires_grad_(learns)
        if learns:
            trained.setdefault(group, []).append(parameter)
    return trained


def _group_or_none(name: str) -> Group | None:
    return next((group for group in ALL if group in name.split(".")), None)
