"""Checkpoints of place-recognition networks: read without running code, checked before a network takes memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from baselines.published_weights import COUNTER, check_floats, read_weights
from relocbench.errors import MethodError, quoted

Network = TypeVar("Network", bound=nn.Module)
State = Mapping[str, Tensor]
_ENTRIES = ("state_dict", "model_state_dict")
"""of the checkpoint of a training, beside which there are the optimiser and scores"""


def read_state(path: Path) -> dict[str, Tensor]:
    """The tensors of a file of ``torch.save`` or of safetensors, by name.

    The file may be the checkpoint of a training that has them under ``state_dict`` or ``model_state_dict``; the
    ``module`` that ``torch.nn.DataParallel`` puts into names is taken out.

    Raises:
        MethodError: the file is missing, damaged, holds something else than tensors, or a tensor with more numbers
            than the file stores.
    """
    tensors = {
        name.removeprefix("module.").replace(".module.", "."): tensor
        for name, tensor in read_weights(path, *_ENTRIES).items()
    }
    for name, tensor in tensors.items():
        # A view with strides of 0 has any number of elements, and copying it takes memory for all of them.
        if tensor.untyped_storage().nbytes() < tensor.numel() * tensor.element_size():
            raise MethodError(f"{quoted(name)} has more numbers than the file stores", path)
    return tensors


def shape_of(state: State, name: str, dimensions: int, path: Path, what: str) -> tuple[int, ...]:
    """The shape of a tensor that decides the architecture.

    Args:
        dimensions: that it must have, none of them 0.
        what: was expected, in words.

    Raises:
        MethodError: there is no such tensor, or it has another number of dimensions.
    """
    if name not in state:
        raise MethodError(f"'{name}' is missing; expected {what}", path)
    shape = tuple(state[name].shape)
    if len(shape) != dimensions or 0 in shape:
        raise MethodError(f"'{name}' is {shape}, expected {dimensions} dimensions of {what}", path)
    return shape


def filled(network: Network, state: State, path: Path, what: str) -> Network:
    """A network that was made on torch's ``meta`` device, with the tensors of a file, in evaluation mode.

    Its parameters are the tensors themselves where they are float32, else copies as float32.

    Args:
        what: was expected, in words.

    Raises:
        MethodError: a tensor is missing, unknown, of another shape, or not of finite floats; it is named.
    """
    expected = network.state_dict()
    check_floats(expected, state, path, what)
    given = {name: state[name].float() for name in expected if not name.endswith(COUNTER)}
    counters = {name: torch.zeros((), dtype=torch.long) for name in expected if name.endswith(COUNTER)}
    network.load_state_dict({**given, **counters}, assign=True)
    return network.eval().requires_grad_(False)
