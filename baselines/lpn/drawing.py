"""First weights of convolutions and their normalisations, from a generator of one's own."""

from __future__ import annotations

from typing import Literal, cast

import torch
from torch import nn
from torch.nn.utils import skip_init


def convolution(inside: int, outside: int, size: int, *, groups: int = 1, bias: bool = True) -> nn.Conv2d:
    """A centred convolution whose weights are still to be drawn: no number is taken from torch's global generator."""
    kwargs = {"padding": size // 2, "groups": groups, "bias": bias}
    return cast(nn.Conv2d, skip_init(nn.Conv2d, inside, outside, size, **kwargs))


def draw_weights(module: nn.Module, generator: torch.Generator, fan: Literal["fan_in", "fan_out"]) -> None:
    """He et al., 2015, for all convolutions in ``module``; normalisations start as the identity, biases at zero."""
    for each in module.modules():
        if isinstance(each, nn.Conv2d):
            nn.init.kaiming_normal_(each.weight, mode=fan, nonlinearity="relu", generator=generator)
            if each.bias is not None:
                nn.init.zeros_(each.bias)
        elif isinstance(each, nn.BatchNorm2d):
            each.reset_parameters()
