"""Checks that a checkpoint fits the training that resumes from it, before anything is changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from baselines.weights_file import difference
from relocbench.errors import MethodError


def restore_network(network: nn.Module, state: Mapping[str, Tensor], path: Path) -> None:
    """Load the weights of a checkpoint.

    Raises:
        MethodError: they are of another network.
    """
    check_state(network, state, path)
    network.load_state_dict(dict(state))


def check_state(network: nn.Module, state: Mapping[str, Tensor], path: Path) -> None:
    """Check that weights have the names, shapes and types of a network's.

    Raises:
        MethodError: they are of another network.
    """
    different = difference(network.state_dict(), state)
    if different:
        raise MethodError(f"a checkpoint of another network: {different}", path)


def restore_optimiser(optimiser: torch.optim.Optimizer, state: Mapping[str, Any], path: Path) -> None:
    """Load the optimiser's state of a checkpoint.

    Raises:
        MethodError: it is of another optimiser.
    """
    fault = MethodError("a checkpoint of another optimiser; remove it to train from the start", path)
    now = optimiser.state_dict()
    groups, of_parameters = state.get("param_groups"), state.get("state")
    if not isinstance(groups, list) or not isinstance(of_parameters, dict) or len(groups) != len(now["param_groups"]):
        raise fault
    for found, wanted in zip(groups, now["param_groups"], strict=True):
        if not isinstance(found, dict) or found.keys() != wanted.keys() or found["params"] != wanted["params"]:
            raise fault
        if any(type(found[key]) is not type(wanted[key]) for key in wanted):
            raise fault
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    for index, values in of_parameters.items():
        if not isinstance(index, int) or not 0 <= index < len(parameters) or not isinstance(values, dict):
            raise fault
        shapes = {parameters[index].shape, torch.Size()}
        if any(isinstance(value, Tensor) and value.shape not in shapes for value in values.values()):
            raise fault
    optimiser.load_state_dict(dict(state))
