"""Weights of published networks: files of their authors, which are fetched or given, and not part of the package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from baselines.torch_file import load_torch_file
from baselines.weights_file import difference, read_tensors
from relocbench.errors import MethodError, quoted
from relocbench.weights import PublishedFile

_SAFETENSORS = ".safetensors"
COUNTER = ".num_batches_tracked"
"""of a batch normalisation: absent in older files and without influence"""


def cache_of(file: PublishedFile) -> Path:
    """Where torch and the libraries on it keep a published file: ``$TORCH_HOME/hub/checkpoints``."""
    return Path(torch.hub.get_dir()) / "checkpoints" / file.name


def by_place(*files: PublishedFile) -> dict[Path, PublishedFile]:
    """Published files by where they are kept."""
    return {cache_of(file): file for file in files}


def find_weights(file: PublishedFile, given: Path | None, method: str, parameter: str = "weights") -> Path:
    """The file of a network's weights: the one that is given, else the one in the cache of torch.

    Args:
        file: as its authors publish it.
        method, parameter: installed name of the method and its parameter for another file, for the message.

    Raises:
        MethodError: there is no such file.
    """
    if given is not None:
        return Path(given)
    cached = cache_of(file)
    if not cached.is_file():
        raise MethodError(
            f"no weights here; put {file.name} of its authors there (relocbench fetch-weights {method}), "
            f"or name a file: --set {method}.{parameter}=FILE",
            cached,
        )
    return cached


class PublishedWeights:
    """A method whose weights are a file that their authors publish, or the one that the parameter ``weights`` names."""

    name: ClassVar[str]
    """that it is installed by"""
    authors_file: ClassVar[PublishedFile]

    @classmethod
    def file(cls, **_: Any) -> PublishedFile:
        """The authors' file for the method's parameters. Raises MethodError if there is none."""
        return cls.authors_file

    @classmethod
    def files(cls, weights: Path | None = None, **parameters: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        if weights is not None:
            return {"weights": Path(weights)}
        return {"weights": find_weights(cls.file(**parameters), None, cls.name)}

    @classmethod
    def published(cls, **parameters: Any) -> dict[Path, PublishedFile]:
        """The files of the authors, by where they are looked for."""
        return by_place(cls.file(**parameters))


def read_weights(path: Path, *entries: str) -> dict[str, Tensor]:
    """The tensors of a file by ``torch.save`` or of safetensors, by name; no code of the file is run.

    Args:
        entries: of the file; if it has one of them, the tensors are in the first one that it has.

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
    if isinstance(found, Mapping):
        found = next((found[entry] for entry in entries if entry in found), found)
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
    message = difference({name: expected[name] for name in learned | statistics}, known)
    if message:
        raise MethodError(f"is of another network: {message}", path)
    for name, tensor in sorted(known.items()):
        if not bool(tensor.isfinite().all()):
            raise MethodError(f"'{name}' holds numbers that are not finite", path)
    network.load_state_dict({**expected, **known})
    network.eval()


def check_floats(expected: Mapping[str, Tensor], tensors: Mapping[str, Tensor], path: Path, what: str) -> None:
    """Check that a file has the tensors of a network, as floats of any precision; counters do not matter.

    Args:
        what: was expected, in words.

    Raises:
        MethodError: a tensor is missing, unknown, of another shape, or not of finite floats; it is named.
    """
    for name in sorted(expected.keys() | tensors.keys()):
        if name.endswith(COUNTER):
            continue
        if name not in tensors or name not in expected:
            fault = "missing" if name in expected else "not part of this network"
            raise MethodError(f"{quoted(name)} is {fault}; expected {what}", path)
        shape, wanted = tuple(tensors[name].shape), tuple(expected[name].shape)
        if shape != wanted:
            raise MethodError(f"'{name}' is {shape}, expected {wanted} of {what}", path)
        if not tensors[name].is_floating_point() or not bool(tensors[name].isfinite().all()):
            raise MethodError(f"'{name}' holds values that are not finite floats; expected {what}", path)
