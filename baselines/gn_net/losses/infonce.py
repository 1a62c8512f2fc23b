"""InfoNCE loss: among the other points of the query, a feature is to find its own.

van den Oord et al., Representation Learning with Contrastive Predictive Coding, 2018, with squared distances of
features as GN-Net's contrastive loss and its aligner measure them: with d_ij = ||F_a(u_a,i) - F_b(u_b,j)||_2 and all
correspondences j of the pair but those that lie within some pixels of point i,

    E_i = -log( exp(-d_ii^2 / tau) / sum_j exp(-d_ij^2 / tau) )

and the same with the images' roles exchanged. A margin loss asks of each wrong pixel alone whether it is far enough;
this one asks whether the right one is nearer than all of them, and spends its force on those that are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from baselines.options import NO_OTHER_KEYS
from relocbench.errors import ConfigError


@dataclass(frozen=True)
class InfoNceOptions:
    """How sharply, and among how many.

    Raises:
        ConfigError: a value that makes no sense.
    """

    weight: float = 0.0
    """against the contrastive loss; 0 leaves the loss out (GN-Net)"""
    temperature: float = 0.1
    """tau, squared features"""
    away: float = 2.0
    """pixels of the level; no other point so near counts as wrong"""
    points: int = 512
    """at most so many of a pair's points take part, the first ones"""

    __pydantic_config__ = NO_OTHER_KEYS

    def __post_init__(self) -> None:
        if min(self.weight, self.away) < 0 or self.temperature <= 0 or self.points < 2:
            raise ConfigError(
                "InfoNCE needs weight and away of 0 or more, a positive temperature and two points or more"
            )


def infonce_terms(
    f_ref: Tensor, f_query: Tensor, u_ref: Tensor, u_query: Tensor, mask: Tensor, temperature: float, away: float
) -> tuple[Tensor, Tensor]:
    """The loss of each point, both ways, and which points are found: nearest to their own among all, both ways.

    Args:
        f_ref, f_query: (..., N, D) features of the same points in both images.
        u_ref, u_query: (..., N, 2) their pixels.
        mask: (..., N) bool: points that take part.

    Returns:
        (..., N) cost, finite everywhere, and (..., N) bool without derivative.
    """
    logits = -_squared_distances(f_ref, f_query) / temperature
    own = torch.eye(mask.shape[-1], dtype=torch.bool, device=mask.device)
    cost, found = torch.zeros_like(logits[..., 0]), torch.ones_like(mask)
    for table, u in ((logits, u_query), (logits.transpose(-1, -2), u_ref)):
        # Rows ask, columns are asked about: a wrong column counts if its point does and lies away from the row's.
        apart = _squared_distances(u, u) > away * away
        asked = torch.where(own | (apart & mask[..., None, :]), table, -torch.inf)
        cost = cost + torch.logsumexp(asked, dim=-1) - table.diagonal(dim1=-2, dim2=-1)
        found = found & (asked.argmax(-1) == torch.arange(mask.shape[-1], device=mask.device))
    return 0.5 * cost, found


def _squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(..., N, M) of (..., N, D) and (..., M, D); by the binomial, for its derivative has no root at zero."""
    squares = (a**2).sum(-1)[..., :, None] + (b**2).sum(-1)[..., None, :]
    return (squares - 2 * a @ b.transpose(-1, -2)).clamp(min=0)
