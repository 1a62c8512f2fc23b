"""LPN's square rings: nested squares around the middle of a feature map, each without the one inside it.

Wang et al., "Each Part Matters", TCSVT 2021. For a map of H x W and P parts let s = floor(H / 2P), c = floor(H / 2) and
likewise for columns. Square i of 1 .. P-1 holds the rows c - i s .. c + i s - 1; square P is the whole map; ring i is
square i without square i - 1. The first ring is the innermost.

Sides that are not a multiple of 2P are treated as in the authors' code:
    the remainder belongs to the outermost ring, which is then wider than the others;
    on an odd side the squares are half a pixel closer to the first row or column than to the last, so that the rings of
    a mirror image differ;
    a side below 2P is first stretched, bilinearly with aligned corners, to 2P (even side) or 2P + 1 (odd side).

There are two kinds of mean over a ring. ``square`` is the sum over the ring divided by the area of its whole square, as
in the authors' LPN code; for P = 4 on 16 x 16 this is 1, 0.75, 0.5556 and 0.4375 times the mean. ``ring`` is the mean
over the ring, as in their later DWDR code. The batch normalisation of a part head cancels constant factors, except for
its epsilon, so that results of both can be compared.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.lpn.pooling import Parts, weighted_sums

RingMean = Literal["square", "ring"]


class Rings(nn.Module):
    """The partition of LPN into P parts; with one part it is the mean over the map."""

    def __init__(self, parts: int, mean: RingMean) -> None:
        super().__init__()
        self.parts = parts
        self.mean: RingMean = mean

    def forward(self, x: Tensor) -> Parts:
        """The features (B, P, C) of the rings of a map (B, C, H, W), without masks."""
        x = stretched(x, self.parts)
        height, width = x.shape[-2:]
        return Parts(weighted_sums(x, ring_weights(height, width, self.parts, self.mean).to(x)), None)


def ring_index(height: int, width: int, parts: int) -> Tensor:
    """The ring (H, W) int64 of each pixel, from 0 in the middle to ``parts`` - 1 outside.

    Raises:
        ValueError: there are no parts, or a side is below 2 ``parts``.
    """
    if parts < 1 or min(height, width) < 2 * parts:
        raise ValueError(f"a map of {height}x{width} has no {parts} rings, each side needs {2 * max(parts, 1)}")
    across = torch.maximum(_square_of(height, parts)[:, None], _square_of(width, parts)[None, :])
    return across.clamp(max=parts - 1)


def ring_weights(height: int, width: int, parts: int, mean: RingMean) -> Tensor:
    """Weights (P, H, W) float64: 0 outside the ring, and inside 1 / (pixels of its square) or 1 / (pixels of the ring).

    Raises:
        ValueError: see ``ring_index``.
    """
    index = ring_index(height, width, parts)
    rings = functional.one_hot(index, parts).movedim(-1, 0).double()
    pixels = rings.sum((-2, -1))
    area = pixels.cumsum(0) if mean == "square" else pixels
    return rings / area[:, None, None]


def stretched(x: Tensor, parts: int) -> Tensor:
    """The map itself, or where a side is below 2 ``parts``, stretched as described in the module: (B, C, H', W')."""
    height, width = x.shape[-2:]
    size = tuple(2 * parts + side % 2 if side < 2 * parts else side for side in (height, width))
    if size == (height, width):
        return x
    return functional.interpolate(x, size=size, mode="bilinear", align_corners=True)


def _square_of(side: int, parts: int) -> Tensor:
    """The smallest square (side,) int64, counted from 0, that contains each row; P or more for the remainder."""
    step, middle = side // (2 * parts), side // 2
    offset = torch.arange(side) - middle
    return torch.where(offset >= 0, offset, -offset - 1) // step
