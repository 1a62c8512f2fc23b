"""Re-ranking by aligned parts: dynamically matching local information (DMLI).

AlignedReID (Zhang et al., 2017) and AlignedReID++ (Luo et al., Pattern Recognition 2019), for parts f_i and g_j:

    d_ij = tanh(||f_i - g_j|| / 2)      S_ij = d_ij + min(S_i-1,j, S_i,j-1)      distance = S_PP

S_PP is the cost of the shortest path through the P x P grid from (1, 1) to (P, P) that steps right or down. It adds up
all 2 P - 1 cells of the path, also those off the diagonal, so that two equal images have distance 0 only if all their
parts are equal. Parts are not normalised here; those of descriptors have unit norm (``descriptor.parts_of``).
"""

from __future__ import annotations

import torch
from torch import Tensor


def part_distances(f: Tensor, g: Tensor) -> Tensor:
    """The distances d (..., P, R) of parts f (..., P, D) and g (..., R, D); 0, with zero derivative, at equal parts."""
    return torch.tanh(0.5 * torch.cdist(f, g, compute_mode="donot_use_mm_for_euclid_dist"))


def shortest_path(d: Tensor) -> Tensor:
    """S (...) at the last cell of d (..., P, R)."""
    reached = d[..., 0, :].cumsum(-1)
    for i in range(1, d.shape[-2]):
        row = [reached[..., 0] + d[..., i, 0]]
        for j in range(1, d.shape[-1]):
            row.append(torch.minimum(reached[..., j], row[-1]) + d[..., i, j])
        reached = torch.stack(row, dim=-1)
    return reached[..., -1]


def aligned_distance(f: Tensor, g: Tensor) -> Tensor:
    """The distance (...) of images with parts f (..., P, D) and g (..., R, D)."""
    return shortest_path(part_distances(f, g))
