"""Residuals, robust weights and normal equations of alignment on feature maps, in one pass over the points.

For each point, with D channels and p' its pixel in the query (:mod:`~baselines.alignment.shared.warp`; von Stumberg et
al., GN-Net, RA-L 2020):

    r   = F'(p') - F_ref                        F' interpolated bilinearly
    F_g = [F'(p' + x) - F'(p' - x), F'(p' + y) - F'(p' - y)] / 2           (D, 2), one pixel to either side
    J   = F_g dp'/dxi,      H = sum omega w J^T J,      g = sum omega w J^T r

omega is the weight of the point, w the Huber weight. First F_g^T w F_g (2x2) and F_g^T w r (2) are formed, which are
then multiplied by the 2x6 derivative of the pixel (:mod:`~baselines.alignment.shared.normal_equations`). The bilinear
map and its central differences at one place are made of twelve pixels: a 4x4 square without its corners.
"""

from __future__ import annotations

import numpy as np

from baselines.alignment.shared.compiled import FAST, FloatArray, Number
from baselines.alignment.shared.levenberg import COUNT, ENERGY, NOT_FINITE_POINTS, SATURATED, SQUARES, WEIGHT
from baselines.alignment.shared.normal_equations import accumulate_pose, divide_and_mirror
from baselines.alignment.shared.scratch import AXX, AXY, AYY, BLOCK, BX, BY, PX, PY, SHARED_ROWS, VALID
from baselines.alignment.shared.warp import SMALLEST_SIDE, warp
from relocbench.arrays import Array
from relocbench.kernels import njit


@njit(cache=True, fastmath=FAST, error_model="numpy")
def _weigh(
    level_map: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    start: int,
    n: int,
    intrinsics: FloatArray,
    huber: Number,
    cutoff: Number,
    per_channel: bool,
    s: FloatArray,
    statistics: Array,
) -> None:
    """Write rows A and b for points start .. start + n, and add to the statistics."""
    number = s.dtype.type
    zero, half, one, two = number(0), number(0.5), number(1), number(2)
    infinite = number(np.inf)
    fx, fy = intrinsics[0], intrinsics[1]
    channels = values.shape[1]
    residuals_a_point = channels if per_channel else 1
    saturated_energy = two * huber * cutoff - huber * huber
    energy, squares, weight = zero, zero, zero
    count, saturated, not_finite = 0, 0, 0
    for k in range(n):
        axx, axy, ayy, bx, by = zero, zero, zero, zero, zero
        if s[VALID, k] > zero:
            px, py = s[PX, k], s[PY, k]
            ix, iy = int(px), int(py)
            ax, ay = px - number(ix), py - number(iy)
            cx, cy = one - ax, one - ay
            hcx, hax, hcy, hay = half * cx, half * ax, half * cy, half * ay
            # Rows of the square from the top: t, a, b, d; columns from the left: 0, 1, 2, 3.
            t1, t2 = level_map[iy - 1, ix], level_map[iy - 1, ix + 1]
            a0, a1, a2, a3 = level_map[iy, ix - 1], level_map[iy, ix], level_map[iy, ix + 1], level_map[iy, ix + 2]
            b0, b1 = level_map[iy + 1, ix - 1], level_map[iy + 1, ix]
            b2, b3 = level_map[iy + 1, ix + 1], level_map[iy + 1, ix + 2]
            d1, d2 = level_map[iy + 2, ix], level_map[iy + 2, ix + 1]
            wanted = values[start + k]
            omega = weights[start + k]
            rr, point_energy, point_squares = zero, zero, zero
            point_saturated = 0
            if per_channel:
                for c in range(channels):
                    t, a = cx * t1[c] + ax * t2[c], cx * a1[c] + ax * a2[c]
                    b, d = cx * b1[c] + ax * b2[c], cx * d1[c] + ax * d2[c]
                    r = cy * a + ay * b - wanted[c]
                    gx = cy * (hcx * (a2[c] - a0[c]) + hax * (a3[c] - a1[c]))
                    gx += ay * (hcx * (b2[c] - b0[c]) + hax * (b3[c] - b1[c]))
                    gy = hcy * (b - t) + hay * (d - a)
                    size = abs(r)
                    beyond = size > cutoff
                    w = zero if beyond else huber / max(size, huber)
                    rr += r * r + gx * gx + gy * gy
                    point_energy += saturated_energy if beyond else w * r * r * (two - w)
                    point_squares += w * r * r
                    point_saturated += 1 if beyond else 0
                    wgx, wgy = w * gx, w * gy
                    axx += wgx * gx
                    axy += wgx * gy
                    ayy += wgy * gy
                    bx += wgx * r
                    by += wgy * r
                not_finite += 0 if rr < infinite else 1
            else:
                for c in range(channels):
                    t, a = cx * t1[c] + ax * t2[c], cx * a1[c] + ax * a2[c]
                    b, d = cx * b1[c] + ax * b2[c], cx * d1[c] + ax * d2[c]
                    r = cy * a + ay * b - wanted[c]
                    gx = cy * (hcx * (a2[c] - a0[c]) + hax * (a3[c] - a1[c]))
                    gx += ay * (hcx * (b2[c] - b0[c]) + hax * (b3[c] - b1[c]))
                    gy = hcy * (b - t) + hay * (d - a)
                    rr += r * r
                    axx += gx * gx
                    axy += gx * gy
                    ayy += gy * gy
                    bx += gx * r
                    by += gy * r
                not_finite += 0 if rr + axx + ayy < infinite else 1
                size = np.sqrt(rr)
                beyond = size > cutoff
                w = zero if beyond else huber / max(size, huber)
                point_energy = saturated_energy if beyond else w * rr * (two - w)
                point_squares = w * rr
                point_saturated = 1 if beyond else 0
                axx, axy, ayy, bx, by = w * axx, w * axy, w * ayy, w * bx, w * by
            energy += omega * point_energy
            squares += omega * point_squares
            weight += omega
            count += residuals_a_point
            saturated += point_saturated
            axx, axy, ayy, bx, by = omega * axx, omega * axy, omega * ayy, omega * bx, omega * by
        s[AXX, k], s[AXY, k], s[AYY, k] = fx * fx * axx, fx * fy * axy, fy * fy * ayy
        s[BX, k], s[BY, k] = fx * bx, fy * by
    statistics[ENERGY] += energy
    statistics[SQUARES] += squares
    statistics[WEIGHT] += weight * number(residuals_a_point)
    statistics[COUNT] += count
    statistics[SATURATED] += saturated
    statistics[NOT_FINITE_POINTS] += not_finite


@njit(cache=True, error_model="numpy")
def linearize_features(
    level_map: FloatArray,
    points: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    intrinsics: Array,
    T_query_ref: Array,
    huber: float,
    cutoff: float,
    per_channel: bool,
    workspace: tuple[FloatArray, FloatArray, FloatArray],
    H: Array,
    g: Array,
    statistics: Array,
) -> None:
    """Compute the mean energy and the normal equations at one pose, without allocating memory.

    The precision is that of ``points`` (float32 in use, float64 in tests); sums over blocks are float64.

    Args:
        level_map: (H, W, D) query features.
        points: (3, N) normalised x, y and inverse depth (1/m) in the reference camera.
        values: (N, D) reference features.
        weights: (N,) positive.
        intrinsics: (4,) fx, fy, cx, cy of the query level.
        T_query_ref: (4, 4).
        huber, cutoff: thresholds in units of the features, on the norm of r over the channels.
        per_channel: apply the thresholds to |r| of each channel instead; each channel then counts as one residual.
        workspace: of :func:`workspace_for`.
        H: (6, 6) out: mean of omega w J^T J, symmetric; translation 3, rotation 3. All means are over the valid
            residuals, weighted by omega.
        g: (6,) out: mean of omega w J^T r.
        statistics: (6,) out, see :mod:`~baselines.alignment.shared.levenberg`; SQUARES is the mean of omega w r^2 of
            the residuals that are not saturated, WEIGHT the sum of omega. A residual is valid when the point lies in
            front of the camera and falls more than 2 px inside the query's border. It is saturated beyond the cutoff;
            then it adds 2 huber cutoff - huber^2 to the energy and nothing to H and g.
    """
    number = points.dtype.type
    scratch, K, T = workspace
    for i in range(4):
        K[i] = intrinsics[i]
        for j in range(4):
            T[i, j] = T_query_ref[i, j]
    h, c = number(huber), number(cutoff)
    H[:] = 0.0
    g[:] = 0.0
    statistics[:] = 0.0
    height, width = level_map.shape[0], level_map.shape[1]
    if min(height, width) >= SMALLEST_SIDE:
        for start in range(0, points.shape[1], BLOCK):
            n = min(BLOCK, points.shape[1] - start)
            warp(points, start, n, K, T, width, height, scratch)
            _weigh(level_map, values, weights, start, n, K, h, c, per_channel, scratch, statistics)
            accumulate_pose(scratch, n, H, g)
    total = statistics[WEIGHT]
    if total == 0.0:
        statistics[ENERGY] = np.inf
        return
    statistics[ENERGY] /= total
    statistics[SQUARES] /= total
    divide_and_mirror(H, g, total)


@njit(cache=True)
def workspace_for(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arrays for :func:`linearize_features` to work in, in the precision of the points."""
    dtype = points.dtype
    return np.empty((SHARED_ROWS, BLOCK), dtype), np.empty(4, dtype), np.empty((4, 4), dtype)
