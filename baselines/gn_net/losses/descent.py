"""Descent loss: from a start some pixels off, one heavily damped step must come closer to the true pixel.

LM-Reloc (von Stumberg et al., 3DV 2020), with the symbols of ``gauss_newton`` and starts up to about 5 px off:

    x_after = x_s - (J^T J + lambda_f I)^-1 b
    E = max(0, ||x_after - u_b||^2 - ||x_s - u_b||^2 + margin)      lambda_f = 2, margin = 0.1

That far away the minimum of the linear system says little, but the direction of descent can be right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from baselines.gn_net.losses.symmetric import normal_equations
from baselines.gn_net.sampling import sample_with_gradient
from baselines.options import Options, above_0, at_least


@dataclass(frozen=True)
class DescentOptions(Options):
    """Weight, starts, damping and margin."""

    weight: float = 0.0
    """weight relative to the contrastive loss; 0 disables the loss (GN-Net)"""
    vicinity: float = 5.0
    """pixels of the level; along u and v, starts are uniform within this distance of the true pixel"""
    damping: float = 2.0
    """lambda_f"""
    margin: float = 0.1
    """pixels^2 of the level"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight margin")
        above_0(self, "vicinity damping")


class DescentTerms(NamedTuple):
    """The loss of each point."""

    cost: Tensor
    """(..., N) float64, pixels^2"""
    valid: Tensor
    """(..., N) bool: the start and its neighbours are on the map"""
    nearer: Tensor
    """(..., N) bool: the step came closer to the true pixel, however little"""


def descent_terms(
    features_query: Tensor, f_ref: Tensor, u_true: Tensor, start: Tensor, options: DescentOptions
) -> DescentTerms:
    """The cost of one damped step for each point; arguments are those of ``gauss_newton_terms``."""
    values, jacobian, valid = sample_with_gradient(features_query, start)
    hessian, b = normal_equations(jacobian, values - f_ref)
    after = start.double() - hessian.plus_diagonal(options.damping).solve(b)
    before_squared = ((start - u_true).double() ** 2).sum(-1)
    after_squared = ((after - u_true.double()) ** 2).sum(-1)
    cost = (after_squared - before_squared + options.margin).clamp(min=0)
    return DescentTerms(cost, valid, (after_squared < before_squared).detach())
