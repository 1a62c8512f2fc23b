"""Compiled kernels: a uniform cubic B-spline, and the first point at which rays meet a surface whose inverse depth it
is.

A ray's point X is behind the surface where ``w(x / z, y / z) z > 1``, with the spline w and X = (x, y, z).
"""

from __future__ import annotations

import math

import numpy as np

from relocbench.arrays import Array
from relocbench.kernels import njit

_MOST_NARROWINGS = 30
_NARROW = 1e-12
"""relative width of an interval of inverse depth that needs no narrowing, and of w z - 1 that is none"""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _weights(t: float) -> tuple[float, float, float, float]:
    """Weights of the four numbers around a place, a share t behind the second."""
    return (1 - t) ** 3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6, t**3 / 6


@njit(cache=True, nogil=True, error_model="numpy")
def _value(numbers: Array, x0: float, y0: float, spacing: float, x: float, y: float) -> float:
    rows, columns = numbers.shape
    u = min(max((x - x0) / spacing, -1e6), 1e6)
    v = min(max((y - y0) / spacing, -1e6), 1e6)
    i, j = math.floor(v), math.floor(u)
    down, across = _weights(v - i), _weights(u - j)
    total = 0.0
    for k in range(4):
        row = min(max(i - 1 + k, 0), rows - 1)
        along = 0.0
        for m in range(4):
            along += across[m] * numbers[row, min(max(j - 1 + m, 0), columns - 1)]
        total += down[k] * along
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def spline(numbers: Array, x0: float, y0: float, spacing: float, rays: Array) -> Array:
    """The spline (N,) at the rays (N, 3), whose z is 1."""
    found = np.empty(len(rays))
    for n in range(len(rays)):
        found[n] = _value(numbers, x0, y0, spacing, rays[n, 0], rays[n, 1])
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _behind(numbers: Array, x0: float, y0: float, spacing: float, centre: Array, ray: Array, nearness: float) -> float:
    """Positive where the ray's point of this nearness (1 / depth in its own camera) is behind the surface."""
    z = centre[2] + ray[2] / nearness
    if z <= 1e-6:
        return -1.0
    x, y = (centre[0] + ray[0] / nearness) / z, (centre[1] + ray[1] / nearness) / z
    behind: float = _value(numbers, x0, y0, spacing, x, y) * z - 1.0
    return behind


@njit(cache=True, nogil=True, error_model="numpy")
def _narrowed(
    numbers: Array, x0: float, y0: float, spacing: float, centre: Array, ray: Array, front: float, back: float
) -> float:
    """The inverse depth between one in front of the surface and one behind it, by the Illinois method."""
    at_front = _behind(numbers, x0, y0, spacing, centre, ray, front)
    at_back = _behind(numbers, x0, y0, spacing, centre, ray, back)
    middle, side = front, 0
    for _ in range(_MOST_NARROWINGS):
        middle = (front * at_back - back * at_front) / (at_back - at_front)
        value = _behind(numbers, x0, y0, spacing, centre, ray, middle)
        if abs(value) < _NARROW or abs(front - back) < _NARROW * back:
            break
        if value > 0:
            back, at_back = middle, value
            at_front = 0.5 * at_front if side > 0 else at_front
            side = 1
        else:
            front, at_front = middle, value
            at_back = 0.5 * at_back if side < 0 else at_back
            side = -1
    return middle


@njit(cache=True, nogil=True, error_model="numpy")
def first_meeting(
    numbers: Array,
    x0: float,
    y0: float,
    spacing: float,
    centre: Array,
    rays: Array,
    near: float,
    far: float,
    steps: int,
) -> Array:
    """Inverse depth (N,) of the first point of each ray on the surface, in the rays' camera; NaN where there is none.

    Equal steps of inverse depth are about equal steps in the photograph.

    Args:
        centre: (3,) of the rays' camera, in front of the surface.
        rays: (N, 3), with z = 1 in that camera.
        near, far: greatest and least inverse depth at which points are looked for.
    """
    found = np.full(len(rays), np.nan)
    for n in range(len(rays)):
        before = near
        if _behind(numbers, x0, y0, spacing, centre, rays[n], near) > 0:
            continue
        for step in range(1, steps + 1):
            now = near + (far - near) * step / steps
            if _behind(numbers, x0, y0, spacing, centre, rays[n], now) > 0:
                found[n] = _narrowed(numbers, x0, y0, spacing, centre, rays[n], before, now)
                break
            before = now
    return found
