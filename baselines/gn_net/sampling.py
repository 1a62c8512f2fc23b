"""Feature maps sampled between their pixels: bilinear values, and central differences of the same bilinear map.

(0, 0) is the centre of the first pixel. Maps are (..., D, H, W) and positions (..., N, 2) as (u, v), with the same
leading dimensions. Positions off the map are returned as not valid, with finite but meaningless values.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

_SMALLEST_MAP = 4
"""pixels; the side of a map that has room for a derivative's four samples"""


class Sampled(NamedTuple):
    """Values of a map at N positions."""

    values: Tensor
    """(..., N, D)"""
    valid: Tensor
    """(..., N) bool: the position is on the map"""


class SampledWithGradient(NamedTuple):
    """Values and derivatives of a map at N positions."""

    values: Tensor
    """(..., N, D)"""
    jacobian: Tensor
    """(..., N, D, 2): derivatives along u and v, per pixel of this map"""
    valid: Tensor
    """(..., N) bool: the position is at least one pixel inside the map"""


def level_coordinates(u: Tensor, level: int) -> Tensor:
    """Pixels of level 0 in the coordinates of ``level``: (u + 0.5) / 2^l - 0.5."""
    return (u + 0.5) / float(1 << level) - 0.5


def sample(features: Tensor, u: Tensor) -> Sampled:
    """Interpolate F(u) bilinearly.

    Args:
        features: (..., D, H, W); half precision becomes single precision after the look-up.
        u: (..., N, 2) pixels of this map; valid from the first pixel's centre to the last one's.
    """
    corner, fraction, valid = _locate(features, u, margin=0)
    taps = _gather(features, corner, size=2)
    a, b = fraction[..., 0, None, None], fraction[..., 1, None]
    rows = (1 - a) * taps[..., 0, :] + a * taps[..., 1, :]
    return Sampled((1 - b) * rows[..., 0, :] + b * rows[..., 1, :], valid)


def sample_with_gradient(features: Tensor, u: Tensor) -> SampledWithGradient:
    """Interpolate F(u) bilinearly, and dF/du = (F(u + 1) - F(u - 1)) / 2 of the same map along u and v.

    Args:
        features: (..., D, H, W), at least 4 x 4; half precision becomes single precision after the look-up.
        u: (..., N, 2) pixels of this map; valid one pixel or more from the border.

    Raises:
        ValueError: the map is smaller than 4 x 4.
    """
    if min(features.shape[-2:]) < _SMALLEST_MAP:
        raise ValueError(f"derivatives need maps of 4 x 4 pixels or more, got {tuple(features.shape[-2:])}")
    corner, fraction, valid = _locate(features, u, margin=1)
    taps = _gather(features, corner - 1, size=4)  # (..., N, 4 rows, 4 columns, D)
    a, b = fraction[..., 0, None, None], fraction[..., 1, None]
    rows = _between(taps, a)
    across = _difference(taps, a)
    values = _between(rows, b)
    jacobian = torch.stack([_between(across, b), _difference(rows, b)], dim=-1)
    return SampledWithGradient(values, jacobian, valid)


def _between(taps: Tensor, a: Tensor) -> Tensor:
    """Interpolate linearly between the middle two of four samples along the dimension before the last."""
    _, left, right, _ = taps.unbind(-2)
    return (1 - a) * left + a * right


def _difference(taps: Tensor, a: Tensor) -> Tensor:
    """The central difference over one pixel to either side of the piecewise linear map."""
    before, left, right, beyond = taps.unbind(-2)
    return 0.5 * ((1 - a) * (right - before) + a * (beyond - left))


def _locate(features: Tensor, u: Tensor, margin: int) -> tuple[Tensor, Tensor, Tensor]:
    """The upper left pixel (..., N, 2) int64, the offset of u from it (..., N, 2), and whether u is valid (..., N)."""
    height, width = features.shape[-2:]
    last = torch.tensor([width - 1 - margin, height - 1 - margin], dtype=u.dtype, device=u.device)
    valid = torch.all((u >= margin) & (u <= last), dim=-1)  # also false for NaN
    safe = torch.where(valid[..., None], u, torch.full_like(u, margin))
    # A position on the last pixel belongs to the cell before it.
    corner = torch.minimum(safe.detach().floor(), last - 1).clamp(min=0)
    return corner.long(), safe - corner, valid


def _gather(features: Tensor, corner: Tensor, size: int) -> Tensor:
    """Gather blocks of size x size pixels: (..., N, size, size, D).

    The derivative of an embedding is summed in a fixed order, also on a GPU.
    """
    *batch, channels, height, width = features.shape
    steps = torch.arange(size, device=corner.device)
    columns = (corner[..., 0, None] + steps).clamp(max=width - 1)
    rows = (corner[..., 1, None] + steps).clamp(max=height - 1)
    index = rows[..., :, None] * width + columns[..., None, :]
    image = torch.arange(math.prod(batch), device=corner.device).reshape(*batch, 1, 1, 1)
    index = index + image * (height * width)
    table = features.movedim(-3, -1).reshape(-1, channels)
    taps = functional.embedding(index, table)
    return taps.float() if taps.dtype in (torch.float16, torch.bfloat16) else taps
