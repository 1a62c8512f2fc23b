"""Feature maps between their pixels: bilinear values and central differences of the same bilinear map.

Pixel (0, 0) is the centre of the first pixel. Maps are (..., D, H, W) and places (..., N, 2) as (u, v), with the same
leading dimensions. Places off the map come back as not valid, with finite values that mean nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

_SMALLEST_MAP = 4
"""pixels a side that a derivative's four taps need"""


class Sampled(NamedTuple):
    """Values of a map at N places."""

    values: Tensor
    """(..., N, D)"""
    valid: Tensor
    """(..., N) bool: the place is on the map"""


class SampledWithGradient(NamedTuple):
    """Values and derivatives of a map at N places."""

    values: Tensor
    """(..., N, D)"""
    jacobian: Tensor
    """(..., N, D, 2): derivatives along u and v, 1 / pixel of this map"""
    valid: Tensor
    """(..., N) bool: the place is at least one pixel inside the map"""


def level_coordinates(u: Tensor, level: int) -> Tensor:
    """Pixels of level 0 as pixels of ``level``: (u + 0.5) / 2^l - 0.5."""
    return (u + 0.5) / float(1 << level) - 0.5


def sample(features: Tensor, u: Tensor) -> Sampled:
    """F(u), bilinear.

    Args:
        features: (..., D, H, W); half precision is raised to single after the look-up.
        u: (..., N, 2) pixels of this map; valid from the first pixel's centre to the last one's.
    """
    corner, fraction, valid = _locate(features, u, margin=0)
    taps = _gather(features, corner, size=2)
    a, b = fraction[..., 0, None, None], fraction[..., 1, None]
    rows = (1 - a) * taps[..., 0, :] + a * taps[..., 1, :]
    return Sampled((1 - b) * rows[..., 0, :] + b * rows[..., 1, :], valid)


def sample_with_gradient(features: Tensor, u: Tensor) -> SampledWithGradient:
    """F(u), bilinear, and dF/du = (F(u + 1) - F(u - 1)) / 2 of that same map, in each direction.

    Args:
        features: (..., D, H, W), at least 4 x 4; half precision is raised to single after the look-up.
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
    """Linear between the middle two of four taps along the dimension before the last."""
    return (1 - a) * taps[..., 1, :] + a * taps[..., 2, :]


def _difference(taps: Tensor, a: Tensor) -> Tensor:
    """Half of what the linear map differs by between one pixel on and one pixel back."""
    return 0.5 * ((1 - a) * (taps[..., 2, :] - taps[..., 0, :]) + a * (taps[..., 3, :] - taps[..., 1, :]))


def _locate(features: Tensor, u: Tensor, margin: int) -> tuple[Tensor, Tensor, Tensor]:
    """Upper left pixel (..., N, 2) int64, what u is beyond it (..., N, 2), and where u is valid (..., N)."""
    height, width = features.shape[-2:]
    last = torch.tensor([width - 1 - margin, height - 1 - margin], dtype=u.dtype, device=u.device)
    valid = torch.all((u >= margin) & (u <= last), dim=-1)  # false for NaN too
    safe = torch.where(valid[..., None], u, torch.full_like(u, margin))
    # The last pixel is the end of the cell before it.
    corner = torch.minimum(safe.detach().floor(), last - 1).clamp(min=0)
    return corner.long(), safe - corner, valid


def _gather(features: Tensor, corner: Tensor, size: int) -> Tensor:
    """Blocks of size x size pixels: (..., N, size, size, D).

    An embedding is a look-up of rows whose derivative is summed in a fixed order, on a GPU too.
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
