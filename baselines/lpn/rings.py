"""LPN's square rings: nested squares about the middle of a feature map, each without the one inside it.

Wang et al., "Each Part Matters", TCSVT 2021. For a map of H x W and P parts let s = floor(H / 2P), c = floor(H / 2) and
likewise across. Square i of 1 .. P-1 holds the rows c - i s .. c + i s - 1; square P is the whole map; ring i is square
i without square i - 1. The first ring is the middle one.

Sizes that 2P does not divide (as the authors' code has it):
    what is left over belongs to the outermost ring, which is then wider than the others;
    on an odd side the squares lie half a pixel nearer to the first row or column than the middle of the map, and the
    mirror image is cut elsewhere;
    a side below 2P is first stretched, bilinearly and corners on corners, to 2P (even side) or 2P + 1 (odd side).

The mean over a ring exists twice. ``square``: the sum over the ring divided by the area of its whole square, zeros
inside included, as in the authors' LPN code; for P = 4 on 16 x 16 that is 1, 0.75, 0.5556 and 0.4375 times the mean.
``ring``: the mean, as in their later DWDR code. A part head (linear layer, then batch normalisation) takes a constant
factor out again but for the normalisation's epsilon, so that one table may hold both.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.lpn.pooling import Parts, weighted_sums

RingMean = Literal["square", "ring"]


class Rings(nn.Module):
    """The partition of LPN; one part is the plain mean over the map.

    Args:
        parts: P.
        mean: ``square`` or ``ring``.
    """

    def __init__(self, parts: int, mean: RingMean) -> None:
        super().__init__()
        self.parts = parts
        self.mean: RingMean = mean

    def forward(self, x: Tensor) -> Parts:
        """(B, P, C) of (B, C, H, W); no masks, since they are the same for all images."""
        x = stretched(x, self.parts)
        height, width = x.shape[-2:]
        return Parts(weighted_sums(x, ring_weights(height, width, self.parts, self.mean).to(x)), None)


def ring_index(height: int, width: int, parts: int) -> Tensor:
    """(H, W) int64: the ring of each pixel, 0 in the middle, ``parts`` - 1 outside.

    Raises:
        ValueError: no parts, or a side below 2 ``parts``.
    """
    if parts < 1 or min(height, width) < 2 * parts:
        raise ValueError(f"a map of {height}x{width} has no {parts} rings, each side needs {2 * max(parts, 1)}")
    across = torch.maximum(_square_of(height, parts)[:, None], _square_of(width, parts)[None, :])
    return across.clamp(max=parts - 1)


def ring_weights(height: int, width: int, parts: int, mean: RingMean) -> Tensor:
    """(P, H, W) float64: 0 outside the ring, inside 1 / (pixels of its square) or 1 / (pixels of the ring).

    Raises:
        ValueError: see ``ring_index``.
    """
    index = ring_index(height, width, parts)
    rings = functional.one_hot(index, parts).movedim(-1, 0).double()
    pixels = rings.sum((-2, -1))
    area = pixels.cumsum(0) if mean == "square" else pixels
    return rings / area[:, None, None]


def stretched(x: Tensor, parts: int) -> Tensor:
    """(B, C, H', W'): the map itself, or where a side is below 2 ``parts`` stretched as the module says."""
    height, width = x.shape[-2:]
    size = tuple(2 * parts + side % 2 if side < 2 * parts else side for side in (height, width))
    if size == (height, width):
        return x
    return functional.interpolate(x, size=size, mode="bilinear", align_corners=True)


def _square_of(side: int, parts: int) -> Tensor:
    """(side,) int64: the smallest square, from 0, that reaches each row; P or more where rows are left over."""
    step, middle = side // (2 * parts), side // 2
    offset = torch.arange(side) - middle
    return torch.where(offset >= 0, offset, -offset - 1) // step
