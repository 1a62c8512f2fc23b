"""Batches of symmetric 2x2 matrices, in closed form and double precision.

The eigenvalues of J^T J along an edge differ by orders of magnitude, so that in single precision its determinant may
become negative. Sums are written out because autocasting would compute matrix products in half precision.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Symmetric(NamedTuple):
    """[[xx, xy], [xy, yy]], each entry (...) float64."""

    xx: Tensor
    xy: Tensor
    yy: Tensor

    def plus_diagonal(self, value: float | Tensor) -> Symmetric:
        """Add ``value`` to both diagonal entries."""
        return Symmetric(self.xx + value, self.xy, self.yy + value)

    def determinant(self) -> Tensor:
        """The determinant (...)."""
        return self.xx * self.yy - self.xy * self.xy

    def solve(self, b: Tensor) -> Tensor:
        """The solution x (..., 2) of A x = b; not finite where A is singular."""
        x = self.yy * b[..., 0] - self.xy * b[..., 1]
        y = self.xx * b[..., 1] - self.xy * b[..., 0]
        return torch.stack([x, y], dim=-1) / self.determinant()[..., None]

    def quadratic(self, d: Tensor) -> Tensor:
        """The quadratic form d^T A d (...) of d (..., 2)."""
        x, y = d[..., 0], d[..., 1]
        return self.xx * x * x + 2 * self.xy * x * y + self.yy * y * y

    def smaller_eigenvalue(self) -> Tensor:
        """The smaller eigenvalue (...) of a positive semi-definite matrix."""
        half = 0.5 * (self.xx + self.yy)
        larger = half + torch.sqrt((0.5 * (self.xx - self.yy)) ** 2 + self.xy**2)
        # The quotient of determinant and larger eigenvalue avoids cancellation.
        return self.determinant() / larger.clamp(min=torch.finfo(larger.dtype).tiny)


def normal_equations(jacobian: Tensor, residual: Tensor) -> tuple[Symmetric, Tensor]:
    """J^T J and b = J^T r (..., 2) from J (..., D, 2) and r (..., D)."""
    j, r = jacobian.double(), residual.double()
    jx, jy = j[..., 0], j[..., 1]
    hessian = Symmetric((jx * jx).sum(-1), (jx * jy).sum(-1), (jy * jy).sum(-1))
    return hessian, torch.stack([(jx * r).sum(-1), (jy * r).sum(-1)], dim=-1)
