"""Operations on small matrices in double precision, compiled and without allocation."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.kernels import njit


@njit(cache=True)
def se3_exp(xi: Array, out: Array) -> None:
    """Write exp(xi) = [[exp(phi^), V(phi) rho], [0, 1]] of a twist xi = (rho, phi) (6,) to ``out`` (4, 4)."""
    theta2 = xi[3] * xi[3] + xi[4] * xi[4] + xi[5] * xi[5]
    theta = np.sqrt(theta2)
    if theta < 1e-3:  # sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 to the last bit
        a, b, c = 1 - theta2 / 6 * (1 - theta2 / 20), 0.5 - theta2 / 24, 1 / 6 - theta2 / 120
    else:
        a = np.sin(theta) / theta
        b = 2 * (np.sin(theta / 2) / theta) ** 2
        c = (theta - np.sin(theta)) / (theta2 * theta)
    W = ((0.0, -xi[5], xi[4]), (xi[5], 0.0, -xi[3]), (-xi[4], xi[3], 0.0))
    for i in range(4):
        for j in range(4):
            out[i, j] = 1.0 if i == j else 0.0
    for i in range(3):
        for j in range(3):
            w2 = W[i][0] * W[0][j] + W[i][1] * W[1][j] + W[i][2] * W[2][j]
            out[i, j] += a * W[i][j] + b * w2
            out[i, 3] += (b * W[i][j] + c * w2) * xi[j]
        out[i, 3] += xi[i]


@njit(cache=True)
def product(A: Array, B: Array, out: Array) -> None:
    """Write A @ B to ``out``, all (4, 4); ``out`` must be neither of the two."""
    for i in range(4):
        for j in range(4):
            out[i, j] = 0.0
            for k in range(4):
                out[i, j] += A[i, k] * B[k, j]


@njit(cache=True)
def solve_cholesky(A: Array, b: Array, L: Array, x: Array) -> bool:
    """Solve A x = b for x (n,), A symmetric; False when A is not positive definite.

    Of a larger A or b, the leading n rows and columns are used. L, (n, n) or larger, is overwritten.
    """
    n = len(x)
    for i in range(n):
        for j in range(i + 1):
            rest = A[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i != j:
                L[i, j] = rest / L[j, j]
            elif rest > 0.0:  # false for NaN as well
                L[i, i] = np.sqrt(rest)
            else:
                return False
    for i in range(n):
        x[i] = b[i]
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return True
