"""Cars: a closed body made from a side profile, with wheel arches, glass and lamps, wheels, and what is stuck on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Indices
from relocbench.datasets.synthetic.town.mesh import PLATE_M, Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.shapes import (
    Shape,
    boxes,
    instances,
    join,
    moved,
    quads,
    skin,
    triangle_shape,
    tube,
)


@dataclass(frozen=True)
class _Type:
    """Side view of a car; x is forward from its middle, in metres."""

    half_length: float
    half_width: float
    axles: tuple[float, float]
    wheel: float
    belt: float
    """height of the windows' lower edge"""
    profile: tuple[tuple[float, float], ...]
    """(x, z) of the outline's top from the tail to the nose"""
    glass: tuple[tuple[float, float], ...]
    """(from, to) of the side windows"""
    screens: tuple[tuple[float, float], ...]
    """(from, to) of the rear window and the windscreen, along the profile"""
    clearance: float = 0.22


_TYPES = (
    _Type(  # hatchback
        2.0, 0.87, (-1.25, 1.28), 0.31, 0.92,
        ((-2.0, 0.62), (-1.97, 0.95), (-1.55, 1.40), (-0.9, 1.46), (0.0, 1.47), (0.35, 1.42), (1.15, 0.98),
         (1.82, 0.84), (1.94, 0.72), (2.0, 0.5)),
        ((-1.35, -0.72), (-0.62, 0.08), (0.16, 0.85)), ((-1.93, -1.58), (0.42, 1.12)),
    ),
    _Type(  # saloon
        2.3, 0.9, (-1.38, 1.4), 0.32, 0.93,
        ((-2.3, 0.66), (-2.26, 0.98), (-1.65, 1.02), (-0.95, 1.40), (-0.3, 1.45), (0.2, 1.42), (1.05, 0.98),
         (2.08, 0.82), (2.23, 0.70), (2.3, 0.5)),
        ((-1.05, -0.62), (-0.5, 0.12), (0.2, 0.75)), ((-1.6, -1.0), (0.28, 1.0)),
    ),
    _Type(  # estate
        2.32, 0.9, (-1.38, 1.4), 0.32, 0.94,
        ((-2.32, 0.6), (-2.28, 1.0), (-1.98, 1.42), (-1.0, 1.49), (0.1, 1.49), (0.35, 1.45), (1.1, 0.98), (2.1, 0.82),
         (2.25, 0.70), (2.32, 0.5)),
        ((-1.85, -1.12), (-1.02, -0.45), (-0.35, 0.12), (0.2, 0.8)), ((-2.24, -2.0), (0.42, 1.05)),
    ),
    _Type(  # delivery van
        2.52, 0.97, (-1.5, 1.65), 0.34, 1.12,
        ((-2.52, 0.6), (-2.5, 1.1), (-2.48, 1.9), (-2.3, 2.02), (0.7, 2.02), (1.0, 1.92), (1.75, 1.22), (2.36, 1.06),
         (2.46, 0.86), (2.52, 0.58)),
        ((0.55, 1.2),), ((1.06, 1.7),), 0.26,
    ),
    _Type(  # off-roader
        2.2, 0.94, (-1.33, 1.36), 0.37, 1.08,
        ((-2.2, 0.75), (-2.17, 1.15), (-1.95, 1.63), (-0.9, 1.70), (0.1, 1.70), (0.35, 1.66), (1.0, 1.14), (2.0, 1.04),
         (2.14, 0.92), (2.2, 0.64)),
        ((-1.8, -1.08), (-0.98, -0.25), (-0.15, 0.75)), ((-2.13, -1.97), (0.41, 0.96)), 0.3,
    ),
    _Type(  # city car
        1.75, 0.8, (-1.12, 1.15), 0.28, 0.9,
        ((-1.75, 0.62), (-1.72, 0.95), (-1.5, 1.42), (-0.7, 1.5), (0.0, 1.5), (0.4, 1.42), (1.1, 0.96), (1.58, 0.82),
         (1.69, 0.71), (1.75, 0.5)),
        ((-1.3, -0.5), (-0.4, 0.8)), ((-1.68, -1.52), (0.45, 1.06)),
    ),
    _Type(  # people carrier
        2.25, 0.92, (-1.4, 1.42), 0.33, 0.98,
        ((-2.25, 0.66), (-2.21, 1.1), (-2.0, 1.62), (-1.0, 1.72), (0.1, 1.71), (0.5, 1.62), (1.5, 1.04), (2.02, 0.88),
         (2.18, 0.74), (2.25, 0.52)),
        ((-1.9, -1.15), (-1.05, -0.2), (-0.1, 0.95)), ((-2.17, -2.02), (0.55, 1.44)),
    ),
    _Type(  # compact off-roader
        2.12, 0.91, (-1.3, 1.32), 0.35, 1.02,
        ((-2.12, 0.72), (-2.08, 1.08), (-1.7, 1.50), (-0.9, 1.6), (0.05, 1.6), (0.4, 1.54), (1.12, 1.08), (1.92, 0.96),
         (2.06, 0.84), (2.12, 0.58)),
        ((-1.5, -0.82), (-0.72, 0.02), (0.12, 0.88)), ((-2.04, -1.74), (0.46, 1.08)), 0.26,
    ),
)  # fmt: skip
CAR_TYPES = len(_TYPES)


def _columns(car: _Type) -> Array:
    """Positions (C,) of the cross-sections along the car: kinks of the profile, wheel arches, edges of windows."""
    arch = np.concatenate([[1.06], np.cos(np.linspace(0, np.pi, 9)), [-1.06]]) * (car.wheel + 0.07)
    marks = [[x for x, _ in car.profile], *(a + arch for a in car.axles), np.ravel(car.glass), np.ravel(car.screens)]
    places = np.unique(np.round(np.concatenate([np.asarray(m, float) for m in marks]), 3))
    out: Array = places[np.concatenate([[True], np.diff(places) > 0.015])]
    return out


def _skin(car: _Type) -> Shape:
    """The body as a closed surface: rings of 12 points at the cross-sections, joined from tail to nose."""
    x = _columns(car)
    profile = np.array(car.profile)
    top = np.interp(x, profile[:, 0], profile[:, 1])
    belt = np.minimum(car.belt, top - 0.06)
    arch = car.wheel + 0.07
    low = np.full(len(x), car.clearance)
    for axle in car.axles:
        reach = np.abs(x - axle)
        low = np.where(reach < arch, np.maximum(low, car.wheel + np.sqrt(np.maximum(arch**2 - reach**2, 0))), low)
    low = np.minimum(low, belt - 0.1)
    plan = car.half_width * (1 - 0.16 * (np.abs(x) / car.half_length) ** 5)
    roof = plan - 0.03 - 0.30 * np.maximum(top - belt - 0.06, 0)
    frame = belt + 0.86 * (top - belt)
    edge = plan + (roof - plan) * 0.86
    aside = [plan * 0.96, plan, plan * 0.985, edge * 0.985, roof * 0.93, roof * 0.55]
    height = [low, low + 0.45 * (belt - low), belt, frame, top, top + 0.02]
    half = np.stack([np.stack(aside, axis=1), np.stack(height, axis=1)], axis=2)
    right = half * np.array([-1, 1])
    ring = np.concatenate([right, half[:, ::-1]], axis=1)
    vertices, triangles = skin(x, ring)
    material = np.full(len(triangles), Material.CAR_PAINT)
    sides = np.repeat(_skin_materials(car, x, ring.shape[1]).ravel(), 2)
    material[: len(sides)] = sides
    return triangle_shape(vertices, triangles, material)


def _skin_materials(car: _Type, x: Array, size: int) -> Indices:
    """Materials (C - 1, 12) of the faces between cross-sections, in ring order: right side, top, left side."""
    middle = (x[1:] + x[:-1]) / 2
    result = np.full((len(middle), size), int(Material.CAR_PAINT))
    side = np.any([(middle > a) & (middle < b) for a, b in car.glass], axis=0)
    screen = np.any([(middle > a) & (middle < b) for a, b in car.screens], axis=0)
    for face in (2, size - 4):
        result[side, face] = Material.CAR_GLASS
    for face in (4, 5, 6):
        result[screen, face] = Material.CAR_GLASS
    # The ends of the profile are steep: lamps at the sides, the grille or the boot's lid in between.
    front, back = middle > car.profile[-2][0], middle < car.profile[1][0]
    for face in (3, 4, 6, 7):
        result[front, face], result[back, face] = Material.LAMP, Material.TAIL_LAMP
    result[front, 5] = Material.PLASTIC
    result[:, size - 1] = Material.RUBBER
    return result


def _wheels(car: _Type) -> list[Shape]:
    """Tyres, and a box between them that closes the arches."""
    parts = []
    radius = car.wheel
    outer = car.half_width - 0.02
    for axle in car.axles:
        for side in (-1, 1):
            y = np.array([outer - 0.2, outer - 0.03, outer]) * side
            tyre = tube(np.stack([0 * y, y, 0 * y], 1), [radius, radius, radius - 0.03], 16, Material.RUBBER)
            parts.append(moved(tyre, axle, 0, radius))
        parts.append(boxes([axle - 0.3, 0.2 - outer, 0.25], [axle + 0.3, outer - 0.2, 0.5], Material.RUBBER))
    return parts


def _details(car: _Type) -> list[Shape]:
    """Bumpers and mirrors."""
    nose, width = car.half_length, car.half_width
    low = [(nose - 0.14, -width * 0.8, 0.3), (-nose - 0.03, -width * 0.8, 0.32)]
    high = [(nose + 0.03, width * 0.8, 0.46), (-nose + 0.14, width * 0.8, 0.5)]
    for side in (-1, 1):
        mirror = car.glass[-1][1] - 0.1
        y0, y1 = sorted((side * (width - 0.04), side * (width + 0.13)))
        low.append((mirror - 0.06, y0, car.belt + 0.02))
        high.append((mirror + 0.06, y1, car.belt + 0.16))
    return [boxes(low, high, Material.CAR_PAINT)]


def _stuck_on(car: _Type) -> list[Shape]:
    """Flat parts just off the surface: number plates, faces of wheels, seams and handles of doors."""
    nose = car.half_length
    plate = np.array([(nose + 0.034, y, z) for y, z in ((-0.26, 0.32), (0.26, 0.32), (0.26, 0.45), (-0.26, 0.45))])
    plates = np.stack([plate, plate * np.array([-1, -1, 1])])
    written = np.array([(0.0, 0.0), (PLATE_M, 0.0), (PLATE_M, PLATE_M / 4), (0.0, PLATE_M / 4)])
    parts = [quads(plates, Material.NUMBER_PLATE, np.stack([written, written]))]
    rim = _rim(car.wheel)
    for axle in car.axles:
        for side in (-1, 1):
            # Mirrored faces would look inward: the wheel of the other side is turned instead.
            turned = replace(rim, vertices=rim.vertices * np.array([side, side, 1]))
            parts.append(moved(turned, axle, side * (car.half_width - 0.02), car.wheel))
    doors = sorted({x for a, b in car.glass for x in (a, b)})
    seams = [(a + b) / 2 for a, b in zip(doors[1:-1:2], doors[2::2], strict=True)]
    seams += [car.glass[-1][1] + 0.06] + [car.glass[0][0] - 0.04] * (len(car.glass) < 3)
    seams = [x for x in seams if all(abs(x - axle) > car.wheel + 0.09 for axle in car.axles)]
    for side in (-1, 1):
        flat: list[Array] = []
        for x in seams:
            flat += _on_side(car, x - 0.008, x + 0.008, 0.35, 1.0)
        flat += [_on_side(car, x + 0.06, x + 0.2, 0.80, 0.86)[-1] for x in seams[:-1]]
        points = np.array(flat)
        parts.append(quads(points if side < 0 else (points * np.array([1, -1, 1]))[:, ::-1], Material.RUBBER))
    return parts


def _on_side(car: _Type, x0: float, x1: float, low: float, high: float) -> list[Array]:
    """Upright rectangles (4, 3) on the right side of the body, between two shares of the height up to the windows."""
    x = np.array([x0, x1])
    plan = car.half_width * (1 - 0.16 * (np.abs(x) / car.half_length) ** 5)
    knots = [low, *([0.45] if low < 0.45 < high else []), high]
    rows = [
        np.stack([x, -plan * np.interp(k, [0, 0.45, 1], [0.96, 1, 0.985]) - 0.004, [_height(car, k)] * 2], axis=1)
        for k in knots
    ]
    return [np.stack([a[0], a[1], b[1], b[0]]) for a, b in pairwise(rows)]


def _height(car: _Type, share: float) -> float:
    return car.clearance + share * (car.belt - car.clearance)


def _rim(radius: float) -> Shape:
    """A wheel's face in the plane y = 0, seen from +y: a dark disk, five spokes and a ring of light metal."""
    turn = 2 * np.pi * np.arange(10) / 10
    after = turn + 2 * np.pi / 10

    def at(r: float, angle: Array, y: float) -> Array:
        return np.stack([-r * radius * np.cos(angle), np.full(len(angle), y), r * radius * np.sin(angle)], axis=1)

    ring = [at(0.58, turn, 0.008), at(0.68, turn, 0.008), at(0.68, after, 0.008), at(0.58, after, 0.008)]
    corners = ((0.12, -0.4), (0.6, -0.16), (0.6, 0.16), (0.12, 0.4))
    spokes = [at(r, turn[::2] + aside, 0.012 - 0.01 * r) for r, aside in corners]
    bright = np.concatenate([np.stack(ring, axis=1), np.stack(spokes, axis=1)])
    disk = np.concatenate([at(0.0, turn[:1], 0.003), at(0.6, turn, 0.003)])
    fan = [[0, 1 + k, 1 + (k + 1) % 10] for k in range(10)]
    return join([triangle_shape(disk, fan, Material.RUBBER), quads(bright, Material.LIGHT_METAL)])


@cache
def car_shape(kind: int) -> Shape:
    """The shape of a car type: x forward, y left, z up, origin on the ground below the middle."""
    car = _TYPES[kind]
    return join([solid_shape(kind), *_stuck_on(car)])


@cache
def solid_shape(kind: int) -> Shape:
    """The closed parts of a car type."""
    car = _TYPES[kind]
    return join([_skin(car), *_wheels(car), *_details(car)])


def cars(transforms: Array, variant: ArrayLike, instance: ArrayLike, semantic: Semantic) -> Mesh:
    """Cars with poses (N, 4, 4); the variant (N,) chooses the type (modulo CAR_TYPES) and the look."""
    looks, names = np.asarray(variant, dtype=np.uint32), np.asarray(instance, dtype=np.uint32)
    kind = looks % CAR_TYPES
    groups = []
    for k in range(CAR_TYPES):
        where = np.flatnonzero(kind == k)
        if len(where):
            groups.append(instances(car_shape(k), transforms[where], names[where], looks[where], semantic))
    return merge(groups)
