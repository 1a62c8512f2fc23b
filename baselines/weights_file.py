"""Weights files: safetensors with the network's options and origin as JSON in the metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor, nn

from baselines.files import write_whole
from relocbench.errors import MethodError
from relocbench.pointers import pointer_fault

_VERSION = 1
_MOST_HEADER_BYTES = 2**24
"""for names, shapes and metadata; LPN's have 30 KB"""
_MOST_QUOTED = 160


def write_network(path: Path, kind: str, network: nn.Module, about: Mapping[str, Any]) -> None:
    """Write weights and their description, whole or not at all; equal arguments give equal bytes.

    Args:
        path: must end in ``.safetensors``; an existing file is replaced.
        kind: of network. It is the only key of the file's metadata, since the order of several would not be fixed.
        network: all its parameters and buffers are written.
        about: the description, plain values.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    write_whole(path, save(tensors, {kind: json.dumps({**about, "version": _VERSION}, sort_keys=True)}))


def read_network(path: Path, kind: str) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The description and the tensors that :func:`write_network` wrote, on the CPU.

    Raises:
        MethodError: the file is missing, damaged or of another kind.
    """
    metadata, tensors = read_tensors(path)
    try:
        about = json.loads(metadata[kind])
    except (KeyError, ValueError, RecursionError) as bad:
        raise MethodError(f"a safetensors file, but not weights of {kind} (no '{kind}' in its metadata)", path) from bad
    if not isinstance(about, dict) or about.pop("version", None) != _VERSION:
        raise MethodError(f"weights of another version, expected version {_VERSION}", path)
    return about, tensors


def read_tensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """The metadata and tensors of a safetensors file. Tensors are mapped, and read when they are used.

    Raises:
        MethodError: the file is missing or damaged, or its header is too long.
    """
    if not path.is_file():
        raise MethodError("no such file of weights", path)
    pointer = pointer_fault(path)
    if pointer is not None:
        raise MethodError(f"{pointer}; expected weights", path)
    fault = "not a readable safetensors file, damaged or cut short"
    try:
        with path.open("rb") as stream:
            header_bytes = int.from_bytes(stream.read(8), "little")
        if header_bytes > _MOST_HEADER_BYTES:
            raise MethodError(f"{fault} (its header would be {header_bytes} bytes, at most {_MOST_HEADER_BYTES})", path)
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a mapping)
            return dict(file.metadata() or {}), tensors
    except MethodError:
        raise
    # Besides SafetensorError: number types that torch lacks raise exceptions of various kinds.
    except Exception as bad:
        reason = " ".join(str(bad).split())[:_MOST_QUOTED]
        raise MethodError(f"{fault} ({reason})", path) from bad


def check_enough(tensors: Mapping[str, Tensor], least: int, path: Path) -> None:
    """Check that a file has enough numbers for the network that it describes, before that network is made.

    Raises:
        MethodError: the tensors have fewer than ``least`` numbers.
    """
    count = sum(tensor.numel() for tensor in tensors.values())
    if count < least:
        raise MethodError(f"its metadata describe a network of {least} numbers or more; it holds {count}", path)


def holds_network(path: Path, kind: str) -> bool:
    """Whether :func:`write_network` wrote a file for this kind of network; false if it cannot be read."""
    try:
        return kind in read_tensors(path)[0]
    except MethodError:
        return False


def fill_network(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Load the tensors of a file into a network.

    Raises:
        MethodError: a tensor is missing, unknown, of another shape or type, or not finite; it is named.
    """
    different = difference(network.state_dict(), tensors)
    if different:
        raise MethodError(different, path)
    for name, tensor in sorted(tensors.items()):
        if not bool(tensor.isfinite().all()):
            raise MethodError(f"'{name}' holds numbers that are not finite", path)
    network.load_state_dict(dict(tensors))


def difference(expected: Mapping[str, Tensor], found: Mapping[str, Tensor]) -> str | None:
    """The first difference in names, shapes or types of two states, in words; None if there is none."""
    for name in sorted(expected.keys() | set(map(str, found))):
        if name not in found or name not in expected:
            return f"'{name[:_MOST_QUOTED]}' is {'missing' if name in expected else 'not part of this network'}"
        given, wanted = found[name], expected[name]
        if given.shape != wanted.shape or given.dtype != wanted.dtype:
            return f"'{name}' is {tuple(given.shape)} {given.dtype}, expected {tuple(wanted.shape)} {wanted.dtype}"
    return None
