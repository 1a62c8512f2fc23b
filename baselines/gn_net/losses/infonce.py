"""InfoNCE loss: a feature shall be closer to its own point than to all other points of the query.

van den Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, with squared feature distances,
as in GN-Net's contrastive loss and in alignment. With d_ij = ||F_a(u_a,i) - F_b(u_b,j)||_2, for all correspondences j
of the pair except other ones within some pixels of point i,

    E_i = -log( exp(-d_ii^2 / tau) / sum_j exp(-d_ij^2 / tau) )

and the same with the roles of the images exchanged. A margin loss compares each wrong pixel with a fixed distance; this
loss compares it with the right one, so that its gradient concentrates on wrong pixels that are too close.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.options import Options, above_0, at_least


@dataclass(frozen=True)
class InfoNceOptions(Options):
    """Weight, temperature and the points that take part."""

    weight: float = 0.0
    """weight relative to the contrastive loss; 0 disables the loss (GN-Net)"""
    temperature: float = 0.1
    """tau, squared features"""
    away: float = 2.0
    """pixels of the level; other points within this distance do not count as wrong"""
    points: int = 512
    """largest number of a pair's points that take part, in their order"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight away")
        above_0(self, "temperature")
        at_least(self, 2, "points")


def infonce_terms(
    f_ref: Tensor, f_query: Tensor, u_ref: Tensor, u_query: Tensor, mask: Tensor, temperature: float, away: float
) -> tuple[Tensor, Tensor]:
    """The loss of each point in both directions, and which points are mutual nearest neighbours of their own.

    Args:
        f_ref, f_query: (..., N, D) features of the same points in both images.
        u_ref, u_query: (..., N, 2) their pixels.
        mask: (..., N) bool: points that take part.
        temperature: tau, squared features.
        away: pixels; see ``InfoNceOptions``.

    Returns:
        The cost (..., N), finite everywhere, and which points are found (..., N) bool, without derivative.
    """
    logits = -_squared_distances(f_ref, f_query) / temperature
    own = torch.eye(mask.shape[-1], dtype=torch.bool, device=mask.device)
    cost, found = torch.zeros_like(logits[..., 0]), torch.ones_like(mask)
    for table, u in ((logits, u_query), (logits.transpose(-1, -2), u_ref)):
        # A column counts for a row if its point takes part and is far from the row's point, or is the same point.
        apart = _squared_distances(u, u) > away * away
        asked = torch.where(own | (apart & mask[..., None, :]), table, -torch.inf)
        cost = cost + torch.logsumexp(asked, dim=-1) - table.diagonal(dim1=-2, dim2=-1)
        found = found & (asked.argmax(-1) == torch.arange(mask.shape[-1], device=mask.device))
    return 0.5 * cost, found


def _squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(..., N, M) of (..., N, D) and (..., M, D); expanded, so that the derivative is finite at distance 0."""
    squares = (a**2).sum(-1)[..., :, None] + (b**2).sum(-1)[..., None, :]
    return (squares - 2 * a @ b.transpose(-1, -2)).clamp(min=0)
