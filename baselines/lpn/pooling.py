"""Features of parts: columns of a feature map, averaged by one mask a part."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

PartMean = Literal["all", "mask"]
"""by what a masked sum is divided: ``all`` pixels of the map, or the sum of the ``mask``"""


class Parts(NamedTuple):
    """What a partition makes of a feature map."""

    features: Tensor
    """(B, P, C)"""
    masks: Tensor | None
    """(B, P, H, W), sum over P is 1 at each pixel; None where the partition does not depend on the image"""


def weighted_sums(x: Tensor, weights: Tensor) -> Tensor:
    """(B, P, C) sums over the pixels u of weights_p(u) X(u).

    Args:
        x: (B, C, H, W).
        weights: (P, H, W), or (B, P, H, W) where they depend on the image.
    """
    return torch.matmul(weights.flatten(-2), x.flatten(-2).transpose(-2, -1))


def masked_means(x: Tensor, masks: Tensor, mean: PartMean) -> Tensor:
    """(B, P, C): sum_u M_p(u) X(u), divided by the number of pixels or by sum_u M_p(u).

    Args:
        x: (B, C, H, W).
        masks: (B, P, H, W), 0 or more.
        mean: what to divide by; an empty mask gives zeros either way.
    """
    sums = weighted_sums(x, masks)
    if mean == "all":
        return sums / masks[0, 0].numel()
    return sums / masks.sum((-2, -1)).clamp(min=torch.finfo(masks.dtype).tiny)[..., None]
