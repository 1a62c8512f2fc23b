"""A network's weights as one safetensors file that also says what network it is and where it comes from."""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions, options_from_dict, options_to_dict
from relocbench.errors import ConfigError, MethodError

_KEY = "gn-net"
"""the one entry of the file's metadata: several would be written in an order of their own"""
_VERSION = 1


def save_weights(path: Path, net: FeatureNet, card: Mapping[str, str]) -> None:
    """Write weights, options and card, whole or not at all; the same network and card give the same bytes.

    Args:
        path: a file that ends in ``.safetensors``; an existing one is replaced.
        net: as it is trained, not its copy ``for_tracking``.
        card: what a reader should know: data, seed, command, scores.

    Raises:
        MethodError: the card holds something else than text.
    """
    wrong = [key for key, value in card.items() if not isinstance(key, str) or not isinstance(value, str)]
    if wrong:
        raise MethodError(f"the model card's entries are text, {wrong[0]!r} is not", path)
    about = {"version": _VERSION, "options": options_to_dict(net.options), "card": dict(card)}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in net.state_dict().items()}
    data = save(tensors, {_KEY: json.dumps(about, sort_keys=True)})
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
    try:
        with part.open("wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def load_weights(path: Path) -> FeatureNet:
    """The network of a file, on the CPU, in evaluation mode.

    Raises:
        MethodError: the file is missing, damaged, of something else, or does not fit the network it names.
    """
    about, tensors = _read(path)
    try:
        net = FeatureNet(options_from_dict(NetworkOptions, about["options"]))
    except ConfigError as bad:
        raise MethodError(f"the network's options are not understood ({bad})", path) from bad
    expected = net.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        if name not in tensors or name not in expected:
            raise MethodError(f"'{name}' is {'missing' if name in expected else 'not part of this network'}", path)
        found, wanted = tensors[name], expected[name]
        if found.shape != wanted.shape or found.dtype != wanted.dtype:
            raise MethodError(
                f"'{name}' is {tuple(found.shape)} {found.dtype}, expected {tuple(wanted.shape)} {wanted.dtype}", path
            )
        if not bool(found.isfinite().all()):
            raise MethodError(f"'{name}' holds numbers that are not finite", path)
    net.load_state_dict(tensors)
    return net.eval()


def read_card(path: Path) -> dict[str, str]:
    """The model card of a file of weights.

    Raises:
        MethodError: the file is missing, damaged or of something else.
    """
    return {str(key): str(value) for key, value in _read(path)[0]["card"].items()}


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
        about = json.loads(metadata[_KEY])
    except (KeyError, ValueError) as bad:
        raise MethodError(f"a safetensors file, but not weights of gn-net (no '{_KEY}' in its metadata)", path) from bad
    if not isinstance(about, dict) or about.get("version") != _VERSION:
        raise MethodError(f"weights of another version, expected version {_VERSION}", path)
    if not isinstance(about.get("options"), dict) or not isinstance(about.get("card"), dict):
        raise MethodError("the metadata has no options or no card", path)
    return about, tensors
