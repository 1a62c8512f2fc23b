"""DWDR: a channel of one view's features shall correlate with the same channel of the other view, and no other.

Wang et al., "Learning Cross-view Geo-localization Embeddings via Dynamic Weighted Decorrelation Regularization", TGRS
2024, after Barlow Twins (Zbontar et al., ICML 2021). For B pairs of images of the same places, with features a and b
(B, C) of which each channel is standardised over the batch:

    c_ij = mean over the batch of a_i b_j
    E = scale (sum_i ((1 - c_ii) / 2)^e1 (1 - c_ii)^2 + lambda sum_i sum_j!=i |c_ij|^e2 c_ij^2)

The dynamic weights (1 - c_ii) / 2 and |c_ij| emphasise channels that are still wrong; gradients flow through them.
e1 = e2 = 0 is Barlow Twins. Formula and constants are those of the authors' published code (its University-1652 run for
LPN): scale 1/32, lambda 0.0013, e1 = e2 = 1, and a total of 0.9 times the instance loss plus 0.1 times E. There the
features are the maximum over the last map instead of its mean, standardised by a batch normalisation without weights.
Half of the pairs of a batch are drawn by their satellite image, the other half by their drone image ("symmetric
sampling").
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from baselines.options import Options, above_0, at_least, share_below_1


@dataclass(frozen=True)
class DecorrelationOptions(Options):
    """Weight and constants of the loss."""

    weight: float = 0.0
    """share of the total, of which the instance loss has the rest; 0 disables the loss, the authors use 0.1"""
    off_weight: float = 0.0013
    """lambda, the weight of the off-diagonal terms"""
    scale: float = 1.0 / 32.0
    on_power: float = 1.0
    """e1"""
    off_power: float = 1.0
    """e2"""

    def __post_init__(self) -> None:
        share_below_1(self, "weight")
        at_least(self, 0, "off_weight on_power off_power")
        above_0(self, "scale")


def correlations(a: Tensor, b: Tensor) -> Tensor:
    """The correlations c (C, C) of features (B, C), of which each row shows the same place in both.

    Raises:
        ValueError: the shapes differ, or there is only one pair.
    """
    if a.shape != b.shape or a.ndim != 2 or len(a) < 2:
        raise ValueError(f"features are {tuple(a.shape)} and {tuple(b.shape)}, expected (B, C) twice, B at least 2")
    one, other = (functional.batch_norm(x, None, None, training=True) for x in (a, b))
    return one.T @ other / len(a)


def decorrelation_loss(a: Tensor, b: Tensor, options: DecorrelationOptions) -> Tensor:
    """The loss E of features (B, C), without ``options.weight``."""
    c = correlations(a, b)
    missing = (1.0 - c.diagonal()).clamp(min=0)
    on = (missing ** (2.0 + options.on_power)).sum() / 2.0**options.on_power
    outside = ~torch.eye(len(c), dtype=torch.bool, device=c.device)
    off = (c[outside].abs() ** (2.0 + options.off_power)).sum()
    out: Tensor = options.scale * (on + options.off_weight * off)
    return out
