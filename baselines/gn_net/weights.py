"""The weights file of the feature network, with its options and its card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
from baselines.options import options_from_dict
from baselines.weights_file import check_enough, fill_network, read_network, write_network
from relocbench.errors import ConfigError, MethodError

_KIND = "gn-net"


def save_weights(path: Path, net: FeatureNet, card: Mapping[str, str]) -> None:
    """Write weights, options and card, as :func:`baselines.weights_file.write_network` does.

    Args:
        net: as it is trained, not a copy ``for_tracking``.
        card: what a reader should know, such as data, seed and scores.

    Raises:
        MethodError: an entry of the card is not text.
    """
    wrong = [key for key, value in card.items() if not isinstance(key, str) or not isinstance(value, str)]
    if wrong:
        raise MethodError(f"the model card's entries must be text, {wrong[0]!r} is not", path)
    write_network(path, _KIND, net, {"options": asdict(net.options), "card": dict(card)})


def load_weights(path: Path) -> FeatureNet:
    """The network of a weights file, on the CPU, in evaluation mode.

    Raises:
        MethodError: the file is missing, damaged, of another kind, or does not fit the network that it describes.
    """
    about, tensors = _read(path)
    try:
        options = options_from_dict(NetworkOptions, about["options"])
    except ConfigError as bad:
        raise MethodError(f"the network's options are not understood ({bad})", path) from bad
    check_enough(tensors, options.least_parameters, path)
    net = FeatureNet(options)
    fill_network(net, tensors, path)
    return net.eval()


def read_card(path: Path) -> dict[str, str]:
    """The card in a weights file.

    Raises:
        MethodError: the file is missing, damaged or of another kind.
    """
    return {str(key): str(value) for key, value in _read(path)[0]["card"].items()}


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    about, tensors = read_network(path, _KIND)
    if not isinstance(about.get("options"), dict) or not isinstance(about.get("card"), dict):
        raise MethodError("the metadata has no options or no card", path)
    return about, tensors
