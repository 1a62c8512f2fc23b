"""Negatives: wrong pixels of the query for the contrastive loss.

At first random negatives teach most. Once their features are all far away, hard negatives do: pixels whose features are
nearest to the point's although they are elsewhere. Both keep some pixels' distance from the true pixel, since its
neighbours are nearly right.
"""

from __future__ import annotations

import torch
from torch import Tensor

_TRIES = 8


def random_negatives(
    size: tuple[int, int], u_true: Tensor, away: float, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw one pixel for each point, uniformly over the map outside a disc around the true pixel.

    Args:
        size: (H, W) of the map.
        u_true: (..., N, 2) pixels of the map.
        away: pixels; radius of the disc.
        generator: on the CPU, so that the draws do not depend on the device.

    Returns:
        Pixels (..., N, 2) between the first and the last pixel centre, and (..., N) bool: false where all eight draws
        fell into the disc.
    """
    drawn = _uniform((*u_true.shape[:-1], _TRIES), size, generator).to(u_true)
    outside = _far(drawn, u_true[..., None, :], away)
    first = outside.int().argmax(-1)[..., None, None].expand(*u_true.shape[:-1], 1, 2)
    return drawn.gather(-2, first)[..., 0, :], outside.any(-1)


@torch.no_grad()
def hard_negatives(
    features_query: Tensor, f_ref: Tensor, u_true: Tensor, away: float, candidates: int, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """For each point, of pixels drawn from its image, the one with the nearest feature at least ``away`` from it.

    Args:
        features_query: (D, H, W) or (B, D, H, W).
        f_ref: (N, D) or (B, N, D) features of the points.
        u_true: (N, 2) or (B, N, 2) their true pixels in the query's map.
        away: pixels of the map.
        candidates: number of whole pixels drawn in each image; all points of an image share them.
        generator: on the CPU.

    Returns:
        Pixels (..., N, 2), and (..., N) bool: false where all candidates were too close; without derivatives.
    """
    height, width = features_query.shape[-2:]
    batch = u_true.shape[:-2]
    index = torch.randint(height * width, (*batch, candidates), generator=generator).to(u_true.device)
    table = features_query.flatten(-2)
    chosen = table.gather(-1, index[..., None, :].expand(*batch, table.shape[-2], candidates))
    distances = torch.cdist(f_ref.float(), chosen.movedim(-2, -1).float())  # (..., N, candidates)
    places = torch.stack([index % width, index // width], dim=-1).to(u_true)
    outside = _far(places[..., None, :, :], u_true[..., None, :], away)
    nearest = distances.masked_fill(~outside, torch.inf).argmin(-1)
    return places.gather(-2, nearest[..., None].expand(*nearest.shape, 2)), outside.any(-1)


def _uniform(shape: tuple[int, ...], size: tuple[int, int], generator: torch.Generator) -> Tensor:
    height, width = size
    return torch.rand((*shape, 2), generator=generator) * torch.tensor([width - 1.0, height - 1.0])


def _far(u: Tensor, u_true: Tensor, away: float) -> Tensor:
    # A sum over an axis of two takes four times as long.
    du, dv = u[..., 0] - u_true[..., 0], u[..., 1] - u_true[..., 1]
    return du * du + dv * dv > away * away
