"""Three-dimensional vectors as tuples, and smooth functions, for compiled code."""

from __future__ import annotations

from relocbench.kernels import njit

Vector = tuple[float, float, float]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def add_scaled(a: Vector, t: float, b: Vector) -> Vector:
    """a + t b."""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def smoothstep(x: float, low: float, high: float) -> float:
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def exp_negative(x: float) -> float:
    """exp(-x) for x >= 0 within 5e-5: Taylor's cubic for x / 16, squared four times."""
    h = min(x * (1 / 16), 1.5)
    f = 1 - h * (1 - h * (0.5 - h * (1 / 6)))
    f *= f
    f *= f
    f *= f
    return f * f
