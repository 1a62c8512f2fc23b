"""What people put up in a street for a while: scaffolds, roadworks, containers, and new patches of asphalt."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, boxes_of, join, moved, quads, tube

_LIFT_M = 2.0
_INNER_M, _OUTER_M = -0.42, -1.1
"""the two rows of a scaffold's standards, in front of the wall"""
_TUBE_M = 0.024
_BARRIER_M = 1.0
_DUG_M = 0.006
"""height of loose soil in a dug-up place above the ground around it"""
PATCH_M = 0.003
"""height of a new patch of asphalt above the road, below that of markings"""


def scaffold(width: float, wall_m: float, sheets: Array | None = None) -> Shape:
    """A scaffold in front of a house, in the house's frame: x along the wall, -y towards the street, z up.

    Args:
        width: of the wall, metres, at least 2.
        wall_m: height of the wall, metres; the highest deck is at least 1.2 m below it.
        sheets: numbers in [0, 1); each panel of the outer side has a sheet if its number, taken in turn, is below 0.5.
            None for a bare scaffold.
    """
    fields = max(1, round((width - 0.5) / 2.1))
    x = np.linspace(0.25, width - 0.25, fields + 1)
    decks = _LIFT_M * np.arange(1, max(1, int((wall_m - 1.2) / _LIFT_M)) + 1)
    top = float(decks[-1]) + 1.1
    parts = [tube([[a, y, 0.0], [a, y, top]], _TUBE_M, 6, Material.METAL) for a in x for y in (_INNER_M, _OUTER_M)]
    left, right = float(x[0]) - 0.15, float(x[-1]) + 0.15
    parts.append(boxes_of(_tubes_along(decks, left, right), Material.METAL))
    parts.append(boxes_of(_tubes_across(x, decks), Material.METAL))
    feet = [(a - 0.08, y - 0.08, 0.0, a + 0.08, y + 0.08, 0.02) for a in x for y in (_INNER_M, _OUTER_M)]
    parts.append(boxes_of(feet, Material.METAL, without="bottom"))
    boards = [(left, y, z + 0.03, right, y + 0.2, z + 0.07) for z in decks for y in (-1.07, -0.85, -0.63)]
    toes = [(left, _OUTER_M + 0.03, z + 0.07, right, _OUTER_M + 0.06, z + 0.22) for z in decks]
    parts.append(boxes_of(boards + toes, Material.WOOD))
    parts += [
        tube([[x[k], _OUTER_M - 0.05, z], [x[k + 1], _OUTER_M - 0.05, z + _LIFT_M]], _TUBE_M, 6, Material.METAL)
        for n, z in enumerate(decks[:-1])
        for k in range(n % 2, fields, 2)
    ]
    if sheets is not None:
        panels = [(a, b, z) for z in decks for a, b in pairwise(x)]
        cloth = [
            (a, _OUTER_M - 0.09, z, b, _OUTER_M - 0.08, min(z + _LIFT_M, top))
            for n, (a, b, z) in enumerate(panels)
            if sheets[n % len(sheets)] < 0.5
        ]
        if cloth:
            parts.append(boxes_of(cloth, Material.SHEET))
    return join(parts)


def _tubes_along(decks: NDArray[np.floating], left: float, right: float) -> list[tuple[float, ...]]:
    """Ledgers below every deck, and two guard rails above it on the side of the street."""
    t = _TUBE_M
    heights = [(y, z) for z in decks for y in (_INNER_M, _OUTER_M)]
    heights += [(_OUTER_M + 2 * t, z + rail) for z in decks for rail in (0.55, 1.0)]
    return [(left, y - t, z - t, right, y + t, z + t) for y, z in heights]


def _tubes_across(x: NDArray[np.floating], decks: NDArray[np.floating]) -> list[tuple[float, ...]]:
    """Transoms under the boards at every standard, and guard rails at both ends."""
    t = _TUBE_M
    places = [(a, float(z)) for z in decks for a in x]
    places += [(a, float(z) + 1.0) for z in decks for a in (float(x[0]), float(x[-1]))]
    return [(a - t, _OUTER_M - 0.1, z - t + 0.01, a + t, _INNER_M + 0.12, z + t + 0.005) for a, z in places]


def _barrier(length: float) -> Shape:
    """A board with red and white stripes and a hand rail, on two feet, along +x from the origin."""
    stripes = max(3, round(length / 0.25)) | 1
    edge = np.linspace(0.0, length, stripes + 1)
    parts = [
        boxes_of([(edge[k], -0.02, 0.72, edge[k + 1], 0.02, _BARRIER_M) for k in range(first, stripes, 2)], material)
        for first, material in ((0, Material.SIGNAL_RED), (1, Material.SIGNAL_WHITE))
    ]
    ends = (0.12, length - 0.16)
    posts = [(x, -0.02, 0.05, x + 0.04, 0.02, 0.72) for x in ends]
    lower = (0.12, -0.015, 0.2, length - 0.12, 0.015, 0.3)
    parts.append(boxes_of([*posts, lower], Material.SIGNAL_WHITE))
    parts.append(boxes_of([(x - 0.06, -0.25, 0.0, x + 0.1, 0.25, 0.06) for x in ends], Material.RUBBER))
    return join(parts)


@cache
def cone() -> Shape:
    """A red cone with two white bands on a square foot, 0.75 m high."""
    height = [0.03, 0.28, 0.40, 0.52, 0.62, 0.75]
    radius = 0.16 - 0.13 * (np.array(height) - 0.03) / 0.72
    body = [
        tube([[0, 0, a], [0, 0, b]], [ra, rb], 12, Material.SIGNAL_WHITE if k % 2 else Material.SIGNAL_RED)
        for k, (a, b, ra, rb) in enumerate(zip(height[:-1], height[1:], radius[:-1], radius[1:], strict=True))
    ]
    return join([boxes([-0.2, -0.2, 0.0], [0.2, 0.2, 0.03], Material.RUBBER), *body])


@cache
def roadworks(length: float, width: float) -> Shape:
    """A dug-up place with barriers around it, a heap of soil and cones, within ``length`` x ``width`` about the origin.

    z is up from the ground, x along the length.
    """
    a, b = length / 2, width / 2 - 0.27
    side, front = _barrier(2 * a - 0.6), _barrier(2 * b - 0.1)
    across = moved(_turned(front), 0.0, -b + 0.05)
    dug = [(-a + 0.75, -b + 0.15), (a - 0.75, -b + 0.15), (a - 0.75, b - 0.15), (-a + 0.75, b - 0.15)]
    hole = quads([(x, y, _DUG_M) for x, y in dug], Material.SOIL)
    heap = _heap(min(0.38, b - 0.2))
    return join([
        moved(side, -a + 0.3, -b), moved(side, -a + 0.3, b), moved(across, -a + 0.3), moved(across, a - 0.3),
        hole, moved(heap, 0.25 * length - 0.3), moved(cone(), 0.2 - a, 0.2 - b), moved(cone(), a - 0.2, b - 0.2),
    ])  # fmt: skip


def _turned(shape: Shape) -> Shape:
    """The shape turned about z by a quarter to the left."""
    return replace(shape, vertices=shape.vertices @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))


def _heap(radius: float) -> Shape:
    """A heap of soil."""
    rng = np.random.default_rng(31)
    profile = [(1.0, 0.0), (0.8, 0.3), (0.45, 0.62), (0.12, 0.74), (0.02, 0.75)]
    shape = tube([[0, 0, z * radius * 1.2] for _, z in profile], [r * radius for r, _ in profile], 14, Material.SOIL)
    rough = shape.vertices + rng.normal(0, 0.035 * radius, shape.vertices.shape) * np.array([1, 1, 0])
    return replace(shape, vertices=rough * np.array([1.5, 1.0, 1.0]))


@cache
def container() -> Shape:
    """A container for rubble with sloping ends, 3.4 m long along x, 1.6 m wide, filled to below its rim."""
    low, high, width, floor, rim = 1.05, 1.7, 0.8, 0.12, 1.25
    outside = {y: [(-low, y, floor), (low, y, floor), (high, y, rim), (-high, y, rim)] for y in (-width, width)}
    near, far = outside[-width], outside[width]
    faces = [near, [far[k] for k in (1, 0, 3, 2)]]
    faces += [
        [far[0], near[0], near[3], far[3]],
        [near[1], far[1], far[2], near[2]],
        [near[0], far[0], far[1], near[1]],
    ]
    shell = quads(faces, Material.CONTAINER)
    inner = [[p[k] for k in order] for p, order in ((near, (1, 0, 3, 2)), (far, (0, 1, 2, 3)))]
    inner += [[near[0], far[0], far[3], near[3]], [far[1], near[1], near[2], far[2]]]
    shift = np.array([0.97, 0.96, 1.0])
    lining = quads(np.array(inner) * shift, Material.CONTAINER)
    load = quads([[(-1.55, -0.75, 1.0), (1.55, -0.75, 1.0), (1.55, 0.75, 1.0), (-1.55, 0.75, 1.0)]], Material.SOIL)
    rails = boxes_of(
        [(-high - 0.04, y - 0.05, rim - 0.05, high + 0.04, y + 0.05, rim + 0.03) for y in (-width, width)]
        + [(x - 0.05, -width, rim - 0.05, x + 0.05, width, rim + 0.03) for x in (-high, high)],
        Material.CONTAINER,
    )
    ribs = boxes_of(
        [(x - 0.04, y - 0.05, floor, x + 0.04, y + 0.05, rim) for x in (-0.9, 0.0, 0.9) for y in (-width, width)],
        Material.CONTAINER,
    )
    feet = boxes_of([(x - 0.1, y - 0.1, 0.0, x + 0.1, y + 0.1, floor) for x in (-0.8, 0.8) for y in (-0.6, 0.6)],
                    Material.METAL)  # fmt: skip
    return join([shell, lining, load, rails, ribs, feet])


def patch(length: float, width: float) -> Shape:
    """A new patch of asphalt about the origin on the road, along x."""
    a, b = length / 2, width / 2
    corners = [(-a, -b, PATCH_M), (a, -b, PATCH_M), (a, b, PATCH_M), (-a, b, PATCH_M)]
    return quads(corners, Material.FRESH_ASPHALT)
