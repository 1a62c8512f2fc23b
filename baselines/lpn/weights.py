"""The weights file of a trained network, which also says which system it is and how it was trained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from baselines.lpn.network import LpnNetwork
from baselines.lpn.options import NetworkOptions
from baselines.options import at_least, options_from_dict, require
from baselines.weights_file import check_enough, fill_network, holds_network, read_network, write_network
from relocbench.errors import ConfigError, MethodError

_KIND = "lpn"
_MOST_SIDE = 4096
"""pixels; such networks are trained at 256 to 512"""


@dataclass(frozen=True)
class About:
    """What a weights file says besides the network's options."""

    configuration: str
    """the system's name (``configurations``)"""
    size: int
    """pixels; side of the images in training and evaluation"""
    backbone_start: str
    """where the backbone's initial weights came from, in words"""
    views: tuple[str, ...]
    """views that it was trained on"""
    rerank_top: int = 0
    """number of candidates of each ranking that are re-ranked by aligned parts"""
    card: Mapping[str, str] = field(default_factory=dict)
    """data, seed, steps, scores, versions"""

    def __post_init__(self) -> None:
        require(self, "size", lambda size: 1 <= size <= _MOST_SIDE, f"1 to {_MOST_SIDE} pixels")
        at_least(self, 0, "rerank_top")


def save_weights(path: Path, network: LpnNetwork, about: About) -> None:
    """Write weights, options and description; with the classifiers, so that a training can start from the network."""
    metadata = {**asdict(about), "views": list(about.views), "card": dict(about.card)}
    whole = {"classes": network.classes, "network": asdict(network.options), **metadata}
    write_network(path, _KIND, network, whole)


def are_weights(path: Path) -> bool:
    """Whether a file was written by :func:`save_weights`."""
    return holds_network(path, _KIND)


def load_weights(path: Path) -> tuple[LpnNetwork, About]:
    """The network of a weights file, on the CPU and in evaluation mode, and what the file says of it.

    Raises:
        MethodError: the file is missing, damaged, of another kind, or does not fit the network that it describes.
    """
    stated, tensors = read_network(path, _KIND)
    try:
        options = options_from_dict(NetworkOptions, stated.pop("network"))
        classes = stated.pop("classes")
        if type(classes) is not int or classes < 1:
            raise ConfigError("its number of classes is not a positive whole number")
        about = options_from_dict(About, stated)
    except (ConfigError, KeyError, ValueError, TypeError) as bad:
        reason = " ".join(str(bad).split())[:200]
        raise MethodError(f"its description of the network is not understood ({reason})", path) from bad
    check_enough(tensors, options.least_parameters + options.parts * options.width * classes, path)
    network = LpnNetwork(classes, options)
    fill_network(network, tensors, path)
    return network.eval(), about
