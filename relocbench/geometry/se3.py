"""Rigid transforms SE(3) and rotations SO(3) as plain float64 arrays.

A transform is a 4x4 matrix whose name says both frames: ``T_dst_src`` maps points from ``src`` to ``dst``.
All functions are vectorised over leading dimensions. Twists are ``xi = (rho, phi)``: translation part first,
rotation vector second, ``exp(xi) = [[exp(phi^), V(phi) rho], [0, 1]]`` (Barfoot, State Estimation for Robotics,
chapter 7; Eade, Lie Groups for 2D and 3D Transformations). Quaternions are ``(qx, qy, qz, qw)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Times


def _series(theta2: Array, coefficients: tuple[float, ...]) -> Array:
    """Evaluate a power series in theta^2 (Horner)."""
    result = np.zeros_like(theta2)
    for c in reversed(coefficients):
        result = result * theta2 + c
    return result


def _sinc_terms(theta2: Array) -> tuple[Array, Array, Array]:
    """sin(t)/t, (1-cos t)/t^2 and (t-sin t)/t^3, by power series at small angles, where the quotients lose digits."""
    small = theta2 < 0.0625
    safe2 = np.where(small, 1.0, theta2)
    theta = np.sqrt(safe2)
    a = np.where(small, _series(theta2, (1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880)), np.sin(theta) / theta)
    half = np.sin(theta / 2) / theta
    b = np.where(small, _series(theta2, (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800)), 2 * half * half)
    c = np.where(
        small,
        _series(theta2, (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800)),
        (theta - np.sin(theta)) / (theta * safe2),
    )
    return a, b, c


def hat(phi: ArrayLike) -> Array:
    """Skew-symmetric matrix: ``hat(a) @ b == cross(a, b)``. (..., 3) -> (..., 3, 3)."""
    p = np.asarray(phi, dtype=np.float64)
    out = np.zeros((*p.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -p[..., 2], p[..., 1], -p[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = p[..., 2], -p[..., 1], p[..., 0]
    return out


def so3_exp(phi: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector (Rodrigues). (..., 3) rad -> (..., 3, 3)."""
    p = np.asarray(phi, dtype=np.float64)
    a, b, _ = _sinc_terms(np.sum(p * p, axis=-1))
    w = hat(p)
    return np.eye(3) + a[..., None, None] * w + b[..., None, None] * (w @ w)


def so3_log(rotation: ArrayLike) -> Array:
    """Rotation vector of a rotation matrix, angle in [0, pi]. (..., 3, 3) -> (..., 3) rad.

    Computed from the quaternion, ``phi = 2 atan2(|v|, w) v/|v|`` with w >= 0, which is accurate both close to the
    identity and close to half a turn.
    """
    q = quaternion_from_rotation(rotation)
    v, w = q[..., :3], q[..., 3]
    n = np.linalg.norm(v, axis=-1)
    tiny = n < 1e-150
    safe = np.where(tiny, 1.0, n)
    scale = np.where(tiny, 2.0, 2.0 * np.arctan2(n, w) / safe)
    return scale[..., None] * v


def rotation_angle(rotation: ArrayLike) -> Array:
    """Angle of a rotation in rad, in [0, pi], accurate at 1e-9 and at pi. (..., 3, 3) -> (...).

    Computed as ``2 atan2(|v|, |w|)`` of the unit quaternion; ``arccos`` of the trace would lose half of the digits.
    """
    q = quaternion_from_rotation(rotation)
    out: Array = 2.0 * np.arctan2(np.linalg.norm(q[..., :3], axis=-1), np.abs(q[..., 3]))
    return out


def quaternion_from_rotation(rotation: ArrayLike) -> Array:
    """Unit quaternion (qx, qy, qz, qw) with qw >= 0 of a rotation matrix. (..., 3, 3) -> (..., 4).

    Shepperd's method: of the four candidate quaternions, take the one built around the largest component.
    """
    m = np.asarray(rotation, dtype=np.float64)
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    trace = m00 + m11 + m22
    yz, zx, xy = m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]
    zy, xz, yx = m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]
    candidates = np.stack(
        [
            np.stack([1 + 2 * m00 - trace, xy + yx, zx + xz, yz - zy], axis=-1),
            np.stack([xy + yx, 1 + 2 * m11 - trace, yz + zy, zx - xz], axis=-1),
            np.stack([zx + xz, yz + zy, 1 + 2 * m22 - trace, xy - yx], axis=-1),
            np.stack([yz - zy, zx - xz, xy - yx, 1 + trace], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.stack([m00, m11, m22, trace], axis=-1), axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    out: Array = np.where(q[..., 3:] < 0, -q, q)
    return out


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotation matrix of a quaternion (qx, qy, qz, qw), normalised first. (..., 4) -> (..., 3, 3)."""
    q = np.asarray(quaternion, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w = hat(q[..., :3])
    out: Array = np.eye(3) + 2.0 * (q[..., 3, None, None] * w + w @ w)
    return out


def make_transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """4x4 transform(s) from rotation (..., 3, 3) and translation (..., 3) in metres."""
    r = np.asarray(rotation, dtype=np.float64)
    t = np.asarray(translation, dtype=np.float64)
    out = np.zeros((*np.broadcast_shapes(r.shape[:-2], t.shape[:-1]), 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = r, t, 1.0
    return out


def transform_from_tq(translation: ArrayLike, quaternion: ArrayLike) -> Array:
    """4x4 transform(s) from translation (tx, ty, tz) and quaternion (qx, qy, qz, qw)."""
    return make_transform(rotation_from_quaternion(quaternion), translation)


def transform_to_tq(transform: ArrayLike) -> tuple[Array, Array]:
    """Translation (..., 3) and quaternion (qx, qy, qz, qw) (..., 4) of 4x4 transform(s)."""
    m = np.asarray(transform, dtype=np.float64)
    return m[..., :3, 3].copy(), quaternion_from_rotation(m[..., :3, :3])


def se3_exp(xi: ArrayLike) -> Array:
    """Transform of a twist (rho, phi). (..., 6) -> (..., 4, 4)."""
    x = np.asarray(xi, dtype=np.float64)
    rho, phi = x[..., :3], x[..., 3:]
    _, b, c = _sinc_terms(np.sum(phi * phi, axis=-1))
    w = hat(phi)
    v = np.eye(3) + b[..., None, None] * w + c[..., None, None] * (w @ w)
    return make_transform(so3_exp(phi), (v @ rho[..., None])[..., 0])


def adjoint(transform: ArrayLike) -> Array:
    """Adjoint: ``T @ se3_exp(xi) = se3_exp(adjoint(T) @ xi) @ T``, ``xi = (rho, phi)``. (..., 4, 4) -> (..., 6, 6).

    Barfoot, State Estimation for Robotics, section 7.1.4.
    """
    m = np.asarray(transform, dtype=np.float64)
    rotation = m[..., :3, :3]
    out = np.zeros((*m.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = rotation
    out[..., :3, 3:] = hat(m[..., :3, 3]) @ rotation
    return out


def se3_log(transform: ArrayLike) -> Array:
    """Twist (rho, phi) of a transform, |phi| <= pi. (..., 4, 4) -> (..., 6).

    ``V^-1 = I - phi^/2 + e phi^ phi^`` with ``e = (1 - (t/2) cot(t/2)) / t^2``.
    """
    m = np.asarray(transform, dtype=np.float64)
    phi = so3_log(m[..., :3, :3])
    theta2 = np.sum(phi * phi, axis=-1)
    small = theta2 < 0.0625
    safe2 = np.where(small, 1.0, theta2)
    half = np.sqrt(safe2) / 2
    e = np.where(
        small,
        _series(theta2, (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160)),
        (1.0 - half * np.cos(half) / np.sin(half)) / safe2,
    )
    w = hat(phi)
    v_inv = np.eye(3) - 0.5 * w + e[..., None, None] * (w @ w)
    rho = (v_inv @ m[..., :3, 3, None])[..., 0]
    return np.concatenate([rho, phi], axis=-1)


def invert(transform: ArrayLike) -> Array:
    """Inverse of rigid transform(s): ``T_src_dst`` of ``T_dst_src``. (..., 4, 4)."""
    m = np.asarray(transform, dtype=np.float64)
    rt = np.swapaxes(m[..., :3, :3], -1, -2)
    return make_transform(rt, -(rt @ m[..., :3, 3, None])[..., 0])


def compose(*transforms: ArrayLike) -> Array:
    """Product of transforms, left to right: ``compose(T_c_b, T_b_a) == T_c_a``.

    The rotation is projected back onto SO(3), so that long chains do not drift off it.
    """
    if not transforms:
        return np.eye(4)
    out = np.asarray(transforms[0], dtype=np.float64)
    for m in transforms[1:]:
        out = out @ np.asarray(m, dtype=np.float64)
    return make_transform(rotation_from_quaternion(quaternion_from_rotation(out[..., :3, :3])), out[..., :3, 3])


def apply(transform: ArrayLike, points: ArrayLike) -> Array:
    """Map points (..., N, 3) in ``src`` by ``T_dst_src`` (..., 4, 4) to ``dst``."""
    m = np.asarray(transform, dtype=np.float64)
    p = np.asarray(points, dtype=np.float64)
    return p @ np.swapaxes(m[..., :3, :3], -1, -2) + m[..., None, :3, 3]


def interpolate(transform_0: ArrayLike, transform_1: ArrayLike, fraction: ArrayLike) -> Array:
    """Pose between two poses: translation linear, rotation by slerp. fraction (...) in [0, 1] -> (..., 4, 4).

    Both poses are ``T_world_body``; slerp follows the shorter arc (Shoemake 1985), as ``R0 exp(f log(R0^T R1))``.
    """
    t0 = np.asarray(transform_0, dtype=np.float64)
    t1 = np.asarray(transform_1, dtype=np.float64)
    f = np.asarray(fraction, dtype=np.float64)[..., None]
    r0 = t0[..., :3, :3]
    delta = so3_log(np.swapaxes(r0, -1, -2) @ t1[..., :3, :3])
    translation = (1.0 - f) * t0[..., :3, 3] + f * t1[..., :3, 3]
    return make_transform(r0 @ so3_exp(f * delta), translation)


def interpolate_trajectory(timestamps_ns: ArrayLike, transforms: ArrayLike, query_ns: ArrayLike) -> Array:
    """Poses of a trajectory at other times.

    Args:
        timestamps_ns: (N,) strictly increasing integer nanoseconds.
        transforms: (N, 4, 4) ``T_world_body``.
        query_ns: (M,) integer nanoseconds within the trajectory's span.

    Returns:
        (M, 4, 4) ``T_world_body``.

    Raises:
        ValueError: the times are not integers or do not increase, there are not as many poses as times, or a query
            lies outside the span (poses are never extrapolated).
    """
    times = _integer_times(timestamps_ns)
    poses = np.asarray(transforms, dtype=np.float64)
    query = _integer_times(query_ns)
    if times.size == 0 or np.any(np.diff(times) <= 0):
        raise ValueError("trajectory timestamps must be strictly increasing and not empty")
    if poses.shape != (times.size, 4, 4):
        raise ValueError(f"{times.size} times need poses ({times.size}, 4, 4), got {poses.shape}")
    outside = (query < times[0]) | (query > times[-1])
    if np.any(outside):
        raise ValueError(f"time {int(query[outside][0])} ns is outside {int(times[0])}..{int(times[-1])} ns")
    if times.size == 1:
        return np.repeat(poses, query.size, axis=0)
    right = np.clip(np.searchsorted(times, query, side="right"), 1, times.size - 1)
    left = right - 1
    # Differences are taken as integers: float64 cannot hold a present-day nanosecond count.
    fraction = (query - times[left]) / (times[right] - times[left])
    return interpolate(poses[left], poses[right], fraction)


def _integer_times(times_ns: ArrayLike) -> Times:
    """Times as (N,) int64. Float seconds are refused: they would silently lose digits."""
    times = np.atleast_1d(np.asarray(times_ns))
    if times.size and times.dtype.kind not in "iu":
        raise ValueError(f"times must be integer nanoseconds, got {times.dtype}")
    return times.astype(np.int64)


def is_rotation(rotation: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Whether (3, 3) is a proper rotation within the tolerance."""
    m = np.asarray(rotation, dtype=np.float64)
    return bool(np.all(np.isfinite(m)) and np.abs(m @ m.T - np.eye(3)).max() <= tolerance and np.linalg.det(m) > 0)


def project_to_rotation(matrix: ArrayLike) -> Array:
    """Nearest rotation (Frobenius) to (..., 3, 3), by SVD; for matrices printed with few digits."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    d = np.ones((*u.shape[:-2], 3))
    d[..., 2] = np.sign(np.linalg.det(u @ vt))
    out: Array = (u * d[..., None, :]) @ vt
    return out
