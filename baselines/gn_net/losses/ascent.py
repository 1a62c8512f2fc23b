"""Ascent loss: the residual must be smaller at the true pixel than on the way to where the point is without motion.

Alignment starts at a prior, most often at the keyframe's own pose, which places every point at its pixel of the
reference. Negatives that are drawn elsewhere never visit these pixels, so that the residual may have a minimum there:
features that tell the layout of a street (kerb, horizon, eaves) are the same at the same place of both images. With
u_b the true pixel and u_0 the pixel without motion, at

    u(t) = u_b + t (u_0 - u_b)     t uniform in [-1/2, 1]

    E = max(0, ||F_b(u_b) - f||^2 - ||F_b(u(t)) - f||^2 + m)

where u(t) is at least some pixels from u_b. It is the hinge of a triplet loss (Schroff et al., FaceNet, CVPR 2015)
whose negatives lie where alignment starts and passes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from baselines.gn_net.sampling import sample
from baselines.options import Options, above_0, at_least

_BEYOND = 0.5
"""how far beyond the true pixel positions are drawn, as a share of the way"""


@dataclass(frozen=True)
class AscentOptions(Options):
    """Weight, margin and positions."""

    weight: float = 0.0
    """weight relative to the contrastive loss; 0 disables the loss (GN-Net)"""
    margin: float = 0.5
    """m, squared features"""
    away: float = 1.0
    """pixels of the level; nearer positions do not count"""
    positions: int = 2
    """number of positions on the way of each point"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight")
        above_0(self, "margin away")
        at_least(self, 1, "positions")


class AscentTerms(NamedTuple):
    """The loss of each position."""

    cost: Tensor
    """(..., N, K), squared features"""
    valid: Tensor
    """(..., N, K) bool: true pixel and position are on the map, and far enough from one another"""
    higher: Tensor
    """(..., N, K) bool: the residual is larger than at the true pixel, by however little"""


def ascent_terms(
    features_query: Tensor,
    f_ref: Tensor,
    u_true: Tensor,
    u_still: Tensor,
    options: AscentOptions,
    generator: torch.Generator,
) -> AscentTerms:
    """The cost of K positions a point.

    Args:
        features_query: (..., D, H, W), the map F_b.
        f_ref: (..., N, D), F_a(u_a).
        u_true: (..., N, 2), u_b in pixels of the map.
        u_still: (..., N, 2), u_0: where the query would show the points if its camera had not moved.
        generator: on the CPU, so that the draws do not depend on the device.
    """
    count = options.positions
    t = (torch.rand((*u_true.shape[:-1], count), generator=generator) * (1 + _BEYOND) - _BEYOND).to(u_true)
    way = (u_still - u_true)[..., None, :]
    positions = u_true[..., None, :] + t[..., None] * way
    at_true, on_true = sample(features_query, u_true)
    sampled, on_map = sample(features_query, positions.flatten(-3, -2))
    sampled, on_map = sampled.unflatten(-2, (-1, count)), on_map.unflatten(-1, (-1, count))
    true_squared = ((at_true - f_ref) ** 2).sum(-1)[..., None]
    squared = ((sampled - f_ref[..., None, :]) ** 2).sum(-1)
    far = (t[..., None] * way).square().sum(-1) >= options.away**2
    cost = (true_squared - squared + options.margin).clamp(min=0)
    return AscentTerms(cost, far & on_map & on_true[..., None], squared > true_squared)
