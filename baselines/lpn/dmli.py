"""Matching of parts by dynamic programming (DMLI), for re-ranking.

AlignedReID (Zhang et al., 2017) and AlignedReID++ (Luo et al., Pattern Recognition 2019), for parts f_i and g_j:

    d_ij = tanh(||f_i - g_j|| / 2)      S_ij = d_ij + min(S_i-1,j, S_i,j-1)      distance = S_PP

S_PP is the cost of the cheapest way through the P x P grid from (1, 1) to (P, P) that steps right or down. All its
2 P - 1 cells are paid, those off the diagonal too: two equal images have distance 0 only if all their parts are equal.
Parts are compared as they are handed over; descriptors' parts have unit norm (``descriptor.parts_of``).
"""

from __future__ import annotations

import torch
from torch import Tensor

_BLOCK = 64
"""queries at a time: 64 x 100 x 4 x 512 float32 are 52 MB"""


def part_distances(f: Tensor, g: Tensor) -> Tensor:
    """d: (..., P, R) of parts f (..., P, D) and g (..., R, D); at equal parts 0, with zero derivative."""
    return torch.tanh(0.5 * torch.cdist(f, g, compute_mode="donot_use_mm_for_euclid_dist"))


def shortest_path(d: Tensor) -> Tensor:
    """(...): S at the last cell of d (..., P, R)."""
    reached = d[..., 0, :].cumsum(-1)
    for i in range(1, d.shape[-2]):
        row = [reached[..., 0] + d[..., i, 0]]
        for j in range(1, d.shape[-1]):
            row.append(torch.minimum(reached[..., j], row[-1]) + d[..., i, j])
        reached = torch.stack(row, dim=-1)
    return reached[..., -1]


def aligned_distance(f: Tensor, g: Tensor) -> Tensor:
    """(...) distance of images with parts f (..., P, D) and g (..., R, D)."""
    return shortest_path(part_distances(f, g))


@torch.no_grad()
def rerank(queries: Tensor, gallery: Tensor, ranking: Tensor, top: int = 100) -> Tensor:
    """The first ``top`` of each ranking, sorted anew by the aligned distance; the rest stays where it is.

    Args:
        queries: (Q, P, D) parts.
        gallery: (G, P, D) parts.
        ranking: (Q, R) int64, rows of the gallery, best first.
        top: how many are looked at; 0 changes nothing.

    Returns:
        (Q, R) int64. Equal distances keep their former order.

    Raises:
        ValueError: shapes that do not fit, or a negative ``top``.
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
