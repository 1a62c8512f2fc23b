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

_BLOCK = 64
"""queries in a block: 64 x 100 x 4 x 512 float32 are 52 MB"""


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


@torch.no_grad()
def rerank(queries: Tensor, gallery: Tensor, ranking: Tensor, top: int = 100) -> Tensor:
    """Sort the first ``top`` entries of each ranking by the aligned distance; the others keep their places.

    Args:
        queries: (Q, P, D) parts.
        gallery: (G, P, D) parts.
        ranking: (Q, R) int64, rows of the gallery, best first.
        top: number of entries; 0 changes nothing.

    Returns:
        The new ranking (Q, R) int64; entries of equal distance keep their order.

    Raises:
        ValueError: the shapes disagree, or ``top`` is negative.
    """
    if queries.ndim != 3 or gallery.ndim != 3 or queries.shape[1:] != gallery.shape[1:]:
        raise ValueError(f"parts of queries are {tuple(queries.shape)}, of the gallery {tuple(gallery.shape)}")
    if ranking.ndim != 2 or len(ranking) != len(queries) or top < 0:
        raise ValueError(f"a ranking {tuple(ranking.shape)} of {len(queries)} queries, its first {top} sorted anew")
    out = ranking.clone()
    for start in range(0, len(queries), _BLOCK):
        block = slice(start, start + _BLOCK)
        first = ranking[block, :top]
        distances = aligned_distance(queries[block, None], gallery[first])
        out[block, :top] = first.gather(1, distances.argsort(dim=1, stable=True))
    return out
