"""The mean of the Gauss-Newton loss over all starts, in closed form, for features linear around the true pixel.

Symbols as in ``gauss_newton``; the start is u_b + delta with delta uniform in [-v, v]^2.

Where F_b is affine in the vicinity, J is the same at every start and r(delta) = r0 + J delta, r0 = F_b(u_b) - f. So
b = J^T r0 + (H - eps I) delta, and with b0 = J^T r0

    u_b - mu = -delta + H^-1 b = H^-1 (b0 - eps delta)
    e1 = 1/2 (b0 - eps delta)^T H^-1 (b0 - eps delta)

delta has mean zero and covariance v^2/3 I, so that the mixed term vanishes and the square leaves the trace of H^-1.
Neither H nor e2 depends on delta:

    E[e1] = 1/2 b0^T H^-1 b0 + 1/6 eps^2 v^2 tr H^-1      E[e2] = log(2 pi) - 1/2 log|H|

This takes one look-up for each point and nothing random. It is blind to the curvature of the features: of
``J^T (r - J delta)``, which determines u_b - mu in general, the affine case keeps r0 alone. It rewards agreement and
certainty at the true pixel, but not convergence from beside it, as ``gauss_newton_integrated`` does.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from baselines.gn_net.losses.gauss_newton import GaussNewtonTerms
from baselines.gn_net.losses.symmetric import normal_equations
from baselines.gn_net.sampling import sample_with_gradient


def affine_gauss_newton_terms(
    features_query: Tensor, f_ref: Tensor, u_true: Tensor, vicinity: float, eps: float
) -> GaussNewtonTerms:
    """E[e1] and E[e2] over the start; exact where the map is affine within ``vicinity`` + 1 px of the true pixel.

    Args:
        features_query: (..., D, H, W), the map F_b.
        f_ref: (..., N, D), F_a(u_a).
        u_true: (..., N, 2), u_b in pixels of the map.
        vicinity: v, pixels of the map.
        eps: see ``GaussNewtonOptions``.
    """
    values, jacobian, valid = sample_with_gradient(features_query, u_true)
    hessian, b0 = normal_equations(jacobian, values - f_ref)
    damped = hessian.plus_diagonal(eps)
    e1 = 0.5 * (b0 * damped.solve(b0)).sum(-1) + (eps * vicinity) ** 2 / 6.0 * damped.trace_of_inverse()
    e2 = math.log(2 * math.pi) - 0.5 * torch.log(damped.determinant())
    near_singular = (hessian.smaller_eigenvalue() < eps).to(e1)
    return GaussNewtonTerms(e1, e2, valid, near_singular)
