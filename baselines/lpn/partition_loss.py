"""A loss that asks the masks of a partition to differ.

The variance v of the masks (B, K, H, W), sum over K is 1 at each pixel, is taken in one of two ways. Which of them was
meant by "variance over the K masks" is not public; both are population variances, means over the rest:

    parts     at each pixel over the K masks: 0 where all are 1/K, largest where one is 1 and the others 0
    pixels    of each mask over the pixels: 0 where it is the same everywhere

    s = v, or with ``relative`` v / mean (over the same axis)      q = s / s_max, between 0 and 1

s_max = (K - 1) / K^2 for v and (K - 1) / K for v / mean, in both ways: one-hot masks reach it, by ``pixels`` only if
all K are equally large. By ``parts`` a single mask that takes all pixels is as good as any; by ``pixels`` it is worth
nothing. By ``parts`` the mean is 1 / K, and ``relative`` changes s by the constant factor K.

    original       log(1 + K / s)          the log's loss
    power          (1 - q)^n               a reconstruction
    exponential    exp(-q / tau)           a reconstruction

The original's derivative is -K / (s (s + K)): about -1 / s near s = 0. Masks start almost equal, and there their logits
z, for which s grows as z^2, feel a pull of 2 / |z| that grows without bound just where nothing is known yet and a pull
should vanish. It was replaced, with better results; the replacement's formula is not public. Power and exponential are
RECONSTRUCTIONS of ours from its description as a power or exponential of variance or variance / mean. Their derivative
with respect to s is bounded, so that the pull on equal masks vanishes with z.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError

_LEAST = 1e-12
"""added to s in the original, and to a mask's mean: exactly equal masks give a finite loss"""


@dataclass(frozen=True)
class PartitionLossOptions:
    """Which form of the loss, and how much of it.

    Raises:
        ConfigError: a value that makes no sense.
    """

    weight: float = 0.0
    """against the cross-entropy of one part and view; 0 leaves the loss out"""
    form: Literal["original", "power", "exponential"] = "original"
    over: Literal["parts", "pixels"] = "parts"
    """what the variance is taken over"""
    relative: bool = False
    """variance / mean instead of variance"""
    power: float = 2.0
    """n of ``power``; above 1 the pull also vanishes where masks are one-hot"""
    tau: float = 0.25
    """of ``exponential``"""

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        if self.form not in ("original", "power", "exponential"):
            raise ConfigError(f"form of the partition loss is '{self.form}', expected original, power or exponential")
        if self.over not in ("parts", "pixels"):
            raise ConfigError(f"the partition loss's variance is over '{self.over}', expected parts or pixels")
        if self.weight < 0 or self.power < 1 or self.tau <= 0:
            raise ConfigError("the partition loss needs weight >= 0, power >= 1 and tau > 0")


def spread(masks: Tensor, over: Literal["parts", "pixels"], relative: bool) -> Tensor:
    """s: (B,) of masks (B, K, H, W).

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
    """s_max of ``masks`` = K masks."""
    return (masks - 1) / masks if relative else (masks - 1) / masks**2


def partition_loss(masks: Tensor, options: PartitionLossOptions) -> Tensor:
    """Mean over the images, without ``options.weight``.

    Args:
        masks: (B, K, H, W), sum over K is 1 at each pixel.
        options: see there.
    """
    k = masks.shape[1]
    s = spread(masks, options.over, options.relative)
    if options.form == "original":
        return torch.log1p(k / (s + _LEAST)).mean()
    q = s / largest_spread(k, options.relative)
    if options.form == "power":
        return ((1.0 - q).clamp(min=0) ** options.power).mean()
    return torch.exp(-q / options.tau).mean()
