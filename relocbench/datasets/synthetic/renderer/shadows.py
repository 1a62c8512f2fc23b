"""Shadow rays to the light, which is the sun or, at night, the strongest lamp."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats, Indices, Mask
from relocbench.datasets.synthetic.renderer.lamps import Lamps, strongest_lamp
from relocbench.datasets.synthetic.renderer.samples import PIXEL_OFFSETS, View, ray
from relocbench.datasets.synthetic.renderer.surfaces import Hits
from relocbench.datasets.synthetic.renderer.vectors import add_scaled, cross, dot
from relocbench.kernels import njit


@njit(cache=True, nogil=True, error_model="numpy")
def shadow_rays(hits: Hits, asked: Mask, to_sun: Floats, by_lamp: bool, lamps: Lamps) -> tuple[Indices, Floats]:
    """The samples among those asked for (N,) that face the light, and a ray (M, 6) from each to it.

    The light is the sun or, at night, the strongest lamp. A ray to a lamp reaches it at parameter 1.
    """
    n = len(hits.depth)
    index = np.empty(n, dtype=np.int64)
    rays = np.empty((n, 6), dtype=np.float32)
    m = 0
    for i in range(n):
        if not asked[i] or hits.depth[i] <= 0.0:
            continue
        x, y, z = hits.position[i, 0], hits.position[i, 1], hits.position[i, 2]
        nx, ny, nz = hits.normal[i, 0], hits.normal[i, 1], hits.normal[i, 2]
        lx, ly, lz = to_sun[0], to_sun[1], to_sun[2]
        if by_lamp:
            best, most, _ = strongest_lamp(lamps, x, y, z, nx, ny, nz)
            if best < 0 or most < 0.002:
                continue
            lx, ly, lz = lamps.heads[best, 0] - x, lamps.heads[best, 1] - y, lamps.heads[best, 2] - z
        elif lx * nx + ly * ny + lz * nz <= 0.0:
            continue
        off = 0.003 + 2e-5 * hits.depth[i]
        index[m] = i
        rays[m, 0], rays[m, 1], rays[m, 2] = x + off * nx, y + off * ny, z + off * nz
        rays[m, 3], rays[m, 4], rays[m, 5] = lx, ly, lz
        m += 1
    return index[:m].copy(), rays[:m].copy()


@njit(cache=True, nogil=True, error_model="numpy")
def chessboard(count: int, width: int) -> Mask:
    """Mask (count,) of the dark squares of a chessboard over an image ``width`` pixels wide."""
    out = np.zeros(count, dtype=np.bool_)
    for row in range(count // width):
        out[row * width + row % 2 : (row + 1) * width : 2] = True
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def interpolate_chessboard(hits: Hits, lit: Floats, width: int) -> Mask:
    """Set the light squares of the chessboard from their neighbours where possible; returns the others (N,).

    A pixel takes the value that its four neighbours have in common, if all five lie nearly in one plane.
    """
    n = len(lit)
    depth, normal, position = hits.depth, hits.normal, hits.position
    left = np.zeros(n, dtype=np.bool_)
    for row in range(n // width):
        for column in range(1 - row % 2, width, 2):
            i = row * width + column
            if depth[i] <= 0.0:
                continue
            if column == 0 or column == width - 1 or i < width or i >= n - width:
                left[i] = True
                continue
            nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
            most = np.float32(0.01 + 0.002 * depth[i])
            value = lit[i - 1]
            alike = True
            for step in (-1, 1, -width, width):
                j = i + step
                off = (
                    nx * (position[j, 0] - position[i, 0])
                    + ny * (position[j, 1] - position[i, 1])
                    + nz * (position[j, 2] - position[i, 2])
                )
                cosine = nx * normal[j, 0] + ny * normal[j, 1] + nz * normal[j, 2]
                if lit[j] != value or abs(off) > most or cosine < 0.95 or depth[j] <= 0.0:
                    alike = False
                    break
            if alike:
                lit[i] = value
            else:
                left[i] = True
    return left


_SUN_RADIUS = 0.008
"""radians; slightly more than the disc, to include the glow around it"""


@njit(cache=True, nogil=True, error_model="numpy")
def penumbra_rays(view: View, hits: Hits, lit: Floats, width: int, to_sun: Floats) -> tuple[Indices, Floats]:
    """Pixels at the edges of shadows (M,), and four rays (4 M, 6) from each, spread over the pixel and the sun's disc.

    ``hits`` and ``lit`` are those of the whole image. The rays of a pixel do not depend on what else is rendered.
    """
    n = len(lit)
    found = np.empty(n, dtype=np.int64)
    m = 0
    column = -1
    for i in range(n):
        column = column + 1 if column < width - 1 else 0
        turned = False
        for step in (1, width, -1, -width):
            j = i + step
            if j < 0 or j >= n or lit[i] == lit[j] or hits.depth[i] <= 0.0 or hits.depth[j] <= 0.0:
                continue
            if (step == 1 and column == width - 1) or (step == -1 and column == 0):
                continue
            alike = 0.0
            facing = 0.0
            for k in range(3):
                alike += hits.normal[i, k] * hits.normal[j, k]
                facing += hits.normal[i, k] * to_sun[k]
            near = abs(hits.depth[i] - hits.depth[j]) < 0.25 * hits.depth[i]
            turned |= alike > 0.95 and near and facing > 0.0
        if turned:
            found[m] = i
            m += 1
    rays = np.empty((4 * m, 6), dtype=np.float32)
    s = (to_sun[0], to_sun[1], to_sun[2])
    across = cross(s, (0.0, 0.0, 1.0)) if abs(s[2]) < 0.9 else cross(s, (1.0, 0.0, 0.0))
    size = 1.0 / np.sqrt(dot(across, across))
    across = (across[0] * size, across[1] * size, across[2] * size)
    upward = cross(across, s)
    for q in range(m):
        i = found[q]
        d, dx, dy = ray(view, i % width, i // width)
        c = (float(hits.normal[i, 0]), float(hits.normal[i, 1]), float(hits.normal[i, 2]))
        slope, t = dot(c, d), hits.depth[i]
        px = add_scaled((t * dx[0], t * dx[1], t * dx[2]), -t * dot(c, dx) / slope, d)
        py = add_scaled((t * dy[0], t * dy[1], t * dy[2]), -t * dot(c, dy) / slope, d)
        off = 0.003 + 2e-5 * t
        for k in range(4):
            a, b = PIXEL_OFFSETS[k, 0], PIXEL_OFFSETS[k, 1]
            p = add_scaled(add_scaled((view.origin[0], view.origin[1], view.origin[2]), t, d), off, c)
            p = add_scaled(add_scaled(p, a, px), b, py)
            # Samples on the disc are turned against those in the pixel, or edges along one diagonal would stay hard.
            to_light = add_scaled(add_scaled(s, 2 * _SUN_RADIUS * b, across), 2 * _SUN_RADIUS * a, upward)
            for e in range(3):
                rays[4 * q + k, e] = p[e]
                rays[4 * q + k, 3 + e] = to_light[e]
    return found[:m].copy(), rays
