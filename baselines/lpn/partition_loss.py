"""A loss that makes the masks of a partition differ.

The masks (B, K, H, W) sum to 1 over K at each pixel. Their variance v is computed in one of two ways; which of them the
"variance over the K masks" of the log means is not public. Both are population variances, averaged over the other axes:

    parts     over the K masks at each pixel: 0 if all are 1/K, largest if one is 1 and the others 0
    pixels    over the pixels of each mask: 0 if it is constant

    s = v, or with ``relative`` v / mean (over the same axis)      q = s / s_max, between 0 and 1

In both cases s_max is (K - 1) / K^2 for v and (K - 1) / K for v / mean. One-hot masks reach it, with ``pixels`` only if
all K are equally large. With ``parts``, a single mask that covers all pixels is as good as any; with ``pixels`` it has
s = 0. With ``parts``, the mean is 1 / K and ``relative`` only multiplies s by K.

    original       log(1 + K / s)          the log's loss
    power          (1 - q)^n               a reconstruction
    exponential    exp(-q / tau)           a reconstruction

The derivative of the original is -K / (s (s + K)), about -1 / s near s = 0. Masks start almost equal, where s grows as
z^2 with their logits z, so that the gradient is about 2 / |z|: it is unbounded exactly where the masks know nothing yet
and it should vanish. The log replaced this loss, with better results, by one whose formula is not public. Power and
exponential are RECONSTRUCTIONS of ours from its description as a power or exponential of variance or variance / mean.
Their derivatives with respect to s are bounded, so that the gradient at equal masks vanishes with z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from baselines.options import Options, above_0, at_least

_LEAST = 1e-12
"""added to s in the original and to the mean of a mask, so that the loss of equal masks is finite"""


@dataclass(frozen=True)
class PartitionLossOptions(Options):
    """Weight and form of the loss."""

    weight: float = 0.0
    """weight relative to the cross-entropy of one part and view; 0 disables the loss"""
    form: Literal["original", "power", "exponential"] = "original"
    over: Literal["parts", "pixels"] = "parts"
    """the axis of the variance"""
    relative: bool = False
    """variance / mean instead of variance"""
    power: float = 2.0
    """n of ``power``; above 1 the gradient also vanishes at one-hot masks"""
    tau: float = 0.25
    """of ``exponential``"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight")
        at_least(self, 1, "power")
        above_0(self, "tau")


def spread(masks: Tensor, over: Literal["parts", "pixels"], relative: bool) -> Tensor:
    """s (B,) of masks (B, K, H, W).

    Raises:
        ValueError: fewer than two masks.
    """
    if masks.ndim != 4 or masks.shape[1] < 2:
        raise ValueError(f"masks are {tuple(masks.shape)}, expected (B, K, H, W) with at least two of K")
    axes = (1,) if over == "parts" else (2, 3)
    variance = masks.var(axes, correction=0)
    if relative:
        variance = variance / (masks.mean(axes) + _LEAST)
    return variance.flatten(1).mean(1)


def largest_spread(masks: int, relative: bool) -> float:
    """s_max of K = ``masks`` masks."""
    return (masks - 1) / masks if relative else (masks - 1) / masks**2


def partition_loss(masks: Tensor, options: PartitionLossOptions) -> Tensor:
    """The mean loss over the images, without ``options.weight``.

    Args:
        masks: (B, K, H, W) that sum to 1 over K.
    """
    k = masks.shape[1]
    s = spread(masks, options.over, options.relative)
    if options.form == "original":
        return torch.log1p(k / (s + _LEAST)).mean()
    q = s / largest_spread(k, options.relative)
    if options.form == "power":
        return ((1.0 - q).clamp(min=0) ** options.power).mean()
    return torch.exp(-q / options.tau).mean()
