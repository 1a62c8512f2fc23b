"""The normal equations of the pose, compiled.

When the pose T_query_ref is replaced by exp(xi) T_query_ref, xi = (rho, phi), the pixel p' of a point has the
derivative (Engel, Koltun and Cremers, Direct Sparse Odometry, PAMI 2018; von Stumberg et al., GN-Net, RA-L 2020)

    dp'/dxi = diag(fx, fy) P,   P = [id'  0   -id' u   -u v      1 + u^2   -v]
                                    [0    id' -id' v   -(1+v^2)  u v        u]

with u, v, id' of :mod:`~baselines.alignment.shared.warp`. The channels of a point, with gradients g times the focal
lengths and weights w, are first reduced to A = sum w g g^T (2x2) and b = sum w g r (2). Then

    H = sum over the points of P^T A P,      gradient = sum over the points of P^T b
"""

from __future__ import annotations

from baselines.alignment.shared.compiled import FAST, FloatArray
from baselines.alignment.shared.scratch import AXX, AXY, AYY, BX, BY, ID, U, V
from relocbench.arrays import Array
from relocbench.kernels import njit


@njit(cache=True, fastmath=FAST, error_model="numpy")
def accumulate_pose(s: FloatArray, n: int, H: FloatArray, g: FloatArray) -> None:
    """Add sum P^T A P to the upper triangle of H[:6, :6] and sum P^T b to g[:6], P (2x6)."""
    one = s.dtype.type(1)
    z = s.dtype.type(0)
    h00, h01, h02, h03, h04, h05 = z, z, z, z, z, z
    h11, h12, h13, h14, h15 = z, z, z, z, z
    h22, h23, h24, h25 = z, z, z, z
    h33, h34, h35, h44, h45, h55 = z, z, z, z, z, z
    g0, g1, g2, g3, g4, g5 = z, z, z, z, z, z
    for k in range(n):
        u, v, i = s[U, k], s[V, k], s[ID, k]
        axx, axy, ayy, bx, by = s[AXX, k], s[AXY, k], s[AYY, k], s[BX, k], s[BY, k]
        # The rows of P: (i, 0, x2, x3, x4, -v) and (0, i, y2, y3, -x3, u).
        x2, x3, x4 = -i * u, -u * v, one + u * u
        y2, y3 = -i * v, -(one + v * v)
        # The columns of Q = A P; the lower half of the first one is never needed.
        q0x = axx * i
        q1x, q1y = axy * i, ayy * i
        q2x, q2y = axx * x2 + axy * y2, axy * x2 + ayy * y2
        q3x, q3y = axx * x3 + axy * y3, axy * x3 + ayy * y3
        q4x, q4y = axx * x4 - axy * x3, axy * x4 - ayy * x3
        q5x, q5y = axy * u - axx * v, ayy * u - axy * v
        h00 += i * q0x
        h01 += i * q1x
        h02 += i * q2x
        h03 += i * q3x
        h04 += i * q4x
        h05 += i * q5x
        h11 += i * q1y
        h12 += i * q2y
        h13 += i * q3y
        h14 += i * q4y
        h15 += i * q5y
        h22 += x2 * q2x + y2 * q2y
        h23 += x2 * q3x + y2 * q3y
        h24 += x2 * q4x + y2 * q4y
        h25 += x2 * q5x + y2 * q5y
        h33 += x3 * q3x + y3 * q3y
        h34 += x3 * q4x + y3 * q4y
        h35 += x3 * q5x + y3 * q5y
        h44 += x4 * q4x - x3 * q4y
        h45 += x4 * q5x - x3 * q5y
        h55 += u * q5y - v * q5x
        g0 += i * bx
        g1 += i * by
        g2 += x2 * bx + y2 * by
        g3 += x3 * bx + y3 * by
        g4 += x4 * bx - x3 * by
        g5 += u * by - v * bx
    rows = (
        (h00, h01, h02, h03, h04, h05),
        (z, h11, h12, h13, h14, h15),
        (z, z, h22, h23, h24, h25),
        (z, z, z, h33, h34, h35),
        (z, z, z, z, h44, h45),
        (z, z, z, z, z, h55),
    )
    gradient = (g0, g1, g2, g3, g4, g5)
    for row in range(6):
        g[row] += gradient[row]
        for column in range(6):
            H[row, column] += rows[row][column]


@njit(cache=True, error_model="numpy")
def divide_and_mirror(H: Array, g: Array, total: float) -> None:
    """Divide the upper triangle of H (n, n) and g (n,) by ``total``, and make H symmetric."""
    n = g.shape[0]
    for row in range(n):
        g[row] /= total
        for column in range(row, n):
            H[row, column] /= total
            H[column, row] = H[row, column]
