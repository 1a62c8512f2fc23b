"""Convolutions and batch normalisations: initial weights from a given generator, and folding for inference."""

from __future__ import annotations

from typing import Literal, Protocol, runtime_checkable

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval


class UndrawnLinear(nn.Linear):
    """A linear map with uninitialised weights, so that torch's global generator is not used.

    ``torch.nn.utils.skip_init`` makes one as well, after half a second of imports.
    """

    def reset_parameters(self) -> None:
        """Leave the weights to whoever draws or loads them."""


class _UndrawnConvolution(nn.Conv2d):
    """The same of a convolution."""

    def reset_parameters(self) -> None:
        """Leave the weights to whoever draws or loads them."""


def convolution(inside: int, outside: int, size: int, *, groups: int = 1, bias: bool = True) -> nn.Conv2d:
    """A centred convolution with uninitialised weights, so that torch's global generator is not used."""
    return _UndrawnConvolution(inside, outside, size, padding=size // 2, groups=groups, bias=bias)


def leave_undrawn(module: nn.Module) -> None:
    """Give a module that was made below ``torch.device("meta")`` memory on the CPU, with uninitialised numbers.

    ``to_empty`` does so as well, after a second of imports.
    """
    for each in module.modules():
        for name, weight in list(each.named_parameters(recurse=False)):
            setattr(each, name, nn.Parameter(torch.empty(weight.shape, dtype=weight.dtype)))
        for name, buffer in list(each.named_buffers(recurse=False)):
            setattr(each, name, torch.empty(buffer.shape, dtype=buffer.dtype))


def draw_weights(module: nn.Module, generator: torch.Generator, fan: Literal["fan_in", "fan_out"]) -> None:
    """Initialise all convolutions as He et al., 2015, batch normalisations as the identity, and biases as zero."""
    for each in module.modules():
        if isinstance(each, nn.Conv2d):
            nn.init.kaiming_normal_(each.weight, mode=fan, nonlinearity="relu", generator=generator)
            if each.bias is not None:
                nn.init.zeros_(each.bias)
        elif isinstance(each, nn.BatchNorm2d):
            each.reset_parameters()


@runtime_checkable
class Foldable(Protocol):
    """A module whose batch normalisation can be folded into its convolution."""

    def fold(self) -> None:
        """Fold it, in evaluation mode."""


def folded(conv: nn.Conv2d, norm: nn.Module) -> tuple[nn.Conv2d, nn.Module]:
    """A convolution that contains its batch normalisation, and the identity; without one, both as they are."""
    if isinstance(norm, nn.BatchNorm2d):
        return fuse_conv_bn_eval(conv, norm), nn.Identity()
    return conv, norm
