"""Roofs of houses in the house's frame: gables, mansards and flat roofs, with chimneys and dormers."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.facades import openings, window_names
from relocbench.datasets.synthetic.town.houses.house import DEPTH_M, House, columns_of
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, join, moved, quads, triangle_shape, tube


def _along(house: House, width: float, left: float, right: float, y: float, z: float) -> Array:
    """The two ends (2, 3) of a line along the house at depth y and height z."""
    return np.array([(left * y / DEPTH_M, y, z), (width + right * y / DEPTH_M, y, z)])


def _cornice(house: House, width: float, height: float = 0.22, reach: float = 0.22) -> Shape:
    z = house.wall_m
    return boxes([0.0, -reach, z - height], [width, 0.0, z], house.front.trim, without="back")


def gable(house: House, width: float, left: float, right: float) -> list[Shape]:
    """A gable roof: two slopes with overhanging eaves and gutters, gable ends, chimneys, and possibly dormers."""
    z, over = house.wall_m, 0.3
    rise = house.pitch * DEPTH_M / 2
    ends = (house, width, left, right)
    ridge = _along(*ends, DEPTH_M / 2, z + rise)
    eave = _along(*ends, -over, z - over * house.pitch)
    back = _along(*ends, DEPTH_M + over, z - over * house.pitch)
    slopes = [[eave[0], eave[1], ridge[1], ridge[0]], [back[1], back[0], ridge[0], ridge[1]]]
    low = [[p - (0, 0, 0.12) for p in row] for row in (eave, back)]
    edges = [[low[0][0], low[0][1], eave[1], eave[0]], [low[1][1], low[1][0], back[0], back[1]]]
    foot = [_along(*ends, y, z - 0.12 - over * house.pitch) for y in (0.0, DEPTH_M)]
    soffit = [[foot[0][0], foot[0][1], low[0][1], low[0][0]], [low[1][0], low[1][1], foot[1][1], foot[1][0]]]
    front_wall, back_wall = _along(*ends, 0.0, z), _along(*ends, DEPTH_M, z)
    gables = triangle_shape(np.concatenate([front_wall, back_wall, ridge]), [[2, 0, 4], [1, 3, 5]], house.front.wall)
    caps = [
        [foot[0][0], low[0][0], eave[0], front_wall[0]], [low[0][1], foot[0][1], front_wall[1], eave[1]],
        [low[1][0], foot[1][0], back_wall[0], back[0]], [foot[1][1], low[1][1], back[1], back_wall[1]],
    ]  # fmt: skip
    gutter = eave - np.array([0, 0.06, 0.04])
    parts = [
        quads(np.array(slopes), house.roof_material),
        quads(np.array(edges + soffit + caps), Material.WOOD),
        gables,
        tube(gutter, 0.06, 6, Material.METAL),
        *_chimneys(house, ridge),
    ]
    if house.dormers and width - abs(left) - abs(right) > 5:
        count = max(1, int((width - max(left, 0) + min(right, 0)) / 3.6))
        for x in np.linspace(max(left, 0) / 2, width + min(right, 0) / 2, count + 2)[1:-1]:
            parts.append(moved(_dormer(house, house.pitch), x, 0.25 * DEPTH_M / 2, z + 0.25 * rise))
    return parts


def _chimneys(house: House, ridge: Array) -> list[Shape]:
    """Brick chimneys with pots on the ridge, at one or both ends."""
    parts = []
    for k in range(house.chimneys):
        x = ridge[k % 2][0] + (0.5 if k % 2 == 0 else -0.5)
        y, z = ridge[0][1], ridge[0][2]
        parts.append(
            boxes([x - 0.35, y - 0.5, z - 1.2], [x + 0.35, y + 0.5, z + 1.0], Material.BRICK, without="bottom")
        )
        parts.append(boxes([x - 0.4, y - 0.55, z + 0.88], [x + 0.4, y + 0.55, z + 1.04], Material.CONCRETE))
        for dy in (-0.28, 0.0, 0.28):
            pot = [[x, y + dy, z + 1.04], [x, y + dy, z + 1.4]]
            parts.append(tube(pot, [0.11, 0.09], 8, Material.ROOF_TILES))
    return parts


def _dormer(house: House, pitch: float) -> Shape:
    """A dormer window with its front at the origin and a flat top that runs back into the slope."""
    half, height = 0.65, 1.35
    reach = (height + 0.2) / pitch
    style = replace(house.front, wall=Material.PLASTER, recess=0.06)
    cell = np.array([[-half, half, -0.1, height]])
    hole = np.array([[-half + 0.15, half - 0.15, 0.15, height - 0.12]])
    sides = triangle_shape(
        [(-half, 0, -0.1), (-half, 0, height), (-half, reach, height),
         (half, 0, -0.1), (half, 0, height), (half, reach, height)],
        [[0, 1, 2], [5, 4, 3]], Material.PLASTER,
    )  # fmt: skip
    top = boxes([-half - 0.1, -0.15, height], [half + 0.1, reach, height + 0.1], Material.ROOF_FLAT)
    return join([*openings(cell, hole, style, Material.WINDOW, window_names(1, 1500)), sides, top])


def mansard(house: House, width: float, left: float, right: float) -> list[Shape]:
    """A mansard roof: steep lower slopes with dormers below a flat top."""
    z, inset, rise = house.wall_m, 0.9, 2.3
    ends = (house, width, left, right)
    lines = [_along(*ends, y, h) for y, h in ((0.0, z), (inset, z + rise), (DEPTH_M - inset, z + rise), (DEPTH_M, z))]
    faces = [[a[0], a[1], b[1], b[0]] for a, b in pairwise(lines)]
    caps = [[lines[3][0], lines[0][0], lines[1][0], lines[2][0]], [lines[0][1], lines[3][1], lines[2][1], lines[1][1]]]
    material = [house.roof_material, Material.ROOF_FLAT, house.roof_material]
    parts = [
        quads(np.array(faces), material),
        quads(np.array(caps), house.front.wall),
        _cornice(house, width, 0.3, 0.35),
    ]
    edge = columns_of(house, width)
    for x in (edge[:-1] + edge[1:]) / 2:
        if max(left, 0) * 0.2 + 0.7 < x < width + min(right, 0) * 0.2 - 0.7:
            parts.append(moved(_dormer(house, rise / inset), x, 0.16, z + 0.4))
    return parts + _chimneys(house, _along(*ends, DEPTH_M / 2, z + rise))


def flat_roof(house: House, width: float, left: float, right: float) -> list[Shape]:
    """A flat roof with a parapet and a cornice, and for some houses a plant room."""
    z, high, thick = house.wall_m, 0.55, 0.25
    ends = (house, width, left, right)
    outer = np.array([*_along(*ends, 0.0, z), *_along(*ends, DEPTH_M, z)[::-1]])
    inner = np.array([*_along(*ends, thick, z), *_along(*ends, DEPTH_M - thick, z)[::-1]])
    inner += np.array([(thick, 0, 0), (-thick, 0, 0), (-thick, 0, 0), (thick, 0, 0)])
    up = np.array([0, 0, high])
    rows = [(i, (i + 1) % 4) for i in range(4)]
    wall = [[outer[i], outer[j], outer[j] + up, outer[i] + up] for i, j in rows]
    cap = [[outer[i] + up, outer[j] + up, inner[j] + up, inner[i] + up] for i, j in rows]
    inside = [[inner[i] + up, inner[j] + up, inner[j] + up * 0.2, inner[i] + up * 0.2] for i, j in rows]
    floor = [inner + up * 0.2]
    parts = [
        quads(np.array(wall), house.front.wall),
        quads(np.array(cap), house.front.trim),
        quads(np.array(inside), house.front.wall),
        quads(np.array(floor), Material.ROOF_FLAT),
        _cornice(house, width),
    ]
    if house.chimneys:
        x, y = width / 2, DEPTH_M * 0.6
        parts.append(boxes([x - 1.0, y - 1.0, z], [x + 1.0, y + 1.0, z + 2.3], Material.PLASTER, without="bottom"))
    return parts
