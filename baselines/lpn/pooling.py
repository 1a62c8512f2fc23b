"""Features of parts: weighted means of a feature map, with one mask for each part."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor

PartMean = Literal["all", "mask"]
"""the divisor of a masked sum: the number of ``all`` pixels of the map, or the sum of the ``mask``"""


class Parts(NamedTuple):
    """The parts of a feature map."""

    features: Tensor
    """(B, P, C)"""
    masks: Tensor | None
    """(B, P, H, W) that sum to 1 over P; None if the partition does not depend on the image"""


def weighted_sums(x: Tensor, weights: Tensor) -> Tensor:
    """The sums (B, P, C) of weights_p(u) X(u) over the pixels u.

    Args:
        x: (B, C, H, W).
        weights: (P, H, W), or (B, P, H, W) if they depend on the image.
    """
    return torch.matmul(weights.flatten(-2), x.flatten(-2).transpose(-2, -1))


def masked_means(x: Tensor, masks: Tensor, mean: PartMean) -> Tensor:
    """The means (B, P, C): sum_u M_p(u) X(u), divided by the number of pixels or by sum_u M_p(u).

    Args:
        x: (B, C, H, W).
        masks: (B, P, H, W), not negative.
        mean: the divisor; an empty mask gives zeros in either case.
    """
    sums = weighted_sums(x, masks)
    if mean == "all":
        return sums / masks[0, 0].numel()
    return sums / masks.sum((-2, -1)).clamp(min=torch.finfo(masks.dtype).tiny)[..., None]
