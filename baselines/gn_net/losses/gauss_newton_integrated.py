"""The mean of the Gauss-Newton loss over all starts, by numerical integration.

Symbols as in ``gauss_newton``; the start is u_b + delta with delta uniform in [-v, v]^2. Multiplied out,

    e1 = 1/2 delta^T H delta - delta^T b + 1/2 b^T H^-1 b

The values of a bilinear map and their central differences are bilinear inside each cell between four pixel centres, and
not smooth across its sides. Therefore the square of starts is divided along the cells. Inside a cell, the first two
terms are polynomials of degree at most 4 in each coordinate; the third is a ratio of polynomials and e2 the logarithm
of one, which are smooth because |H| >= eps^2.

Gauss-Legendre quadrature with n nodes along each side of a cell is exact for degrees up to 2 n - 1. From n = 3 on it
integrates the first two terms exactly; the others converge geometrically in n, more slowly where H is close to
singular. For v = 1 the square meets at most 3 x 3 cells, so that each point takes (3 n)^2 evaluations.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from baselines.gn_net.losses.gauss_newton import GaussNewtonTerms, terms_of_step
from baselines.gn_net.sampling import sample_grid_with_gradient


def integrated_gauss_newton_terms(
    features_query: Tensor, f_ref: Tensor, u_true: Tensor, vicinity: float, eps: float, nodes: int = 2
) -> GaussNewtonTerms:
    """E[e1] and E[e2] over the start.

    Args:
        features_query: (..., D, H, W), the map F_b.
        f_ref: (..., N, D), F_a(u_a).
        u_true: (..., N, 2), u_b in pixels of the map.
        vicinity: v, pixels of the map.
        eps: see ``GaussNewtonOptions``.
        nodes: n.

    Returns:
        Means over the starts; a point is valid if all of its starts are.
    """
    along_u, weight_u = _nodes_along(u_true[..., 0], vicinity, nodes)
    along_v, weight_v = _nodes_along(u_true[..., 1], vicinity, nodes)
    values, jacobian, valid = sample_grid_with_gradient(features_query, along_u, along_v, 2 * vicinity)
    delta_u, delta_v = along_u - u_true[..., 0, None], along_v - u_true[..., 1, None]
    delta = torch.stack(torch.broadcast_tensors(delta_u[..., None, :], delta_v[..., :, None]), dim=-1)
    each = terms_of_step(values - f_ref[..., None, None, :], jacobian, delta, valid, eps)
    weights = weight_v[..., :, None] * weight_u[..., None, :]
    e1, e2, share = ((weights * part).sum((-2, -1)) for part in (each.e1, each.e2, each.near_singular))
    return GaussNewtonTerms(e1, e2, valid.all(-1).all(-1), share)


def _nodes_along(u: Tensor, vicinity: float, nodes: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights (..., N, K n) of the mean over [u - v, u + v], divided at the integers within."""
    places, shares = np.polynomial.legendre.leggauss(nodes)
    place, share = torch.from_numpy(places).to(u), torch.from_numpy(shares).to(u)
    low, high = (u - vicinity)[..., None], (u + vicinity)[..., None]
    steps = torch.arange(math.ceil(2 * vicinity) + 2, device=u.device)
    # Pieces beyond the end have length and weight zero.
    cuts = torch.minimum(torch.maximum(low.floor() + steps, low), high)
    middle, half = 0.5 * (cuts[..., 1:] + cuts[..., :-1]), 0.5 * (cuts[..., 1:] - cuts[..., :-1])
    at = middle[..., None] + half[..., None] * place
    weight = half[..., None] * share / (2 * vicinity)
    return at.flatten(-2), weight.flatten(-2).double()
