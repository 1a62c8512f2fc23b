"""Residuals, robust weights and normal equations of direct alignment, in one pass over the points.

For each point, with p' its pixel in the query (:mod:`~baselines.alignment.shared.warp`; Engel, Koltun and Cremers,
Direct Sparse Odometry, PAMI 2018):

    r   = I'(p') - (gain I_ref + offset)      I' and its stored gradients g (1, 2) are interpolated bilinearly
    J   = [g dp'/dxi, -gain I_ref, -1]        derivatives with respect to xi, a = log gain and b = offset

Points are processed in blocks: warp, look up, weigh, accumulate. None of these loops has a branch, so that the compiler
vectorises them.
"""

from __future__ import annotations

import numpy as np

from baselines.alignment.shared.compiled import FAST, FloatArray, Number
from baselines.alignment.shared.normal_equations import accumulate_pose, divide_and_mirror
from baselines.alignment.shared.scratch import AXX, AXY, AYY, BLOCK, BX, BY, ID, PX, PY, SHARED_ROWS, VALID, U, V
from baselines.alignment.shared.warp import SMALLEST_SIDE, warp
from relocbench.arrays import Array
from relocbench.kernels import njit

# Rows of the scratch block behind the shared ones: the interpolated map, and products with the brightness columns.
F, FX, FY = SHARED_ROWS, SHARED_ROWS + 1, SHARED_ROWS + 2
CX, CY, DX, DY = SHARED_ROWS + 3, SHARED_ROWS + 4, SHARED_ROWS + 5, SHARED_ROWS + 6
SCRATCH_ROWS = SHARED_ROWS + 7


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _look_up(level_map: FloatArray, n: int, s: FloatArray) -> None:
    """Write rows F, dF/dx and dF/dy, interpolated bilinearly."""
    one = s.dtype.type(1)
    next_one = np.uint32(1)
    for k in range(n):
        px, py = s[PX, k], s[PY, k]
        ix, iy = np.uint32(np.int32(px)), np.uint32(np.int32(py))  # unsigned: no test for negative indices
        ax, ay = px - s.dtype.type(np.int32(px)), py - s.dtype.type(np.int32(py))
        w11 = ax * ay
        w10, w01 = ay - w11, ax - w11
        w00 = one - ax - w10
        jx, jy = np.uint32(ix + next_one), np.uint32(iy + next_one)
        s[F, k] = (
            w00 * level_map[iy, ix, 0]
            + w01 * level_map[iy, jx, 0]
            + w10 * level_map[jy, ix, 0]
            + w11 * level_map[jy, jx, 0]
        )
        s[FX, k] = (
            w00 * level_map[iy, ix, 1]
            + w01 * level_map[iy, jx, 1]
            + w10 * level_map[jy, ix, 1]
            + w11 * level_map[jy, jx, 1]
        )
        s[FY, k] = (
            w00 * level_map[iy, ix, 2]
            + w01 * level_map[iy, jx, 2]
            + w10 * level_map[jy, ix, 2]
            + w11 * level_map[jy, jx, 2]
        )


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _weigh(
    values: FloatArray,
    start: int,
    n: int,
    intrinsics: FloatArray,
    gain_offset: FloatArray,
    huber: Number,
    cutoff: Number,
    s: FloatArray,
    sums: FloatArray,
) -> None:
    """Write rows A and b, and the products with the two brightness columns.

    Added to ``sums`` are the energy, the numbers of valid and of saturated residuals, and the sums of w J_a J_a,
    w J_a J_b, w J_b J_b, w J_a r and w J_b r.
    """
    zero, two = s.dtype.type(0), s.dtype.type(2)
    fx, fy = intrinsics[0], intrinsics[1]
    gain, offset = gain_offset[0], gain_offset[1]
    saturated_energy = two * huber * cutoff - huber * huber
    energy, valid, saturated = zero, zero, zero
    saa, sab, sbb, sar, sbr = zero, zero, zero, zero, zero
    reference = values.reshape(-1)[start : start + n]
    for k in range(n):
        ja = -gain * reference[k]  # J_a = -gain I_ref, J_b = -1
        r = s[F, k] + ja - offset
        gx, gy = fx * s[FX, k], fy * s[FY, k]
        size = abs(r)
        beyond = size > cutoff
        within = s[VALID, k]
        w = huber / max(size, huber)  # 1 below the Huber threshold
        fit = w * r * r * (two - w)
        energy += within * (saturated_energy if beyond else fit)
        valid += within
        kept = zero if beyond else within
        saturated += within - kept
        w = kept * w
        wgx, wgy, wja, wr = w * gx, w * gy, w * ja, w * r
        s[AXX, k] = wgx * gx
        s[AXY, k] = wgx * gy
        s[AYY, k] = wgy * gy
        s[BX, k] = gx * wr
        s[BY, k] = gy * wr
        s[CX, k] = gx * wja
        s[CY, k] = gy * wja
        s[DX, k] = -wgx
        s[DY, k] = -wgy
        saa += wja * ja
        sab -= wja
        sbb += w
        sar += ja * wr
        sbr -= wr
    sums[0] += energy
    sums[1] += valid
    sums[2] += saturated
    sums[3] += saa
    sums[4] += sab
    sums[5] += sbb
    sums[6] += sar
    sums[7] += sbr


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _accumulate_brightness(s: FloatArray, n: int, H: FloatArray) -> None:
    """Add sum P^T (w grad r J_brightness) to H[:6, 6:8], the products of pose and brightness columns."""
    one = s.dtype.type(1)
    z = s.dtype.type(0)
    a0, a1, a2, a3, a4, a5 = z, z, z, z, z, z
    b0, b1, b2, b3, b4, b5 = z, z, z, z, z, z
    for k in range(n):
        u, v, i = s[U, k], s[V, k], s[ID, k]
        cx, cy, dx, dy = s[CX, k], s[CY, k], s[DX, k], s[DY, k]
        x3, x4, y3 = -u * v, one + u * u, -(one + v * v)
        a0 += i * cx
        a1 += i * cy
        a2 -= i * (u * cx + v * cy)
        a3 += x3 * cx + y3 * cy
        a4 += x4 * cx - x3 * cy
        a5 += u * cy - v * cx
        b0 += i * dx
        b1 += i * dy
        b2 -= i * (u * dx + v * dy)
        b3 += x3 * dx + y3 * dy
        b4 += x4 * dx - x3 * dy
        b5 += u * dy - v * dx
    column_a = (a0, a1, a2, a3, a4, a5)
    column_b = (b0, b1, b2, b3, b4, b5)
    for row in range(6):
        H[row, 6] += column_a[row]
        H[row, 7] += column_b[row]


@njit(cache=True, error_model="numpy")
def linearize(
    level_map: FloatArray,
    points: FloatArray,
    values: FloatArray,
    intrinsics: FloatArray,
    T_query_ref: FloatArray,
    gain_offset: FloatArray,
    huber: float,
    cutoff: float,
    H: Array,
    g: Array,
) -> tuple[float, int, int]:
    """Compute the mean energy and the normal equations at one pose.

    The precision is that of ``points`` (float32 in use, float64 in tests); sums over blocks are float64.

    Args:
        level_map: (H, W, 3) query map: value, x derivative, y derivative.
        points: (3, N) normalised x, y and inverse depth (1/m) in the reference camera.
        values: (N, 1) reference values.
        intrinsics: (4,) fx, fy, cx, cy of the query level.
        T_query_ref: (4, 4) or (3, 4).
        gain_offset: (2,) gain and offset in r = I' - (gain I_ref + offset).
        huber, cutoff: thresholds on |r|, in units of the values.
        H: (8, 8) out: mean of w J J^T, symmetric; columns: translation 3, rotation 3, a (log gain), b (offset).
        g: (8,) out: mean of w J r.

    Returns:
        The mean energy (infinite without a valid residual), the number of valid residuals, and the number of saturated
        ones among them. A residual is valid when the point lies in front of the camera and falls more than 2 px inside
        the query's border. It is saturated when |r| > cutoff; then it adds 2 huber cutoff - huber^2 to the energy and
        nothing to H and g.
    """
    number = points.dtype.type
    scratch = np.empty((SCRATCH_ROWS, BLOCK), points.dtype)
    K, T, brightness = (
        intrinsics.astype(points.dtype),
        T_query_ref.astype(points.dtype),
        gain_offset.astype(points.dtype),
    )
    h, c = number(huber), number(cutoff)
    sums = np.zeros(8, np.float64)
    H[:] = 0.0
    g[:] = 0.0
    if min(level_map.shape[0], level_map.shape[1]) < SMALLEST_SIDE:
        return np.inf, 0, 0
    for start in range(0, points.shape[1], BLOCK):
        n = min(BLOCK, points.shape[1] - start)
        warp(points, start, n, K, T, level_map.shape[1], level_map.shape[0], scratch)
        _look_up(level_map, n, scratch)
        _weigh(values, start, n, K, brightness, h, c, scratch, sums)
        _accumulate_brightness(scratch, n, H)
        accumulate_pose(scratch, n, H, g)
    H[6, 6], H[6, 7], H[7, 7] = sums[3], sums[4], sums[5]
    g[6], g[7] = sums[6], sums[7]
    valid, saturated = int(sums[1]), int(sums[2])
    if valid == 0:
        return np.inf, 0, 0
    divide_and_mirror(H, g, valid)
    return sums[0] / valid, valid, saturated
