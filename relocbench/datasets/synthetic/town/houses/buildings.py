"""The geometry of houses: their fronts with attachments, backs and party walls below one of the :mod:`roofs`.

A house has its own frame: x along the street, to the right as seen from there, y into the block, z up from the
pavement, and the origin at its left front corner.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.attachments import bay_window, dish
from relocbench.datasets.synthetic.town.houses.facades import balcony, door, openings, shop, trims, window_names
from relocbench.datasets.synthetic.town.houses.house import DEPTH_M, House, columns_of, door_column
from relocbench.datasets.synthetic.town.houses.roofs import flat_roof, gable, mansard
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, boxes_of, join, quads, tube

_LEAST_BAY_M = 1.9
"""width of the narrowest column that has a bay window"""
_HIGH_PLINTH_M = 0.55
"""height of a plinth above which steps lead to the door"""


def house_shape(house: House, width: float, left: float = 0.0, right: float = 0.0) -> Shape:
    """The geometry of a house ``width`` metres wide.

    The two ends of its back are shifted along x by ``left`` and ``right`` relative to its front, which mitres corner
    houses. All faces point outward.
    """
    house = replace(house, front=replace(house.front, salt=house.variant))
    rng = np.random.default_rng(house.seed)
    parts = [*_front(house, width, rng), *_back(house, left, width + right)]
    parts += _ends(house, width, left, right)
    parts += {"gable": gable, "mansard": mansard, "flat": flat_roof}[house.roof](house, width, left, right)
    return join(parts)


def _bay_of(house: House, edge: Array) -> tuple[int, int]:
    """The column of the bay window, -1 for none, and the storeys that it has."""
    entry = door_column(house, len(edge) - 1)
    others = [k for k in range(len(edge) - 1) if k != entry and edge[k + 1] - edge[k] > _LEAST_BAY_M]
    if house.shop or house.bays == 0 or house.floors < 2 or not others:
        return -1, 0
    return max(others, key=lambda k: (edge[k + 1] - edge[k], k)), min(house.bays, house.floors - 1)


def _front(house: House, width: float, rng: np.random.Generator) -> list[Shape]:
    """The front: ground floor, upper floors and attachments."""
    style, edge = house.front, columns_of(house, width)
    columns = len(edge) - 1
    bay, storeys = _bay_of(house, edge)
    column, floor = (a.ravel() for a in np.meshgrid(np.arange(columns), np.arange(1, house.floors), indexing="xy"))
    kept = (column != bay) | (floor >= storeys)
    column, floor = column[kept], floor[kept]
    base = house.ground_m + (floor - 1) * house.floor_m
    cells = np.stack([edge[column], edge[column + 1], base, base + house.floor_m], axis=1)
    holes = _holes(house, cells, base + style.sill, floor)
    pattern = rng.random(columns) < style.balconies
    with_balcony = pattern[column]
    holes[with_balcony, 2] = base[with_balcony] + 0.08
    parts = [] if len(cells) == 0 else openings(cells, holes, style, Material.WINDOW, window_names(len(cells), 0))
    if not with_balcony.all():
        parts += trims(holes[~with_balcony], style, cells[~with_balcony])
    parts += [balcony(h[0], h[1], h[2] - 0.04) for h in holes[with_balcony]]
    parts += _ground_floor(house, edge, bay)
    if bay >= 0:
        parts += bay_window(edge[bay], edge[bay + 1], _levels(house)[: storeys + 1], style)
    parts += _along_the_wall(house, width, edge if bay < 0 else edge[[bay, bay + 1]], bay)
    if rng.random() < 0.3:
        parts.append(dish(float(rng.uniform(0.5, max(0.6, width - 0.5))), house.wall_m - float(rng.uniform(0.7, 1.6))))
    return parts


def _levels(house: House) -> Array:
    """Heights (floors + 1,) of the floors and of the eaves."""
    return np.concatenate([[0.0], house.ground_m + house.floor_m * np.arange(house.floors)])


def _holes(house: House, cells: Array, sill: Array, floor: Array) -> Array:
    """Window openings (N, 4) of upper floors: wider in wider columns, and of another height on each storey."""
    style = house.front
    mean = cells[:, 1] - cells[:, 0]
    opening_m = np.minimum(style.width * (mean / style.bay_m).clip(0.6, 1.5), mean - 0.4)
    tall = np.ones(len(cells))
    if house.floors > 2:
        tall[floor == 1], tall[floor == house.floors - 1] = house.storeys
    top = np.minimum(sill + style.height * tall, cells[:, 3] - 0.3)
    middle = (cells[:, 0] + cells[:, 1]) / 2
    return np.stack([middle - opening_m / 2, middle + opening_m / 2, sill, top], axis=1)


def _along_the_wall(house: House, width: float, edge: Array, bay: int) -> list[Shape]:
    """String courses, strips at the ends, and a downpipe."""
    style, high = house.front, house.wall_m
    spans = [(0.0, width)] if bay < 0 else [(0.0, float(edge[0])), (float(edge[1]), width)]
    levels = [house.ground_m] if house.band else []
    if house.courses:
        levels += [house.ground_m + house.floor_m * k for k in range(1, house.floors - 1)]
    rows = [
        (a, -0.07, z - 0.12, b, 0.0, z + (0.1 if n == 0 else 0.02))
        for n, z in enumerate(levels)
        for a, b in (spans if n == 0 else [(0.0, width)])
        if b - a > 0.05
    ]
    strip = max(house.strips_m if width > 4.5 else 0.0, 0.06)
    rows.append((0.0, -0.05, 0.0, strip, 0.0, high))
    if house.strips_m:
        rows.append((width - strip, -0.05, 0.0, width, 0.0, high))
    pipe = [[width - 0.12, -0.11, 0.05], [width - 0.12, -0.11, high - 0.1]]
    return [boxes_of(rows, style.trim, without="back"), tube(pipe, 0.045, 6, Material.METAL)]


def _ground_floor(house: House, edge: Array, bay: int) -> list[Shape]:
    """The ground floor: a door in one column, and windows or shop fronts in the others but that of a bay window."""
    style, columns = house.front, len(edge) - 1
    entry = door_column(house, columns)
    door_cell = np.array([edge[entry], edge[entry + 1], 0.0, house.ground_m])
    steps = 2 if house.plinth_m > _HIGH_PLINTH_M and not house.shop else 0
    door_m = min(1.05, door_cell[1] - door_cell[0] - 0.5)
    parts = door(door_cell, door_m, min(2.5 + 0.16 * steps, house.ground_m - 0.4), style, 0x33, steps)
    beside = (door_cell[1] - door_cell[0] - door_m) / 2 - 0.14
    if house.plinth_m and beside > 0.05:
        a, b = door_cell[0], door_cell[1]
        rows = [(x, -0.035, 0.0, x + beside, 0.0, house.plinth_m) for x in (a, b - beside)]
        parts.append(boxes_of(rows, _plinth(house), without="back bottom"))
    others = [k for k in range(columns) if k not in (entry, bay)]
    if house.shop and others:
        size = max(1, round(4.5 * columns / edge[-1]))
        runs = np.array_split(others, max(1, len(others) // size)) if columns >= 3 else [np.array(others)]
        for n, run in enumerate(runs):
            cell = np.array([edge[run[0]], edge[run[-1] + 1], 0.0, house.ground_m])
            if cell[1] - cell[0] > 2.4:
                parts += shop(cell, style, 0x71 + 257 * n, house.awning, bool((house.seed >> n) & 1))
            else:
                parts += _ground_windows(house, edge, list(run))
    elif others:
        parts += _ground_windows(house, edge, others)
    return parts


def _plinth(house: House) -> Material:
    return Material.CONCRETE if house.seed & 1 else house.front.trim


def _ground_windows(house: House, edge: Array, columns: list[int]) -> list[Shape]:
    style = house.front
    k = np.array(columns)
    cells = np.stack([edge[k], edge[k + 1], 0 * k, 0 * k + house.ground_m], axis=1).astype(float)
    holes = _holes(house, cells, np.full(len(k), min(1.0, style.sill + 0.2)), np.zeros(len(k)))
    parts = [
        *openings(cells, holes, style, Material.WINDOW, window_names(len(k), 500)),
        *trims(holes, style, cells),
    ]
    if house.plinth_m:
        low = np.stack([cells[:, 0], 0 * k - 0.035, 0 * k], axis=1)
        high = np.stack([cells[:, 1], 0.0 * k, np.minimum(house.plinth_m, holes[:, 2] - 0.12)], axis=1)
        parts.append(boxes(low, high, _plinth(house), without="back bottom"))
    return parts


def _back(house: House, x0: float, x1: float) -> list[Shape]:
    """The wall to the yard with plain windows, made as a front and turned by half a turn."""
    width = x1 - x0
    if width < 2.0:
        wall = [[(x1, DEPTH_M, 0), (x0, DEPTH_M, 0), (x0, DEPTH_M, house.wall_m), (x1, DEPTH_M, house.wall_m)]]
        return [quads(wall, house.front.wall)]
    columns = max(1, round(width / 3.4))
    edge = np.linspace(0, width, columns + 1)
    levels = _levels(house)
    column, floor = (a.ravel() for a in np.meshgrid(np.arange(columns), np.arange(house.floors), indexing="xy"))
    cells = np.stack([edge[column], edge[column + 1], levels[floor], levels[floor + 1]], axis=1)
    middle = (cells[:, 0] + cells[:, 1]) / 2
    half = min(0.55, (edge[1] - edge[0]) / 2 - 0.2)
    holes = np.stack([middle - half, middle + half, levels[floor] + 0.95, levels[floor] + 2.25], axis=1)
    parts = openings(cells, holes, house.front, Material.WINDOW, window_names(len(cells), 1000), plain=True)
    turn = np.array([-1.0, -1.0, 1.0])
    return [replace(p, vertices=p.vertices * turn + np.array([x1, DEPTH_M, 0.0])) for p in parts]


def _ends(house: House, width: float, left: float, right: float) -> list[Shape]:
    """The two party walls, up to the eaves."""
    top = house.wall_m
    walls = [
        [(left, DEPTH_M, 0), (0, 0, 0), (0, 0, top), (left, DEPTH_M, top)],
        [(width, 0, 0), (width + right, DEPTH_M, 0), (width + right, DEPTH_M, top), (width, 0, top)],
    ]
    return [quads(walls, house.front.wall)]
