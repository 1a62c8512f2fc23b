"""Residuals, robust weights and normal equations of direct alignment, in one pass over the points.

Per point, with normalised coordinates (x, y) in the reference and inverse depth id (Engel, Koltun and Cremers,
Direct Sparse Odometry, 2018; von Stumberg et al., GN-Net, 2020):

    x' = R [x y 1]^T + t id,   (u, v) = (x'_x, x'_y) / x'_z,   id' = id / x'_z,   p' = (fx u + cx, fy v + cy)
    r  = F'(p') - (a F_ref + b)                           one number a channel
    dp'/dxi = diag(fx, fy) [id'  0   -id' u   -u v      1 + u^2   -v]      for exp(xi) T, xi = (rho, phi)
                           [0    id' -id' v   -(1+v^2)  u v        u]

The D channels are first reduced to a 2x2 tensor and a 2-vector, sum w g g^T and sum w g r, which meet the 2x6 geometry
once. Points are worked on in blocks that stay in the first-level cache: warp, look up, accumulate; the first and the
last of these loops are free of branches, so that the compiler makes SIMD code of them. All of it is in one file because
numba's cache does not notice a change in another one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
Number = float | np.floating[Any]

FAST = {"reassoc", "nsz", "arcp", "contract"}
"""fast-math flags; not-a-number and infinity keep their meaning, the validity test relies on it"""
BLOCK = 128
"""points at a time"""
BORDER = 2
"""pixels; nearer to the query's border a point is dropped"""

# Rows of the scratch block: what one stage hands to the next, one column a point.
U, V, ID, PX, PY, VALID = 0, 1, 2, 3, 4, 5
F, FX, FY = 6, 7, 8
AXX, AXY, AYY, BX, BY = 9, 10, 11, 12, 13
CX, CY, DX, DY = 14, 15, 16, 17
SCRATCH_ROWS = 18


@njit(cache=True, fastmath=FAST, error_model="numpy")
def warp(
    points: FloatArray,
    start: int,
    n: int,
    intrinsics: FloatArray,
    T_query_ref: FloatArray,
    width: int,
    height: int,
    s: FloatArray,
) -> None:
    """Rows u, v, id', p'_x, p'_y and valid (1 or 0) of points start .. start + n.

    A dropped point gets zeros and a harmless pixel, so that whatever is read there adds nothing to any sum.
    """
    zero, one = s.dtype.type(0), s.dtype.type(1)
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    r00, r01, r02, t0 = T_query_ref[0, 0], T_query_ref[0, 1], T_query_ref[0, 2], T_query_ref[0, 3]
    r10, r11, r12, t1 = T_query_ref[1, 0], T_query_ref[1, 1], T_query_ref[1, 2], T_query_ref[1, 3]
    r20, r21, r22, t2 = T_query_ref[2, 0], T_query_ref[2, 1], T_query_ref[2, 2], T_query_ref[2, 3]
    border = s.dtype.type(BORDER)
    right, bottom = s.dtype.type(width - 1 - BORDER), s.dtype.type(height - 1 - BORDER)
    xs, ys, inverse_depths = points[0], points[1], points[2]
    for k in range(n):
        x, y, inverse_depth = xs[start + k], ys[start + k], inverse_depths[start + k]
        inv_z = one / (r20 * x + r21 * y + r22 + t2 * inverse_depth)
        u = (r00 * x + r01 * y + r02 + t0 * inverse_depth) * inv_z
        v = (r10 * x + r11 * y + r12 + t1 * inverse_depth) * inv_z
        i = inverse_depth * inv_z
        px, py = fx * u + cx, fy * v + cy
        valid = (i > zero) & (px > border) & (py > border) & (px < right) & (py < bottom)
        s[U, k] = u if valid else zero
        s[V, k] = v if valid else zero
        s[ID, k] = i if valid else zero
        s[PX, k] = px if valid else border
        s[PY, k] = py if valid else border
        s[VALID, k] = one if valid else zero


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _look_up(level_map: FloatArray, n: int, s: FloatArray) -> None:
    """Rows F, dF/dx, dF/dy: a one-channel map looked up bilinearly."""
    one = s.dtype.type(1)
    next_one = np.uint32(1)
    for k in range(n):
        px, py = s[PX, k], s[PY, k]
        ix, iy = np.uint32(np.int32(px)), np.uint32(np.int32(py))  # unsigned: spares the test for negative indices
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
def _weigh_intensity(
    values: FloatArray,
    start: int,
    n: int,
    intrinsics: FloatArray,
    light: FloatArray,
    huber: Number,
    cutoff: Number,
    s: FloatArray,
    sums: FloatArray,
) -> None:
    """One channel with affine brightness: rows A, b and the products with the two brightness columns.

    sums: energy, valid, saturated, then w J_a J_a, w J_a J_b, w J_b J_b, w J_a r, w J_b r are added to.
    """
    zero, two = s.dtype.type(0), s.dtype.type(2)
    fx, fy = intrinsics[0], intrinsics[1]
    gain, offset = light[0], light[1]
    saturated_energy = two * huber * cutoff - huber * huber
    energy, valid, saturated = zero, zero, zero
    saa, sab, sbb, sar, sbr = zero, zero, zero, zero, zero
    reference = values.reshape(-1)[start : start + n]
    for k in range(n):
        ja = -gain * reference[k]  # J_a = -gain F_ref, J_b = -1
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
def _weigh_features(
    level_map: FloatArray,
    values: FloatArray,
    start: int,
    n: int,
    intrinsics: FloatArray,
    huber: Number,
    cutoff: Number,
    per_channel: bool,
    s: FloatArray,
    sums: FloatArray,
) -> None:
    """D channels, no brightness: rows A and b. sums: energy, valid, saturated are added to."""
    one = s.dtype.type(1)
    zero = s.dtype.type(0)
    two = s.dtype.type(2)
    fx, fy = intrinsics[0], intrinsics[1]
    channels = values.shape[1]
    saturated_energy = two * huber * cutoff - huber * huber
    energy, saturated = zero, zero
    valid = 0
    for k in range(n):
        px, py = s[PX, k], s[PY, k]
        axx, axy, ayy, bx, by = zero, zero, zero, zero, zero
        if s[VALID, k] > zero:
            ix, iy = int(px), int(py)
            ax, ay = px - s.dtype.type(ix), py - s.dtype.type(iy)
            w11 = ax * ay
            w10, w01 = ay - w11, ax - w11
            w00 = one - ax - ay + w11
            m00, m01 = level_map[iy, ix], level_map[iy, ix + 1]
            m10, m11 = level_map[iy + 1, ix], level_map[iy + 1, ix + 1]
            wanted = values[start + k]
            if per_channel:
                valid += channels
                for c in range(channels):
                    cx, cy = channels + c, 2 * channels + c
                    r = w00 * m00[c] + w01 * m01[c] + w10 * m10[c] + w11 * m11[c] - wanted[c]
                    gx = w00 * m00[cx] + w01 * m01[cx] + w10 * m10[cx] + w11 * m11[cx]
                    gy = w00 * m00[cy] + w01 * m01[cy] + w10 * m10[cy] + w11 * m11[cy]
                    size = abs(r)
                    beyond = size > cutoff
                    w = zero if beyond else huber / max(size, huber)
                    energy += saturated_energy if beyond else w * r * r * (two - w)
                    saturated += one if beyond else zero
                    wgx, wgy = w * gx, w * gy
                    axx += wgx * gx
                    axy += wgx * gy
                    ayy += wgy * gy
                    bx += wgx * r
                    by += wgy * r
            else:
                valid += 1
                rr = zero
                for c in range(channels):
                    cx, cy = channels + c, 2 * channels + c
                    r = w00 * m00[c] + w01 * m01[c] + w10 * m10[c] + w11 * m11[c] - wanted[c]
                    gx = w00 * m00[cx] + w01 * m01[cx] + w10 * m10[cx] + w11 * m11[cx]
                    gy = w00 * m00[cy] + w01 * m01[cy] + w10 * m10[cy] + w11 * m11[cy]
                    rr += r * r
                    axx += gx * gx
                    axy += gx * gy
                    ayy += gy * gy
                    bx += gx * r
                    by += gy * r
                size = np.sqrt(rr)
                beyond = size > cutoff
                w = zero if beyond else huber / max(size, huber)
                energy += saturated_energy if beyond else w * rr * (two - w)
                saturated += one if beyond else zero
                axx, axy, ayy, bx, by = w * axx, w * axy, w * ayy, w * bx, w * by
        s[AXX, k], s[AXY, k], s[AYY, k] = fx * fx * axx, fx * fy * axy, fy * fy * ayy
        s[BX, k], s[BY, k] = fx * bx, fy * by
    sums[0] += energy
    sums[1] += valid
    sums[2] += saturated


@njit(cache=True, fastmath=FAST, error_model="numpy")
def accumulate_pose(s: FloatArray, n: int, H: FloatArray, g: FloatArray) -> None:
    """Add sum P^T A P to the upper triangle of H[:6, :6] and sum P^T b to g[:6], with P = dp'/dxi (2x6)."""
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


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _accumulate_light(s: FloatArray, n: int, H: FloatArray) -> None:
    """Add sum P^T (w grad r J_light) to H[:6, 6:8], the products of pose and brightness columns."""
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
    light: FloatArray,
    huber: float,
    cutoff: float,
    per_channel: bool,
    H: NDArray[np.float64],
    g: NDArray[np.float64],
) -> tuple[float, int, int]:
    """Energy and normal equations at one pose.

    Computes in the precision of ``points`` (float32 in use, float64 where a test wants the digits); sums over blocks
    are float64.

    Args:
        level_map: (H, W, 3 D) query map: values, x derivatives, y derivatives.
        points: (3, N) normalised x, y and inverse depth (1/m) in the reference camera.
        values: (N, D) reference values.
        intrinsics: (4,) fx, fy, cx, cy of the query level.
        T_query_ref: (4, 4) or (3, 4).
        light: (2,) gain and offset: r = F' - (gain F_ref + offset). Used with one channel only.
        huber, cutoff: in units of the values; on |r|.
        per_channel: with several channels, weigh each channel's residual on its own; else weigh the norm over all
            channels. With ``per_channel`` each channel of a point counts as one residual.
        H: (8, 8) out: mean w J J^T, symmetric; columns translation 3, rotation 3, a (log gain), b (offset).
        g: (8,) out: mean w J r.

    Returns:
        mean energy (infinite without a valid residual), number of valid residuals, number of saturated ones among
        them. A residual is valid when the point falls more than 2 px inside the query's border, in front of the
        camera; it is saturated when |r| > cutoff, adds 2 huber cutoff - huber^2 to the energy and nothing to H, g.
    """
    number = points.dtype.type
    scratch = np.empty((SCRATCH_ROWS, BLOCK), points.dtype)
    K, T, L = intrinsics.astype(points.dtype), T_query_ref.astype(points.dtype), light.astype(points.dtype)
    h, c = number(huber), number(cutoff)
    sums = np.zeros(8, np.float64)
    H[:] = 0.0
    g[:] = 0.0
    if min(level_map.shape[0], level_map.shape[1]) < 2 * BORDER + 2:
        return np.inf, 0, 0
    one_channel = values.shape[1] == 1
    for start in range(0, points.shape[1], BLOCK):
        n = min(BLOCK, points.shape[1] - start)
        warp(points, start, n, K, T, level_map.shape[1], level_map.shape[0], scratch)
        if one_channel:
            _look_up(level_map, n, scratch)
            _weigh_intensity(values, start, n, K, L, h, c, scratch, sums)
            _accumulate_light(scratch, n, H)
        else:
            _weigh_features(level_map, values, start, n, K, h, c, per_channel, scratch, sums)
        accumulate_pose(scratch, n, H, g)
    H[6, 6], H[6, 7], H[7, 7] = sums[3], sums[4], sums[5]
    g[6], g[7] = sums[6], sums[7]
    valid, saturated = int(sums[1]), int(sums[2])
    if valid == 0:
        return np.inf, 0, 0
    for row in range(8):
        g[row] /= valid
        for column in range(row, 8):
            H[row, column] /= valid
            H[column, row] = H[row, column]
    return sums[0] / valid, valid, saturated
