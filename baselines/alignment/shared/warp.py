"""The projection of reference points into the query, compiled.

For each point, with normalised coordinates (x, y) in the reference and inverse depth id, for a pinhole camera (Engel,
Koltun and Cremers, Direct Sparse Odometry, PAMI 2018):

    x' = R [x y 1]^T + t id,   (u, v) = (x'_x, x'_y) / x'_z,   id' = id / x'_z,   p' = (fx u + cx, fy v + cy)
"""

from __future__ import annotations

from baselines.alignment.shared.compiled import FAST, FloatArray
from baselines.alignment.shared.scratch import ID, PX, PY, VALID, U, V
from relocbench.kernels import njit

BORDER = 2
"""pixels; points within this distance of the query's border are dropped"""
SMALLEST_SIDE = 2 * BORDER + 2
"""pixels; on a map with a shorter side no point is valid"""


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
    """Write rows u, v, id', p'_x, p'_y and valid (1 or 0) for points start .. start + n.

    A dropped point gets zeros and a pixel inside the map, so that what is read there does not change any sum.
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
