"""Backbones between the weights that a training started from and those that it ended with.

A network that was fine-tuned on one kind of images gains there and loses elsewhere. On the straight way between the two
sets of weights there are networks that keep most of both (Wortsman et al., "Robust fine-tuning of zero-shot models",
CVPR 2022: WiSE-FT).
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import cast

import torch

from baselines.efficientnet_lite import IMAGENET_WEIGHTS, published_file
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.network import Branch, LpnNetwork
from baselines.lpn.weights import About
from relocbench.errors import MethodError


@torch.no_grad()
def move_towards_imagenet(network: LpnNetwork, about: About, trained_share: float, path: Path) -> None:
    """Move each backbone to w = (1 - a) w_ImageNet + a w_trained, with its running means and variances.

    Args:
        network: changed in place.
        about: what its file says.
        trained_share: a, in [0, 1]; 1 changes nothing.
        path: the file, for messages.

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
    for branch in network.branches.values():
        trained = cast(Branch, branch).backbone
        start = copy.deepcopy(trained)
        load_backbone(published_file(), start)
        states = start.state_dict(), trained.state_dict()
        trained.load_state_dict(
            {
                name: torch.lerp(states[0][name], value, trained_share) if value.is_floating_point() else value
                for name, value in states[1].items()
            }
        )
