"""Backbone weights from a user's file, and between those that a training started from and those it ended with."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from baselines.efficientnet_lite import IMAGENET_WEIGHTS, are_published, from_published, published_file
from baselines.lpn.backbone import Backbone
from baselines.lpn.network import LpnNetwork
from baselines.lpn.weights import About, are_weights, load_weights
from baselines.published_weights import check_floats, read_weights
from relocbench.errors import MethodError

_CLASSIFIER = ("fc.weight", "fc.bias")


def load_backbone(path: Path, backbone: Backbone) -> None:
    """Replace the backbone's weights with those of a file, except its classifier.

    Args:
        path: a state dict of torchvision's ResNet of the same depth, or of the package that holds EfficientNet-Lite0,
            as ``.safetensors`` or written by ``torch.save``, or the weights of another LPN training, of which the
            backbone for drone and satellite is taken. Only tensors are read; pickled code is refused.
        backbone: changed in place, unless the file is refused.

    Raises:
        MethodError: the file is missing, damaged, of another kind, or of another network.
    """
    tensors = _read(path)
    if are_published(tensors):
        tensors = {f"encoder.{name}": tensor for name, tensor in from_published(tensors).items()}
    expected = backbone.state_dict()
    found = {name: tensor for name, tensor in tensors.items() if name not in _CLASSIFIER}
    check_floats(expected, found, path, "the weights of this backbone")
    backbone.load_state_dict({name: found.get(name, tensor).to(tensor.dtype) for name, tensor in expected.items()})


def _read(path: Path) -> Mapping[str, Tensor]:
    if are_weights(path):
        return load_weights(path)[0].branch("satellite").backbone.state_dict()
    return read_weights(path)


@torch.no_grad()
def move_towards_imagenet(network: LpnNetwork, about: About, trained_share: float, path: Path) -> None:
    """Move each backbone to w = (1 - a) w_ImageNet + a w_trained, with its running means and variances.

    A network that was fine-tuned on one kind of images gains there and loses elsewhere. On the straight way between the
    two sets of weights there are networks that keep most of both (Wortsman et al., "Robust fine-tuning of zero-shot
    models", CVPR 2022: WiSE-FT).

    Args:
        network: of the file ``path``, which says ``about`` of it; changed in place.
        trained_share: a, in [0, 1]; 1 changes nothing.

    Raises:
        MethodError: the training did not start from EfficientNet-Lite0's ImageNet weights, or the package that holds
            them is not installed (the extra ``pretrained``).
    """
    if trained_share == 1:
        return
    if about.backbone_start != IMAGENET_WEIGHTS:
        raise MethodError(
            f"trained_share={trained_share:g} needs a training that started from ImageNet's weights of "
            "EfficientNet-Lite0 (--backbone-weights imagenet); the backbone of this one started from "
            f"{about.backbone_start}",
            path,
        )
    for _, branch in network.named_branches():
        trained = branch.backbone
        start = copy.deepcopy(trained)
        load_backbone(published_file(), start)
        states = start.state_dict(), trained.state_dict()
        trained.load_state_dict(
            {
                name: torch.lerp(states[0][name], value, trained_share) if value.is_floating_point() else value
                for name, value in states[1].items()
            }
        )
