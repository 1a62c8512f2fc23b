"""Surfaces under sun, sky and lamps: what each ray meets, and the light that comes back along it.

A sample is a point (u, v) of the image. Its direction d = R_world_cam ((u - cx)/fx, (v - cy)/fy, 1) keeps length 1
along the optical axis, so that the ray's parameter is the depth. A mirrored sample starts where the direct one ended
and goes on along d - 2 (d.m) m; its footprint grows with the sum of both depths, as if seen by the mirrored camera.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from relocbench.datasets.synthetic.materials import CHOICES, Looks, scramble
from relocbench.datasets.synthetic.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.raycast import NOTHING
from relocbench.datasets.synthetic.sky import MAP, Sky
from relocbench.datasets.synthetic.skylight import Skylight, sky_share
from relocbench.datasets.synthetic.textures import MACRO, Patterns, sample

Floats = NDArray[np.float32]

_MARKING, _WINDOW, _SHOP = int(Material.LANE_MARKING), int(Material.WINDOW), int(Material.SHOP_WINDOW)
_LEAF, _HEDGE, _LAMP = int(Material.LEAF), int(Material.HEDGE), int(Material.LAMP)
_PAINT, _CAR_GLASS, _SIGN = int(Material.CAR_PAINT), int(Material.CAR_GLASS), int(Material.SHOP_SIGN)
_MOVING, _PARKED = int(Semantic.MOVING_CAR), int(Semantic.PARKED_CAR)
_LAMP_CELL_M = 8.0
_LAMP_REACH_M = 26.0
_LAMPS_A_CELL = 6
_LAMP_POWER = 1.6
_BEAM_POWER = 1.6
_BRIGHTEST = 10.0
_HAZE = 0.00025
"""extinction of clear air, 1/m"""
_FOG_LAYER_M = 160.0


class Geometry(NamedTuple):
    """The mesh's arrays."""

    vertices: Floats
    triangles: NDArray[np.uint32]
    uv: Floats
    material: NDArray[np.uint8]
    semantic: NDArray[np.uint8]
    instance: NDArray[np.uint32]
    variant: NDArray[np.uint32]


class View(NamedTuple):
    """A pinhole camera in the world."""

    origin: NDArray[np.float64]
    rotation: NDArray[np.float64]
    """(3, 3) R_world_cam"""
    fx: float
    fy: float
    cx: float
    cy: float


class Setting(NamedTuple):
    """What the weather and the hour do to surfaces and light."""

    wetness: float
    puddles: float
    snow: float
    extinction: float
    lamps_on: bool
    headlights: bool
    night: float
    """0 by day, 1 at night: windows are lit"""
    seed: int


class Lamps(NamedTuple):
    """Street lamps by place."""

    heads: Floats
    """(L, 3)"""
    low: Floats
    """(2,) corner of the first cell"""
    near: NDArray[np.int32]
    """(rows, columns, 6) nearest lamps of a cell, -1 for none"""


class Beam(NamedTuple):
    """Headlights of the car that carries the camera."""

    origin: Floats
    forward: Floats


class Samples(NamedTuple):
    """Points of the image and what their rays hit; ``before`` and ``mirror`` are 0 for direct ones."""

    u: Floats
    v: Floats
    before: Floats
    """(N,) depth at which the ray was mirrored"""
    mirror: Floats
    """(N, 3) normal of the mirror"""
    triangle: NDArray[np.uint32]


class Hits(NamedTuple):
    """What the samples see, before light."""

    depth: NDArray[np.float64]
    """(N,) along the ray from where it started; 0 for the sky"""
    position: Floats
    normal: Floats
    """(N, 3) of the surface, on the side that is seen"""
    albedo: Floats
    emission: Floats
    mirror: Floats
    """(N,) share of the light that comes by reflection"""
    sharpness: Floats
    """(N,) of that reflection, 1 for glass and still water"""


def make_geometry(mesh: Mesh) -> Geometry:
    """The mesh as compiled code takes it."""
    return Geometry(*(np.ascontiguousarray(getattr(mesh, name)) for name in Geometry._fields))


def make_lamps(heads: NDArray[np.floating]) -> Lamps:
    """Which lamps reach which cell of the town."""
    heads = np.ascontiguousarray(heads, dtype=np.float32).reshape(-1, 3)
    if len(heads) == 0:
        return Lamps(heads, np.zeros(2, np.float32), np.full((1, 1, _LAMPS_A_CELL), -1, np.int32))
    low = heads[:, :2].min(0) - _LAMP_REACH_M
    columns, rows = (np.ceil((heads[:, :2].max(0) + _LAMP_REACH_M - low) / _LAMP_CELL_M).astype(int) + 1).tolist()
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    centre = np.stack([x, y], axis=-1) * _LAMP_CELL_M + low
    distance = np.linalg.norm(centre[:, :, None] - heads[:, :2], axis=-1)
    order = np.argsort(distance, axis=-1, kind="stable")[..., :_LAMPS_A_CELL]
    near = np.full((rows, columns, _LAMPS_A_CELL), -1, np.int32)
    reached = np.take_along_axis(distance, order, -1) < _LAMP_REACH_M + _LAMP_CELL_M
    near[..., : order.shape[-1]] = np.where(reached, order, -1)
    return Lamps(heads, low.astype(np.float32), near)


def direct_samples(u: Floats, v: Floats) -> Samples:
    """Samples at points of the image, what they hit still open."""
    n = len(u)
    return Samples(u, v, np.zeros(n, np.float32), np.zeros((n, 3), np.float32), np.full(n, NOTHING, np.uint32))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _minus(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _along(a: tuple[float, float, float], t: float, b: tuple[float, float, float]) -> tuple[float, float, float]:
    """a + t b."""
    return a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]


@njit(cache=True, nogil=True, error_model="numpy")
def _ray(
    view: View, u: float, v: float
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """Direction of a point of the image, and its derivatives by u and by v."""
    r = view.rotation
    x, y = (u - view.cx) / view.fx, (v - view.cy) / view.fy
    d = (r[0, 0] * x + r[0, 1] * y + r[0, 2], r[1, 0] * x + r[1, 1] * y + r[1, 2], r[2, 0] * x + r[2, 1] * y + r[2, 2])
    dx = (r[0, 0] / view.fx, r[1, 0] / view.fx, r[2, 0] / view.fx)
    dy = (r[0, 1] / view.fy, r[1, 1] / view.fy, r[2, 1] / view.fy)
    return d, dx, dy


@njit(cache=True, nogil=True, error_model="numpy")
def _start(
    view: View, samples: Samples, i: int
) -> tuple[
    tuple[float, float, float], tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
]:
    """Origin, direction and its derivatives of a sample, direct or mirrored."""
    d, dx, dy = _ray(view, samples.u[i], samples.v[i])
    origin = (view.origin[0], view.origin[1], view.origin[2])
    if samples.before[i] > 0:
        m = (samples.mirror[i, 0], samples.mirror[i, 1], samples.mirror[i, 2])
        origin = _along(origin, samples.before[i], d)
        d = _along(d, -2 * _dot(d, m), m)
        dx = _along(dx, -2 * _dot(dx, m), m)
        dy = _along(dy, -2 * _dot(dy, m), m)
    return origin, d, dx, dy


@njit(cache=True, nogil=True, error_model="numpy")
def make_rays(view: View, samples: Samples) -> Floats:
    """(N, 6) origins and directions; mirrored ones start 2 mm off the mirror."""
    n = len(samples.u)
    rays = np.empty((n, 6), dtype=np.float32)
    for i in range(n):
        o, d, _, _ = _start(view, samples, i)
        if samples.before[i] > 0:
            o = _along(o, 0.002, (samples.mirror[i, 0], samples.mirror[i, 1], samples.mirror[i, 2]))
        for k in range(3):
            rays[i, k] = o[k]
            rays[i, 3 + k] = d[k]
    return rays


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _smooth(x: float, low: float, high: float) -> float:
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _fresnel(cosine: float) -> float:
    """Reflectance of water and glass (Schlick 1994, F0 = 0.03)."""
    k = 1 - min(max(cosine, 0.0), 1.0)
    k2 = k * k
    return 0.03 + 0.97 * k2 * k2 * k


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _corner(vertices: Floats, i: int) -> tuple[float, float, float]:
    return float(vertices[i, 0]), float(vertices[i, 1]), float(vertices[i, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def surfaces(
    view: View, geometry: Geometry, patterns: Patterns, looks: Looks, setting: Setting, samples: Samples
) -> Hits:
    """Depth, normal and colour of what each sample sees.

    The depth is that of the ray and the triangle's plane in double precision, whatever Embree's own rounding.
    """
    n = len(samples.u)
    depth = np.zeros(n, dtype=np.float64)
    position = np.zeros((n, 3), dtype=np.float32)
    normal = np.zeros((n, 3), dtype=np.float32)
    albedo = np.zeros((n, 3), dtype=np.float32)
    emission = np.zeros((n, 3), dtype=np.float32)
    mirror = np.zeros(n, dtype=np.float32)
    sharpness = np.zeros(n, dtype=np.float32)
    for i in range(n):
        triangle = samples.triangle[i]
        if triangle == NOTHING:
            continue
        o, d, dx, dy = _start(view, samples, i)
        a = _corner(geometry.vertices, geometry.triangles[triangle, 0])
        e1 = _minus(_corner(geometry.vertices, geometry.triangles[triangle, 1]), a)
        e2 = _minus(_corner(geometry.vertices, geometry.triangles[triangle, 2]), a)
        c = _cross(e1, e2)
        area2 = _dot(c, c)
        slope = _dot(c, d)
        if area2 == 0.0 or slope == 0.0:
            continue
        t = _dot(c, _minus(a, o)) / slope
        p = _along(o, t, d)
        size = (-1.0 if slope > 0 else 1.0) / np.sqrt(area2)
        nx, ny, nz = c[0] * size, c[1] * size, c[2] * size

        # Barycentric coordinates are linear in the point, and so is (u, v) on the surface with its footprint.
        g1, g2 = _cross(e2, c), _cross(c, e1)
        reach = samples.before[i] + t
        px = _along((reach * dx[0], reach * dx[1], reach * dx[2]), -reach * _dot(c, dx) / slope, d)
        py = _along((reach * dy[0], reach * dy[1], reach * dy[2]), -reach * _dot(c, dy) / slope, d)
        uv = geometry.uv[triangle]
        u1, v1, u2, v2 = uv[1, 0] - uv[0, 0], uv[1, 1] - uv[0, 1], uv[2, 0] - uv[0, 0], uv[2, 1] - uv[0, 1]
        q = _minus(p, a)
        b1, b2 = _dot(g1, q) / area2, _dot(g2, q) / area2
        x1, x2 = _dot(g1, px) / area2, _dot(g2, px) / area2
        y1, y2 = _dot(g1, py) / area2, _dot(g2, py) / area2
        su, sv = uv[0, 0] + b1 * u1 + b2 * u2, uv[0, 1] + b1 * v1 + b2 * v2
        dudx, dvdx, dudy, dvdy = x1 * u1 + x2 * u2, x1 * v1 + x2 * v2, y1 * u1 + y2 * u2, y1 * v1 + y2 * v2

        material, variant = np.int64(geometry.material[triangle]), np.int64(geometry.variant[triangle])
        dice = scramble(variant, material * 7919 + setting.seed)
        shift = 0.0 if material == _MARKING else (dice & 255) / 255.0 * 7.3
        share, bright = sample(patterns, material, su + shift, sv + 0.37 * shift, dudx, dvdx, dudy, dvdy)  # type: ignore[arg-type]
        # Slow stains: along the surface on walls, from above on the ground.
        flat = nz > 0.7
        if flat:
            slow, stain = sample(patterns, MACRO, p[0], p[1], px[0], px[1], py[0], py[1])
        else:
            slow, stain = sample(patterns, MACRO, su + 3 * shift, sv, dudx, dvdx, dudy, dvdy)
        tone = 1.0 + looks.spread[material] * 2 * (((dice >> 8) & 255) / 255.0 - 0.5)
        if material != _PAINT and material != _CAR_GLASS and material != _LAMP:
            tone *= 0.88 + 0.12 * stain
        choice = (dice >> 16) % CHOICES
        r, g, b = looks.first[material, choice, 0], looks.first[material, choice, 1], looks.first[material, choice, 2]
        if material in (_LEAF, _HEDGE):
            kind = scramble(np.int64(geometry.instance[triangle]), setting.seed) & 3
            turned = 1.0 if material == _LEAF else 0.5
            r += (looks.foliage[kind, 0] - r) * turned
            g += (looks.foliage[kind, 1] - g) * turned
            b += (looks.foliage[kind, 2] - b) * turned
            hue = 0.72 + 0.56 * ((dice >> 4) & 255) / 255.0
            r, g, b = r * hue, g * hue, b * hue
        shine = tone * bright
        r = (r + (looks.second[material, 0] - r) * share) * shine
        g = (g + (looks.second[material, 1] - g) * share) * shine
        b = (b + (looks.second[material, 2] - b) * share) * shine

        cosine = -(d[0] * nx + d[1] * ny + d[2] * nz) / np.sqrt(_dot(d, d))
        gloss, sharp = looks.gloss[material] * _fresnel(cosine), 1.0
        if material in (_WINDOW, _SHOP):
            gloss = min(1.0, 1.6 * gloss + 0.07)

        snow = 0.0
        if setting.snow > 0.0 and nz > 0.2 and material != _LAMP:
            line = (1 - setting.snow) * 1.2 - 0.1
            grain = slow if flat else 0.5
            snow = _smooth(grain, line - 0.1, line + 0.1) * _smooth(nz, 0.3, 0.7)
            if snow > 0.0:
                white = 0.80 + 0.05 * (bright - 1.0) + 0.04 * (stain - 1.0)
                r, g, b = r + (white - r) * snow, g + (white * 1.01 - g) * snow, b + (white * 1.04 - b) * snow
                gloss *= 1 - snow

        if setting.wetness > 0.0:
            soaked = setting.wetness * (0.35 + 0.65 * _smooth(nz, -0.2, 0.6)) * (1 - snow)
            film, still = 0.0, 0.0
            if nz > 0.97 and looks.film[material] > 0.0:
                film = looks.film[material] * soaked * (0.65 + 0.35 * _smooth(slow, 0.2, 0.7)) * (0.75 + 0.25 * share)
                if setting.puddles > 0.0 and looks.hollows[material] > 0.0:
                    line = 1.0 - 0.42 * setting.puddles * looks.hollows[material]
                    still = _smooth(slow, line, line + 0.05) * (1 - snow)
                film += (1 - film) * still
                lost = gloss
                gloss = lost + (1 - lost) * film * _fresnel(cosine)
                sharp = 0.25 + 0.75 * still
            keep = 1 - looks.porous[material] * soaked * (1 + 0.4 * still)
            r, g, b = r * keep, g * keep, b * keep

        if material == _LAMP:
            semantic = geometry.semantic[triangle]
            of_car = semantic in (_MOVING, _PARKED)
            if (setting.headlights and semantic == _MOVING) or (setting.lamps_on and not of_car):
                emission[i, 0], emission[i, 1], emission[i, 2] = 6.0, 4.8, 3.2
        if setting.night > 0.0 and (material == _SHOP or (material == _WINDOW and (dice >> 5) % 100 < 24)):
            power = setting.night * (0.5 if material == _SHOP else 0.22) * (0.5 + (dice & 127) / 127.0)
            power *= 0.45 + 0.75 * share
            warm = ((dice >> 12) & 7) / 7.0
            emission[i, 0] = power
            emission[i, 1] = power * (0.62 + 0.25 * warm)
            emission[i, 2] = power * (0.28 + 0.5 * warm)
        elif setting.night > 0.0 and material == _SIGN and (dice >> 5) % 3 == 0:
            emission[i, 0], emission[i, 1], emission[i, 2] = r * setting.night, g * setting.night, b * setting.night

        depth[i] = t
        position[i, 0], position[i, 1], position[i, 2] = p[0], p[1], p[2]
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        albedo[i, 0] = min(max(r, 0.0), 0.95)
        albedo[i, 1] = min(max(g, 0.0), 0.95)
        albedo[i, 2] = min(max(b, 0.0), 0.95)
        mirror[i], sharpness[i] = gloss, sharp
    return Hits(depth, position, normal, albedo, emission, mirror, sharpness)


@njit(cache=True, nogil=True, error_model="numpy")
def _strongest(lamps: Lamps, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> tuple[int, float, float]:
    """The lamp that gives most light at a point, its irradiance, and that of all others."""
    column, row = int((x - lamps.low[0]) / _LAMP_CELL_M), int((y - lamps.low[1]) / _LAMP_CELL_M)
    rows, columns, _ = lamps.near.shape
    best, most, total = -1, 0.0, 0.0
    if x < lamps.low[0] or y < lamps.low[1] or column >= columns or row >= rows:
        return best, most, total
    for k in range(_LAMPS_A_CELL):
        lamp = lamps.near[row, column, k]
        if lamp < 0:
            break
        lx, ly, lz = lamps.heads[lamp, 0] - x, lamps.heads[lamp, 1] - y, lamps.heads[lamp, 2] - z
        square = lx * lx + ly * ly + lz * lz
        distance = np.sqrt(square) + 1e-6
        facing = (lx * nx + ly * ny + lz * nz) / distance
        if facing <= 0.0 or distance > _LAMP_REACH_M:
            continue
        lobe = _smooth(lz / distance, -0.25, 0.5)
        fade = 1 - distance / _LAMP_REACH_M
        power = _LAMP_POWER * 6 * facing * lobe * fade / (square + 4.0)
        total += power
        if power > most:
            best, most = lamp, power
    return best, most, total - most


@njit(cache=True, nogil=True, error_model="numpy")
def shadow_rays(hits: Hits, to_sun: Floats, by_lamp: bool, lamps: Lamps) -> tuple[NDArray[np.int64], Floats]:
    """Which samples face the light, and a ray (M, 6) from each to it: the sun, or at night the strongest lamp.

    A ray to a lamp has the lamp at parameter 1.
    """
    n = len(hits.depth)
    index = np.empty(n, dtype=np.int64)
    rays = np.empty((n, 6), dtype=np.float32)
    m = 0
    for i in range(n):
        if hits.depth[i] <= 0.0:
            continue
        x, y, z = hits.position[i, 0], hits.position[i, 1], hits.position[i, 2]
        nx, ny, nz = hits.normal[i, 0], hits.normal[i, 1], hits.normal[i, 2]
        lx, ly, lz = to_sun[0], to_sun[1], to_sun[2]
        if by_lamp:
            best, most, _ = _strongest(lamps, x, y, z, nx, ny, nz)
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


_SPREAD = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]], dtype=np.float32)
"""of samples in a pixel: a rotated square, so that edges near the axes are met at four places"""
_SUN_RADIUS = 0.008
"""radians; a little more than the disc, for the glow around it"""


@njit(cache=True, nogil=True, error_model="numpy")
def penumbra_rays(view: View, hits: Hits, lit: Floats, width: int, to_sun: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Pixels at the rims of shadows, and four rays (4 M, 6) from each: over the pixel and over the sun's disc.

    ``hits`` and ``lit`` are those of the whole image. The rays of a pixel are the same whatever else is rendered.
    """
    n = len(lit)
    found = np.empty(n, dtype=np.int64)
    m = 0
    for i in range(n):
        if hits.depth[i] <= 0.0:
            continue
        turned = False
        for step in (1, width, -1, -width):
            j = i + step
            if j < 0 or j >= n or hits.depth[j] <= 0.0 or (abs(step) == 1 and j // width != i // width):
                continue
            if lit[i] == lit[j]:
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
    across = _cross(s, (0.0, 0.0, 1.0)) if abs(s[2]) < 0.9 else _cross(s, (1.0, 0.0, 0.0))
    size = 1.0 / np.sqrt(_dot(across, across))
    across = (across[0] * size, across[1] * size, across[2] * size)
    upward = _cross(across, s)
    for q in range(m):
        i = found[q]
        d, dx, dy = _ray(view, i % width, i // width)
        c = (float(hits.normal[i, 0]), float(hits.normal[i, 1]), float(hits.normal[i, 2]))
        slope, t = _dot(c, d), hits.depth[i]
        px = _along((t * dx[0], t * dx[1], t * dx[2]), -t * _dot(c, dx) / slope, d)
        py = _along((t * dy[0], t * dy[1], t * dy[2]), -t * _dot(c, dy) / slope, d)
        off = 0.003 + 2e-5 * t
        for k in range(4):
            a, b = _SPREAD[k, 0], _SPREAD[k, 1]
            p = _along(_along((view.origin[0], view.origin[1], view.origin[2]), t, d), off, c)
            p = _along(_along(p, a, px), b, py)
            # The square is turned against that of the pixel, or rims along one diagonal would stay hard.
            to_light = _along(_along(s, 2 * _SUN_RADIUS * b, across), 2 * _SUN_RADIUS * a, upward)
            for e in range(3):
                rays[4 * q + k, e] = p[e]
                rays[4 * q + k, 3 + e] = to_light[e]
    return found[:m].copy(), rays


@njit(cache=True, nogil=True, error_model="numpy")
def sky_radiance(sky: Sky, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Of a unit direction; below the horizon that of the horizon."""
    z = max(z, 0.0)
    scale = MAP * 0.5 / (1 + z)
    u, v = x * scale + MAP * 0.5 - 0.5, y * scale + MAP * 0.5 - 0.5
    u, v = min(max(u, 0.0), MAP - 1.001), min(max(v, 0.0), MAP - 1.001)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    m = sky.radiance
    w00, w10, w01, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    return (
        w00 * m[j, i, 0] + w10 * m[j, i + 1, 0] + w01 * m[j + 1, i, 0] + w11 * m[j + 1, i + 1, 0],
        w00 * m[j, i, 1] + w10 * m[j, i + 1, 1] + w01 * m[j + 1, i, 1] + w11 * m[j + 1, i + 1, 1],
        w00 * m[j, i, 2] + w10 * m[j, i + 1, 2] + w01 * m[j + 1, i, 2] + w11 * m[j + 1, i + 1, 2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _beam_light(beam: Beam, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Irradiance by the dipped headlights of the own car."""
    dx, dy, dz = x - beam.origin[0], y - beam.origin[1], z - beam.origin[2]
    square = dx * dx + dy * dy + dz * dz
    distance = np.sqrt(square) + 1e-6
    ahead = (dx * beam.forward[0] + dy * beam.forward[1]) / distance
    if ahead <= 0.3:
        return 0.0
    rise = dz / distance
    facing = -(dx * nx + dy * ny + dz * nz) / distance
    lobe = _smooth(ahead, 0.75, 0.99) * (1 - _smooth(rise, -0.01, 0.06) * 0.93)
    return _BEAM_POWER * 60 * max(facing, 0.0) * lobe / (square + 30.0)


@njit(cache=True, nogil=True, error_model="numpy")
def radiance(
    view: View,
    geometry: Geometry,
    setting: Setting,
    sky: Sky,
    skylight: Skylight,
    lamps: Lamps,
    beam: Beam,
    samples: Samples,
    hits: Hits,
    lit: Floats,
    reflected: Floats,
) -> Floats:
    """Light (N, 3) that comes back along the samples.

    Args:
        lit: (N,) share of the sun, or of the strongest lamp, that is not in shadow.
        reflected: (N, 3) light that comes to the surface from where it mirrors; negative where no ray was cast for
            it, and the sky stands in.
    """
    n = len(hits.depth)
    out = np.empty((n, 3), dtype=np.float32)
    by_lamp = sky.sun[0] + sky.sun[1] + sky.sun[2] <= 0.0
    for i in range(n):
        _, d, _, _ = _start(view, samples, i)
        length = np.sqrt(_dot(d, d))
        d = (d[0] / length, d[1] / length, d[2] / length)
        if hits.depth[i] <= 0.0:
            r, g, b = sky_radiance(sky, d[0], d[1], d[2])
            distance = _FOG_LAYER_M / (max(d[2], 0.0) + 0.02)
            veil = np.exp(-setting.extinction * distance)
        else:
            x, y, z = hits.position[i, 0], hits.position[i, 1], hits.position[i, 2]
            nx, ny, nz = hits.normal[i, 0], hits.normal[i, 1], hits.normal[i, 2]
            material = geometry.material[samples.triangle[i]]
            leafy = material == _LEAF
            share, open_sky = sky_share(skylight, x, y, z, nx, ny, nz)
            if leafy:
                share = 0.5 * share + 0.25
            # The ground sends light back up: about a quarter of what falls on it.
            below = 0.5 * (1 - 0.6 * nz) * 0.25
            sun_down = max(sky.to_sun[2], 0.0) * 0.45 * open_sky
            er = sky.ambient[0] * (share + below * open_sky) + below * sun_down * sky.sun[0]
            eg = sky.ambient[1] * (share + below * open_sky) + below * sun_down * sky.sun[1]
            eb = sky.ambient[2] * (share + below * open_sky) + below * sun_down * sky.sun[2]
            if not by_lamp:
                facing = nx * sky.to_sun[0] + ny * sky.to_sun[1] + nz * sky.to_sun[2]
                if leafy:
                    # A leaf lets a third of the light through, and is never quite edge on.
                    facing = 0.25 + 0.75 * abs(facing) if facing > 0 else 0.3 * abs(facing)
                facing = max(facing, 0.0) * lit[i]
                er, eg, eb = er + facing * sky.sun[0], eg + facing * sky.sun[1], eb + facing * sky.sun[2]
            if setting.lamps_on:
                _, most, rest = _strongest(lamps, x, y, z, nx, ny, nz)
                power = most * (lit[i] if by_lamp else 1.0) + 0.5 * rest
                er, eg, eb = er + power, eg + 0.76 * power, eb + 0.46 * power
            if setting.headlights:
                power = _beam_light(beam, x, y, z, nx, ny, nz) * (0.06 + 0.94 * setting.night)
                er, eg, eb = er + power, eg + 0.93 * power, eb + 0.8 * power
            r, g, b = hits.albedo[i, 0] * er, hits.albedo[i, 1] * eg, hits.albedo[i, 2] * eb
            f = hits.mirror[i]
            if f > 0.0:
                if reflected[i, 0] >= 0.0:
                    mr, mg, mb = reflected[i, 0], reflected[i, 1], reflected[i, 2]
                else:
                    turn = 2 * (d[0] * nx + d[1] * ny + d[2] * nz)
                    ux, uy, uz = d[0] - turn * nx, d[1] - turn * ny, d[2] - turn * nz
                    mr, mg, mb = sky_radiance(sky, ux, uy, uz)
                    # Low directions meet houses where little of the sky is seen.
                    low = 1 - (1 - open_sky) * (1 - _smooth(uz, 0.2, 0.7)) if uz > 0 else 0.25 * open_sky
                    mr, mg, mb = mr * low, mg * low, mb * low
                r, g, b = r + f * (mr - r), g + f * (mg - g), b + f * (mb - b)
            r, g, b = r + hits.emission[i, 0], g + hits.emission[i, 1], b + hits.emission[i, 2]
            veil = np.exp(-(setting.extinction + _HAZE) * hits.depth[i] * length)
        glow = 0.0
        if setting.extinction > 0.0:
            glow = 0.25 * max(d[0] * sky.to_sun[0] + d[1] * sky.to_sun[1] + d[2] * sky.to_sun[2], 0.0) ** 8
        for k in range(3):
            value = r if k == 0 else (g if k == 1 else b)
            value = value * veil + (sky.horizon[k] + glow * sky.sun[k]) * (1 - veil)
            out[i, k] = min(max(value, 0.0), _BRIGHTEST)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def casts_reflection(geometry: Geometry, samples: Samples, hits: Hits, least: float) -> NDArray[np.bool_]:
    """Which samples (N,) mirror so much that a ray is worth it; curved paint makes do with the sky."""
    out = np.zeros(len(hits.depth), dtype=np.bool_)
    for i in range(len(out)):
        if hits.depth[i] > 0.0 and hits.mirror[i] > least:
            out[i] = geometry.material[samples.triangle[i]] != _PAINT
    return out
