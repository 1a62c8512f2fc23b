"""Gauss-Newton loss: one step from a start nearby should reach the true pixel, with a correct uncertainty.

GN-Net (von Stumberg et al., RA-L 2020, section III.B), for a point with feature f = F_a(u_a) and true pixel u_b, from a
start x_s = u_b + noise:

    r = F_b(x_s) - f      J = dF_b/dx (x_s)      H = J^T J + eps I      b = J^T r      mu = x_s - H^-1 b
    E = e1 + e2      e1 = 1/2 (u_b - mu)^T H (u_b - mu)      e2 = log(2 pi) - 1/2 log|H|

E is the negative log-likelihood of u_b under the Gaussian of mean mu and covariance H^-1 that the linear system
describes. e1 alone is minimised by features without contrast, e2 alone by features of infinite contrast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from baselines.gn_net.losses.symmetric import normal_equations
from baselines.gn_net.sampling import sample_with_gradient
from baselines.options import Options, above_0, at_least


@dataclass(frozen=True)
class GaussNewtonOptions(Options):
    """Weights of the loss and its parts, and how far off starts are."""

    weight: float = 0.5
    """weight relative to the contrastive loss; 0 disables the loss"""
    e1: float = 1.0
    """weight of e1"""
    e2: float = 2.0 / 7.0
    """weight of e2; GN-Net's likelihood has 1, published reimplementations 2/7"""
    eps: float = 1e-6
    """added to both diagonal entries of J^T J, squared features / pixel^2"""
    vicinity: float = 1.0
    """pixels of the level; along u and v, starts are uniform within this distance of the true pixel"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight e1 e2")
        above_0(self, "eps vicinity")


class GaussNewtonTerms(NamedTuple):
    """The two parts of the loss of each point."""

    e1: Tensor
    """(..., N) float64"""
    e2: Tensor
    """(..., N) float64"""
    valid: Tensor
    """(..., N) bool: the start and its neighbours are on the map"""
    near_singular: Tensor
    """(..., N): 1 where the smaller eigenvalue of J^T J is below eps, so that eps determines the uncertainty, else 0"""


def draw_starts(u_true: Tensor, vicinity: float, generator: torch.Generator) -> Tensor:
    """Starts (..., N, 2): u_true plus noise, uniform in [-vicinity, vicinity] along u and v.

    Args:
        u_true: (..., N, 2) pixels.
        vicinity: pixels.
        generator: on the CPU, so that the draws do not depend on the device.
    """
    noise = 2.0 * torch.rand(u_true.shape, generator=generator, dtype=torch.float64) - 1.0
    return u_true + vicinity * noise.to(u_true)


def gauss_newton_terms(
    features_query: Tensor, f_ref: Tensor, u_true: Tensor, start: Tensor, eps: float
) -> GaussNewtonTerms:
    """e1 and e2 of one Gauss-Newton step for each point.

    Args:
        features_query: (..., D, H, W), the map F_b.
        f_ref: (..., N, D), F_a(u_a).
        u_true: (..., N, 2), u_b in pixels of the map.
        start: (..., N, 2), x_s.
        eps: see ``GaussNewtonOptions``.
    """
    values, jacobian, valid = sample_with_gradient(features_query, start)
    hessian, b = normal_equations(jacobian, values - f_ref)
    damped = hessian.plus_diagonal(eps)
    e1 = 0.5 * damped.quadratic(damped.solve(b) - (start - u_true).double())  # u_b - mu
    e2 = math.log(2 * math.pi) - 0.5 * torch.log(damped.determinant())
    near_singular = (hessian.smaller_eigenvalue() < eps).to(e1)
    return GaussNewtonTerms(e1, e2, valid, near_singular)
