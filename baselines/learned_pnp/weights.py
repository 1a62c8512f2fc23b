"""Weights of published networks: files of their authors, which are fetched or given, and not part of the package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from baselines.torch_file import load_torch_file
from baselines.weights_file import difference, read_tensors
from relocbench.errors import MethodError

_SAFETENSORS = ".safetensors"


def find_weights(name: str, given: Path | None, option: str) -> Path:
    """The file of a network's weights: the one that is given, else the one in the cache of torch.

    Args:
        name: file name under which the authors publish the weights, such as ``aliked-n16.pth``.
        option: what names another file, for the message, such as ``--set aliked-pnp.weights=FILE``.

    Raises:
        MethodError: there is no such file.
    """
    if given is not None:
        return given
    cached = Path(torch.hub.get_dir()) / "checkpoints" / name
    if not cached.is_file():
        raise MethodError(f"no weights here; put {name} of its authors there, or name a file: {option}", cached)
    return cached


def read_weights(path: Path) -> dict[str, Tensor]:
    """The tensors of a file by ``torch.save`` or of safetensors, by name; no code of the file is run.

    Raises:
        MethodError: the file is missing, damaged or holds something else.
    """
    if not path.is_file():
        raise MethodError("no such file of weights", path)
    if path.suffix == _SAFETENSORS:
        return read_tensors(path)[1]
    try:
        found = load_torch_file(path)
    except ValueError as bad:
        raise MethodError(f"cannot be read as weights: {bad}", path) from bad
    if not isinstance(found, Mapping) or not all(isinstance(t, Tensor) for t in found.values()):
        raise MethodError("holds no tensors by name, which weights are", path)
    return {str(name): tensor for name, tensor in found.items()}


def fill(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Load tensors into a network in evaluation mode; buffers that follow from its options may be absent.

    Raises:
        MethodError: a tensor is missing, unknown, of another shape or type, or not finite; it is named.
    """
    expected = network.state_dict()
    learned = {name for name, _ in network.named_parameters()}
    statistics = {name for name in expected if name.rpartition(".")[2] in ("running_mean", "running_var")}
    derived = expected.keys() - learned - statistics
    known = {name: tensor for name, tensor in tensors.items() if name not in derived}
    told = difference({name: expected[name] for name in learned | statistics}, known)
    if told:
        raise MethodError(f"is of another network: {told}", path)
    for name, tensor in sorted(known.items()):
        if not bool(tensor.isfinite().all()):
            raise MethodError(f"'{name}' holds numbers that are not finite", path)
    network.load_state_dict({**expected, **known})
    network.eval()
