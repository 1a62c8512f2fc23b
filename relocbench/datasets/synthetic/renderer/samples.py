"""Image samples and their rays, direct and reflected.

A sample is a point (u, v) of the image. Its direction d = R_world_cam ((u - cx)/fx, (v - cy)/fy, 1) has length 1 along
the optical axis, so that the ray's parameter is the depth. A lens that bends lines multiplies (u - cx)/fx = x and
(v - cy)/fy = y by 1 + bend (x^2 + y^2). A reflected sample starts where the direct one ended and continues along
d - 2 (d.m) m; its footprint grows with the sum of both depths, as if seen by the mirrored camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.renderer.vectors import Vector, add_scaled, dot
from relocbench.datasets.synthetic.town.raycast import NOTHING
from relocbench.kernels import njit

PIXEL_OFFSETS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]], dtype=np.float32)
"""(4, 2) offsets of the samples in a supersampled pixel: a rotated square, so that edges near the axes cross it at four
places"""


class View(NamedTuple):
    """A pinhole camera with its pose."""

    origin: Array
    rotation: Array
    """(3, 3) R_world_cam"""
    fx: float
    fy: float
    cx: float
    cy: float
    bend: float = 0.0
    """of the lens, 0 for none; see :class:`relocbench.datasets.synthetic.camera.rectified.RadialLens`"""


class Samples(NamedTuple):
    """N points of the image and the triangles that their rays hit; ``before`` and ``mirror`` are 0 for direct rays."""

    u: Floats
    v: Floats
    before: Floats
    """(N,) depth at which the ray was reflected"""
    mirror: Floats
    """(N, 3) normal of the mirror"""
    triangle: NDArray[np.uint32]


def direct_samples(u: Floats, v: Floats) -> Samples:
    """Samples at points of the image, not traced yet."""
    n = len(u)
    return Samples(u, v, np.zeros(n, np.float32), np.zeros((n, 3), np.float32), np.full(n, NOTHING, np.uint32))


@njit(cache=True, nogil=True, error_model="numpy")
def _bent_ray(view: View, x: float, y: float) -> tuple[Vector, Vector, Vector]:
    """As :func:`ray`, through a lens that bends lines, at a point (x, y) from the centre in focal lengths."""
    r, k = view.rotation, 1.0 + view.bend * (x * x + y * y)
    xx, xy, yy = k + 2 * view.bend * x * x, 2 * view.bend * x * y, k + 2 * view.bend * y * y
    x, y = k * x, k * y
    ix, iy = 1.0 / view.fx, 1.0 / view.fy
    d = (r[0, 0] * x + r[0, 1] * y + r[0, 2], r[1, 0] * x + r[1, 1] * y + r[1, 2], r[2, 0] * x + r[2, 1] * y + r[2, 2])
    dx = (
        (r[0, 0] * xx + r[0, 1] * xy) * ix,
        (r[1, 0] * xx + r[1, 1] * xy) * ix,
        (r[2, 0] * xx + r[2, 1] * xy) * ix,
    )
    dy = (
        (r[0, 0] * xy + r[0, 1] * yy) * iy,
        (r[1, 0] * xy + r[1, 1] * yy) * iy,
        (r[2, 0] * xy + r[2, 1] * yy) * iy,
    )
    return d, dx, dy


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def ray(view: View, u: float, v: float) -> tuple[Vector, Vector, Vector]:
    """Direction of the ray through a point of the image, and its derivatives by u and v."""
    r, ix, iy = view.rotation, 1.0 / view.fx, 1.0 / view.fy
    x, y = (u - view.cx) * ix, (v - view.cy) * iy
    if view.bend != 0.0:
        return _bent_ray(view, x, y)
    d = (r[0, 0] * x + r[0, 1] * y + r[0, 2], r[1, 0] * x + r[1, 1] * y + r[1, 2], r[2, 0] * x + r[2, 1] * y + r[2, 2])
    dx = (r[0, 0] * ix, r[1, 0] * ix, r[2, 0] * ix)
    dy = (r[0, 1] * iy, r[1, 1] * iy, r[2, 1] * iy)
    return d, dx, dy


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def start(view: View, samples: Samples, i: int) -> tuple[Vector, Vector, Vector, Vector]:
    """Origin, direction and its derivatives of a sample's ray, direct or reflected."""
    d, dx, dy = ray(view, samples.u[i], samples.v[i])
    origin = (view.origin[0], view.origin[1], view.origin[2])
    if samples.before[i] > 0:
        m = (samples.mirror[i, 0], samples.mirror[i, 1], samples.mirror[i, 2])
        origin = add_scaled(origin, samples.before[i], d)
        d = add_scaled(d, -2 * dot(d, m), m)
        dx = add_scaled(dx, -2 * dot(dx, m), m)
        dy = add_scaled(dy, -2 * dot(dy, m), m)
    return origin, d, dx, dy


@njit(cache=True, nogil=True, error_model="numpy")
def make_rays(view: View, samples: Samples) -> Floats:
    """Rays (N, 6), origins and directions; reflected ones start 2 mm off the mirror."""
    n = len(samples.u)
    rays = np.empty((n, 6), dtype=np.float32)
    r, origin = view.rotation, view.origin
    for i in range(n):
        if samples.before[i] <= 0:
            x, y = (samples.u[i] - view.cx) / view.fx, (samples.v[i] - view.cy) / view.fy
            if view.bend != 0.0:
                k = 1.0 + view.bend * (x * x + y * y)
                x, y = k * x, k * y
            for k in range(3):
                rays[i, k] = origin[k]
                rays[i, 3 + k] = r[k, 0] * x + r[k, 1] * y + r[k, 2]
            continue
        o, d, _, _ = start(view, samples, i)
        o = add_scaled(o, 0.002, (samples.mirror[i, 0], samples.mirror[i, 1], samples.mirror[i, 2]))
        for k in range(3):
            rays[i, k] = o[k]
            rays[i, 3 + k] = d[k]
    return rays
