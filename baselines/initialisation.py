"""Initial weights of convolutions and batch normalisations, from a given generator."""

from __future__ import annotations

from typing import Literal, cast

import torch
from torch import nn
from torch.nn.utils import skip_init


def convolution(inside: int, outside: int, size: int, *, groups: int = 1, bias: bool = True) -> nn.Conv2d:
    """A centred convolution with uninitialised weights, so that torch's global generator is not used."""
    kwargs = {"padding": size // 2, "groups": groups, "bias": bias}
    return cast(nn.Conv2d, skip_init(nn.Conv2d, inside, outside, size, **kwargs))


def draw_weights(module: nn.Module, generator: torch.Generator, fan: Literal["fan_in", "fan_out"]) -> None:
    """Initialise all convolutions as He et al., 2015, batch normalisations as the identity, and biases as zero."""
    for each in module.modules():
        if isinstance(each, nn.Conv2d):
            nn.init.kaiming_normal_(each.weight, mode=fan, nonlinearity="relu", generator=generator)
            if each.bias is not None:
                nn.init.zeros_(each.bias)
        elif isinstance(each, nn.BatchNorm2d):
            each.reset_parameters()
