"""The surface that each ray hits: depth, normal and colour, dry, wet and under snow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Bytes, Floats, Mask
from relocbench.datasets.synthetic.renderer.lettering import chosen_cell
from relocbench.datasets.synthetic.renderer.materials import CHOICES, Looks, scramble
from relocbench.datasets.synthetic.renderer.samples import Samples, View, start
from relocbench.datasets.synthetic.renderer.textures import MACRO, Patterns, sample
from relocbench.datasets.synthetic.renderer.vectors import Vector, add_scaled, cross, dot, smoothstep, subtract
from relocbench.datasets.synthetic.renderer.wear import street_wear
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.town.raycast import NOTHING
from relocbench.kernels import njit

_ASPHALT, _KERB_LINE = int(Material.ASPHALT), int(Material.KERB_LINE)
_MARKING, _WINDOW, _SHOP = int(Material.LANE_MARKING), int(Material.WINDOW), int(Material.SHOP_WINDOW)
_CURTAIN, _GOODS = int(Material.CURTAIN), int(Material.GOODS)
_LEAF, _HEDGE, _LAMP = int(Material.LEAF), int(Material.HEDGE), int(Material.LAMP)
_PAINT, _CAR_GLASS, _SIGN = int(Material.CAR_PAINT), int(Material.CAR_GLASS), int(Material.SHOP_SIGN)
_LIGHT_RED, _LIGHT_GREEN = int(Material.LIGHT_RED), int(Material.LIGHT_GREEN)
_WALLS = tuple(
    int(m) for m in (Material.BRICK, Material.PLASTER, Material.STONE, Material.CONCRETE, Material.PAINTED_WALL)
)
_TILES = int(Material.ROOF_TILES)
_TAIL_LAMP, _LIGHT_METAL = int(Material.TAIL_LAMP), int(Material.LIGHT_METAL)
_SKY = int(Semantic.SKY)
_MOVING, _PARKED = int(Semantic.MOVING_CAR), int(Semantic.PARKED_CAR)
_GLOW = 2.2
"""brightness of a traffic light relative to its colour in full sun"""
# Numba compiles a function anew for each literal integer that it is given, so that these are of the type of variables.
_NOISE, _ONE, _THREE = np.int64(MACRO), np.int64(1), np.int64(3)
_ON_GROUND, _OF_PUDDLES = np.int64(0), np.int64(1)
"""salts of the noise in world coordinates"""


class Geometry(NamedTuple):
    """The mesh's arrays."""

    vertices: Floats
    triangles: NDArray[np.uint32]
    uv: Floats
    material: Bytes
    semantic: Bytes
    instance: NDArray[np.uint32]
    variant: NDArray[np.uint32]


def make_geometry(mesh: Mesh) -> Geometry:
    """The mesh in the form that compiled code takes."""
    return Geometry(*(np.ascontiguousarray(getattr(mesh, name)) for name in Geometry._fields))


class Setting(NamedTuple):
    """Parameters of weather and time of day that affect surfaces and light."""

    wetness: float
    puddles: float
    snow: float
    extinction: float
    lamps_on: bool
    headlights: bool
    night: float
    """0 by day, 1 at night, when windows are lit"""
    seed: int


class Hits(NamedTuple):
    """The surfaces that N samples hit, before lighting."""

    depth: Array
    """(N,) ray parameter from the ray's start; 0 for the sky"""
    position: Floats
    normal: Floats
    """(N, 3) normal of the visible side"""
    albedo: Floats
    emission: Floats
    mirror: Floats
    """(N,) specular reflectance"""
    sharpness: Floats
    """(N,) sharpness of the specular reflection, 1 for glass and still water"""


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _fresnel(cosine: float) -> float:
    """Reflectance of water and glass (Schlick 1994, F0 = 0.03)."""
    k = 1 - min(max(cosine, 0.0), 1.0)
    k2 = k * k
    return 0.03 + 0.97 * k2 * k2 * k


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def corner(vertices: Floats, i: int) -> Vector:
    """A vertex in double precision."""
    return float(vertices[i, 0]), float(vertices[i, 1]), float(vertices[i, 2])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _facet(geometry: Geometry, triangle: int) -> tuple[Vector, Vector, Vector, Vector, float, float]:
    """A corner, the unit normal, the spatial gradients of u and v, and u and v at the corner of a triangle.

    Barycentric coordinates, and thus u and v, are linear in the point. Everything is 0 for a triangle without area.
    """
    corners = geometry.triangles
    a = corner(geometry.vertices, corners[triangle, 0])
    e1 = subtract(corner(geometry.vertices, corners[triangle, 1]), a)
    e2 = subtract(corner(geometry.vertices, corners[triangle, 2]), a)
    c = cross(e1, e2)
    area2 = dot(c, c)
    per_area = 1.0 / area2 if area2 > 0.0 else 0.0
    size = np.sqrt(per_area)
    g1, g2 = cross(e2, c), cross(c, e1)
    uv = geometry.uv
    u0, v0 = float(uv[triangle, 0, 0]), float(uv[triangle, 0, 1])
    u1, v1 = (uv[triangle, 1, 0] - u0) * per_area, (uv[triangle, 1, 1] - v0) * per_area
    u2, v2 = (uv[triangle, 2, 0] - u0) * per_area, (uv[triangle, 2, 1] - v0) * per_area
    return (
        a,
        (c[0] * size, c[1] * size, c[2] * size),
        (g1[0] * u1 + g2[0] * u2, g1[1] * u1 + g2[1] * u2, g1[2] * u1 + g2[2] * u2),
        (g1[0] * v1 + g2[0] * v2, g1[1] * v1 + g2[1] * v2, g1[2] * v1 + g2[2] * v2),
        u0,
        v0,
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _paint(
    geometry: Geometry, patterns: Patterns, looks: Looks, seed: int, triangle: int
) -> tuple[np.int64, np.int64, np.int64, float, float, float, Vector]:
    """Material, layer, random bits, shift of the pattern along u and v, tone and first colour of a triangle."""
    material, variant = np.int64(geometry.material[triangle]), np.int64(geometry.variant[triangle])
    dice = np.int64(scramble(variant, material * 7919 + seed))
    layer = material
    shift_u = 0.0 if material in (_ASPHALT, _MARKING, _KERB_LINE, _CAR_GLASS) else (dice & 255) / 255.0 * 7.3
    shift_v = 0.37 * shift_u
    if patterns.lettering.pages[material] > 0:
        layer, shift_u, shift_v = chosen_cell(patterns.lettering, material, dice)
        shift_u, shift_v = shift_u / patterns.per_tile[material], shift_v / patterns.per_tile[material]
    tone = 1.0 + looks.spread[material] * 2 * (((dice >> 8) & 255) / 255.0 - 0.5)
    choice = (dice >> 16) % CHOICES
    r, g, b = looks.first[material, choice, 0], looks.first[material, choice, 1], looks.first[material, choice, 2]
    if material in (_LEAF, _HEDGE):
        # The variant's bits are those of vegetation.place_of: clump, leaf, and how deep in the crown it is.
        tree = np.int64(scramble(np.int64(geometry.instance[triangle]), seed))
        clump = np.int64(scramble(variant >> 4, seed + 1))
        turned = 1.0 if material == _LEAF else 0.3
        kind = tree & 7
        r += (looks.foliage[kind, 0] - r) * turned
        g += (looks.foliage[kind, 1] - g) * turned
        b += (looks.foliage[kind, 2] - b) * turned
        light = (0.8 + 0.4 * ((tree >> 8) & 255) / 255.0) * (0.82 + 0.36 * (clump & 255) / 255.0)
        light *= (0.84 + 0.32 * ((dice >> 4) & 255) / 255.0) * (1.0 - 0.19 * (variant & 3))
        yellow = 0.1 * (((tree >> 16) & 255) / 255.0 - 0.5) + 0.12 * (((clump >> 8) & 255) / 255.0 - 0.5)
        r, g, b = r * light * (1.0 + 1.6 * yellow), g * light, b * light * (1.0 - yellow)
    elif material == _PAINT:
        # Towards black or grey, mostly a little.
        other = 1 + ((dice >> 19) & 1)
        turned = 0.7 * (((dice >> 24) & 255) / 255.0) ** 2
        r += (looks.first[material, other, 0] - r) * turned
        g += (looks.first[material, other, 1] - g) * turned
        b += (looks.first[material, other, 2] - b) * turned
    return material, layer, dice, shift_u, shift_v, tone, (float(r), float(g), float(b))


@njit(cache=True, nogil=True, error_model="numpy")
def surfaces(
    view: View, geometry: Geometry, patterns: Patterns, looks: Looks, setting: Setting, samples: Samples
) -> Hits:
    """Depth, normal and colour of the surface that each sample hits.

    The depth is computed in double precision from the ray and the triangle's plane, not taken from Embree.
    """
    n = len(samples.u)
    depth = np.empty(n, dtype=np.float64)
    position = np.empty((n, 3), dtype=np.float32)
    normal = np.empty((n, 3), dtype=np.float32)
    albedo = np.empty((n, 3), dtype=np.float32)
    emission = np.zeros((n, 3), dtype=np.float32)
    mirror = np.empty(n, dtype=np.float32)
    sharpness = np.empty(n, dtype=np.float32)
    # Neighbours in a row mostly hit the same triangle, so everything but the point itself is reused.
    last = np.uint32(NOTHING)
    a = c = gu = gv = first_colour = (0.0, 0.0, 0.0)
    u0 = v0 = shift_u = shift_v = varied = 0.0
    material = layer = dice = np.int64(0)
    for i in range(n):
        triangle = samples.triangle[i]
        slope = 0.0
        if triangle != NOTHING:
            o, d, dx, dy = start(view, samples, i)
            if triangle != last:
                last = triangle
                a, c, gu, gv, u0, v0 = _facet(geometry, triangle)
                painted = _paint(geometry, patterns, looks, setting.seed, triangle)
                material, layer, dice, shift_u, shift_v, varied, first_colour = painted
            slope = dot(c, d)
        if slope == 0.0:
            depth[i] = 0.0
            for k in range(3):
                position[i, k] = normal[i, k] = albedo[i, k] = 0.0
            mirror[i] = sharpness[i] = 0.0
            continue
        per_slope = 1.0 / slope
        t = dot(c, subtract(a, o)) * per_slope
        p = add_scaled(o, t, d)
        side = -1.0 if slope > 0 else 1.0
        nx, ny, nz = c[0] * side, c[1] * side, c[2] * side

        reach = samples.before[i] + t
        px = add_scaled((reach * dx[0], reach * dx[1], reach * dx[2]), -reach * dot(c, dx) * per_slope, d)
        py = add_scaled((reach * dy[0], reach * dy[1], reach * dy[2]), -reach * dot(c, dy) * per_slope, d)
        q = subtract(p, a)
        su, sv = u0 + dot(gu, q) + shift_u, v0 + dot(gv, q)
        dudx, dvdx, dudy, dvdy = dot(gu, px), dot(gv, px), dot(gu, py), dot(gv, py)

        # The coordinates of a street tell where wheels roll; its grain goes on across streets and markings.
        street = material in (_ASPHALT, _MARKING, _KERB_LINE)
        laid = dice
        worn, track, dirt = 1.0, 0.0, 0.0
        if street:
            along, across = su, sv
            half_u, half_v = 0.5 * (abs(dudx) + abs(dudy)), 0.5 * (abs(dvdx) + abs(dvdy))
            laid, su, sv, dudx, dvdx, dudy, dvdy = _ON_GROUND, p[0], p[1], px[0], px[1], py[0], py[1]

        # Reflections are dim or blurred and need fewer texture samples.
        most = 6 if samples.before[i] <= 0.0 else 3
        share, bright = sample(patterns, layer, laid, 1.0, su, sv + shift_v, dudx, dvdx, dudy, dvdy, most)
        # Low-frequency stains, in surface coordinates on walls and in world coordinates on the ground.
        flat = nz > 0.7
        if flat:
            slow, stain = sample(patterns, _NOISE, _ON_GROUND, 1.0, p[0], p[1], px[0], px[1], py[0], py[1], most // 3)
        else:
            # Rain draws stains out downwards.
            slow, stain = sample(
                patterns, _NOISE, dice, 3.0, su + 2 * shift_u, 0.2 * sv, dudx, 0.2 * dvdx, dudy, 0.2 * dvdy, _ONE
            )
        tone = varied
        stained = 0.12
        if material in _WALLS:
            stained = 0.12 + 0.34 * ((dice >> 3) & 31) / 31.0
            tone *= 1.0 - (0.1 + 0.25 * slow) * (1.0 - smoothstep(p[2], 0.1, 0.5 + 0.9 * slow))
        elif material == _TILES:
            stained = 0.3
        if street:
            variant = np.int64(geometry.variant[triangle])
            worn, track, dirt = street_wear(along, across, variant, half_u, half_v, slow, setting.seed)
            if material == _ASPHALT:
                tone, stained = tone * worn, 0.3
            else:
                # Wheels wear paint off, and it is as dirty as the road.
                share = min(1.0, share * (0.6 + 1.5 * slow + 1.2 * track) + 0.3 * dirt)
                tone *= 0.9 + 0.1 * worn
        if material != _PAINT and material != _CAR_GLASS and material != _LAMP:
            tone *= 1 - stained + stained * stain
        shine = tone * bright
        r, g, b = first_colour
        r = (r + (looks.second[material, 0] - r) * share) * shine
        g = (g + (looks.second[material, 1] - g) * share) * shine
        b = (b + (looks.second[material, 2] - b) * share) * shine * (1 - 0.12 * dirt)

        fresnel = _fresnel(abs(slope) / np.sqrt(dot(d, d)))
        gloss, sharp = looks.gloss[material] * fresnel, 1.0
        glass = material in (_WINDOW, _SHOP, _CURTAIN, _GOODS)
        if glass:
            gloss = min(1.0, 1.6 * gloss + 0.07)

        if material in (_PAINT, _LIGHT_METAL):
            # Spray dries on sills and rims.
            splashed = (0.1 + 0.4 * (dice & 255) / 255.0) * (1 - smoothstep(p[2] + 0.25 * (slow - 0.5), 0.2, 0.75))
            r, g, b = r + (0.16 - r) * splashed, g + (0.14 - g) * splashed, b + (0.115 - b) * splashed
            gloss *= 1 - splashed

        snow = 0.0
        if setting.snow > 0.0 and nz > 0.2 and material != _LAMP:
            line = (1 - setting.snow) * 1.2 - 0.1
            grain = slow if flat else 0.5
            if street:
                # Wheels press it into dirty slush; ploughs leave it along kerbs.
                grain = 0.6 * grain + 0.25 - 0.65 * track + 0.6 * dirt
            deep = smoothstep(grain + 0.25 * (bright - 1.0), line - 0.1, line + 0.1)
            # A thin layer remains where snow is swept or trodden; without it the ground would seem to have holes.
            thin = 0.75 * setting.snow * setting.snow * (1 - 0.6 * track)
            snow = (thin + (1 - thin) * deep) * smoothstep(nz, 0.3, 0.7)
            if snow > 0.0:
                white = (0.80 + 0.12 * (bright - 1.0) + 0.09 * (stain - 1.0)) * (1 - 0.25 * track)
                r, g, b = r + (white - r) * snow, g + (white * 1.01 - g) * snow, b + (white * 1.04 - b) * snow
                gloss *= 1 - snow

        if setting.wetness > 0.0:
            soaked = setting.wetness * (0.35 + 0.65 * smoothstep(nz, -0.2, 0.6)) * (1 - snow)
            film, still = 0.0, 0.0
            if nz > 0.97 and looks.film[material] > 0.0:
                film = (
                    looks.film[material] * soaked * (0.65 + 0.35 * smoothstep(slow, 0.2, 0.7)) * (0.75 + 0.25 * share)
                )
                if setting.puddles > 0.0 and looks.hollows[material] > 0.0:
                    hollow, _ = sample(
                        patterns, _NOISE, _OF_PUDDLES, 2.2, p[0], p[1], px[0], px[1], py[0], py[1], _THREE
                    )
                    line = 1.0 - 0.36 * setting.puddles * looks.hollows[material]
                    still = smoothstep(hollow, line, line + 0.05) * (1 - snow)
                film += (1 - film) * still
                lost = gloss
                gloss = lost + (1 - lost) * film * fresnel
                sharp = 0.05 + 0.95 * still
            keep = 1 - looks.porous[material] * soaked * (1 + 0.4 * still)
            r, g, b = r * keep, g * keep, b * keep

        if material == _LAMP:
            semantic = geometry.semantic[triangle]
            of_car = semantic in (_MOVING, _PARKED)
            if (setting.headlights and semantic == _MOVING) or (setting.lamps_on and not of_car):
                emission[i, 0], emission[i, 1], emission[i, 2] = 6.0, 4.8, 3.2
        elif material in (_LIGHT_RED, _LIGHT_GREEN):
            emission[i, 0], emission[i, 1], emission[i, 2] = _GLOW * r, _GLOW * g, _GLOW * b
        elif material == _TAIL_LAMP and setting.headlights and geometry.semantic[triangle] == _MOVING:
            emission[i, 0], emission[i, 1], emission[i, 2] = 1.6, 0.06, 0.04
        of_shop = material in (_SHOP, _GOODS)
        room = np.int64(scramble(np.int64(geometry.variant[triangle]), setting.seed)) if glass else np.int64(0)
        if setting.night > 0.0 and glass and (of_shop or (room >> 5) % 100 < 24):
            power = setting.night * (0.5 if of_shop else 0.22) * (0.5 + (room & 127) / 127.0)
            power *= 0.45 + 0.75 * share
            if material in (_CURTAIN, _GOODS):
                power *= 1.5 * (r + g + b)
            warm = ((room >> 12) & 7) / 7.0
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
def casts_reflection(geometry: Geometry, samples: Samples, hits: Hits, least: float) -> Mask:
    """Mask (N,) of the samples specular enough for a reflection ray; curved car paint only reflects the sky."""
    out = np.zeros(len(hits.depth), dtype=np.bool_)
    for i in range(len(out)):
        if hits.depth[i] > 0.0 and hits.mirror[i] > least:
            out[i] = geometry.material[samples.triangle[i]] != _PAINT
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def objects(geometry: Geometry, triangle: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], Bytes]:
    """Instance number and semantic class (N,) of the triangles that rays hit."""
    n = len(triangle)
    instance = np.zeros(n, dtype=np.uint32)
    semantic = np.full(n, _SKY, dtype=np.uint8)
    for i in range(n):
        if triangle[i] != NOTHING:
            instance[i] = geometry.instance[triangle[i]]
            semantic[i] = geometry.semantic[triangle[i]]
    return instance, semantic
