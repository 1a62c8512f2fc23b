"""A trained network as one safetensors file that also says which system it is and how it came about."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from baselines.gn_net.options import options_from_dict, options_to_dict
from baselines.gn_net.training.files import write_whole
from baselines.lpn.network import LpnNetwork
from baselines.lpn.options import NetworkOptions
from relocbench.errors import ConfigError, MethodError

_KEY = "lpn"
"""the one entry of the file's metadata: several would be written in an order of their own"""
_VERSION = 1


@dataclass(frozen=True)
class About:
    """What a file of weights says of itself beside the network's shape."""

    configuration: str
    """the system's name (``configurations``)"""
    size: int
    """pixels; images had this side in training and have it at test"""
    backbone_start: str
    """where the backbone's first weights came from, in words"""
    views: tuple[str, ...]
    """it was trained on"""
    rerank_top: int = 0
    """of each ranking, so many are sorted anew by aligned parts"""
    card: Mapping[str, str] = field(default_factory=dict)
    """data, seed, steps, scores, versions"""


def save_weights(path: Path, network: LpnNetwork, about: About) -> None:
    """Write weights, options and what is known, whole or not at all; the same network gives the same bytes.

    Args:
        path: a file that ends in ``.safetensors``; an existing one is replaced.
        network: classifiers are kept, so that a training can start from it.
        about: see there.
    """
    told = {**options_to_dict(about), "views": list(about.views), "card": dict(about.card)}
    whole = {"version": _VERSION, "classes": network.classes, "network": options_to_dict(network.options), **told}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    write_whole(path, save(tensors, {_KEY: json.dumps(whole, sort_keys=True)}))


def load_weights(path: Path) -> tuple[LpnNetwork, About]:
    """The network of a file, on the CPU, in evaluation mode, and what the file says of itself.

    Raises:
        MethodError: the file is missing, damaged, of something else, or does not fit the network it names.
    """
    told, tensors = _read(path)
    try:
        options = options_from_dict(NetworkOptions, told.pop("network"))
        network = LpnNetwork(int(told.pop("classes")), options)
        about = options_from_dict(About, told)
    except (ConfigError, KeyError, ValueError) as bad:
        raise MethodError(f"what it says of its network is not understood ({bad})", path) from bad
    expected = network.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        if name not in tensors or name not in expected:
            raise MethodError(f"'{name}' is {'missing' if name in expected else 'not part of this network'}", path)
        found, wanted = tensors[name], expected[name]
        if found.shape != wanted.shape or found.dtype != wanted.dtype:
            raise MethodError(
                f"'{name}' is {tuple(found.shape)} {found.dtype}, expected {tuple(wanted.shape)} {wanted.dtype}", path
            )
        if found.is_floating_point() and not bool(found.isfinite().all()):
            raise MethodError(f"'{name}' holds numbers that are not finite", path)
    network.load_state_dict(tensors)
    return network.eval(), about


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    if not path.is_file():
        raise MethodError("no such file of weights", path)
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a mapping)
    except (SafetensorError, OSError) as bad:
        raise MethodError(f"not a readable safetensors file, damaged or cut short ({bad})", path) from bad
    try:
        told = json.loads(metadata[_KEY])
    except (KeyError, ValueError) as bad:
        raise MethodError(f"a safetensors file, but not weights of lpn (no '{_KEY}' in its metadata)", path) from bad
    if not isinstance(told, dict) or told.pop("version", None) != _VERSION:
        raise MethodError(f"weights of another version, expected version {_VERSION}", path)
    return told, tensors
