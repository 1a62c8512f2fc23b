"""Houses: their random parameters, and the geometry of their walls, roofs and attachments.

A house has its own frame: x along the street, to the right as seen from there, y into the block, z up from the
pavement, and the origin at its left front corner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.facades import FrontStyle, balcony, door, openings, shop, trims
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, join, moved, quads, triangle_shape, tube

DEPTH_M = 10.0


@dataclass(frozen=True)
class House:
    """All parameters of a house except its width."""

    front: FrontStyle
    floors: int
    ground_m: float
    floor_m: float
    roof: str
    """gable, mansard or flat"""
    pitch: float
    """slope, rise over run"""
    shop: bool
    awning: bool
    door_at: float
    """position of the door's column, as a share of the columns"""
    band: bool
    dormers: bool
    chimneys: int
    roof_material: Material
    variant: int
    seed: int

    @property
    def wall_m(self) -> float:
        return self.ground_m + (self.floors - 1) * self.floor_m


def draw_house(rng: np.random.Generator, style: str, corner: bool = False) -> House:
    """A random house of a style (terrace, town, villa or modern); corner houses may have one more floor."""
    pick = rng.choice
    wall = {
        "terrace": ([Material.BRICK, Material.PLASTER, Material.STONE], [0.7, 0.2, 0.1]),
        "town": ([Material.PLASTER, Material.STONE, Material.BRICK], [0.55, 0.25, 0.2]),
        "villa": ([Material.PLASTER, Material.BRICK, Material.STONE], [0.55, 0.35, 0.1]),
        "modern": ([Material.CONCRETE, Material.PLASTER, Material.BRICK], [0.4, 0.45, 0.15]),
    }[style]
    material = Material(int(pick(wall[0], p=wall[1])))
    tall = style == "town"
    modern = style == "modern"
    width = float(rng.uniform(1.5, 2.3) if modern else rng.uniform(0.85, 1.35))
    floor_m = float(rng.uniform(2.8, 3.0) if modern else rng.uniform(2.75, 3.4))
    sill = 0.45 if modern else float(rng.uniform(0.6, 0.95))
    height = min(float(rng.uniform(1.35, 1.95)), floor_m - sill - 0.45)
    surround = bool(rng.random() < (0.5 if tall else 0.15))
    front = FrontStyle(
        wall=material,
        trim=Material.CONCRETE if modern else Material.STONE,
        frame=Material.METAL if modern else Material.WOOD,
        bay_m=width + float(rng.uniform(0.9, 1.9)),
        width=width,
        height=height,
        sill=sill,
        recess=float(rng.uniform(0.1, 0.26)),
        mullions=int(pick([1, 2])) if width > 1.5 else int(pick([0, 1])),
        transom=bool(rng.random() < 0.6 and not modern),
        lintel=bool(rng.random() < 0.6 and not modern),
        surround=surround,
        shutters=bool(not surround and not modern and rng.random() < (0.4 if style != "terrace" else 0.1)),
        balconies=float(pick([0.0, 0.25, 0.5, 1.0], p=[0.55, 0.25, 0.15, 0.05])) if tall or modern else 0.0,
    )
    floors = {"terrace": [2, 3], "town": [3, 4, 5], "villa": [2, 2, 3], "modern": [3, 4, 5]}[style]
    roofs = {"terrace": ["gable"], "town": ["gable", "mansard", "flat"], "villa": ["gable"], "modern": ["flat"]}[style]
    return House(
        front=front,
        floors=int(pick(floors)) + (corner and tall and rng.random() < 0.4),
        ground_m=floor_m + (float(rng.uniform(0.4, 0.9)) if tall else 0.15),
        floor_m=floor_m,
        roof=str(pick(roofs)),
        pitch=float(rng.uniform(0.65, 1.05)),
        shop=bool(tall and rng.random() < 0.65),
        awning=bool(rng.random() < 0.35),
        door_at=float(rng.random()),
        band=bool(tall or rng.random() < 0.5),
        dormers=bool(rng.random() < 0.35),
        chimneys=int(pick([0, 1, 2])),
        roof_material=Material.ROOF_TILES,
        variant=int(rng.integers(1, 2**31)),
        seed=int(rng.integers(2**31)),
    )


def terrace_for_rows(rng: np.random.Generator) -> House:
    """A house for rows of identical houses."""
    house = draw_house(rng, "terrace")
    return replace(house, floors=2, dormers=False, chimneys=1, door_at=0.0, front=replace(house.front, bay_m=2.4))


def house_shape(house: House, width: float, left: float = 0.0, right: float = 0.0) -> Shape:
    """The geometry of a house ``width`` metres wide.

    The two ends of its back are shifted along x by ``left`` and ``right`` relative to its front, which mitres corner
    houses. All faces point outward.
    """
    rng = np.random.default_rng(house.seed)
    parts = [*_front(house, width, rng), *_back(house, left, width + right)]
    parts += _ends(house, width, left, right)
    parts += {"gable": _gable, "mansard": _mansard, "flat": _flat_roof}[house.roof](house, width, left, right)
    return join(parts)


def door_x(house: House, width: float) -> float:
    """Position of the door's middle along the front."""
    columns = _columns(house, width)
    return float((_door_column(house, columns) + 0.5) * width / columns)


def _door_column(house: House, columns: int) -> int:
    if house.shop and columns >= 3:
        return 0 if house.door_at < 0.5 else columns - 1
    return min(int(house.door_at * columns), columns - 1)


def _columns(house: House, width: float) -> int:
    return max(1, round(width / house.front.bay_m))


def _front(house: House, width: float, rng: np.random.Generator) -> list[Shape]:
    """The front: ground floor, upper floors and attachments."""
    style, columns = house.front, _columns(house, width)
    edge = np.linspace(0, width, columns + 1)
    column, floor = (a.ravel() for a in np.meshgrid(np.arange(columns), np.arange(1, house.floors), indexing="xy"))
    base = house.ground_m + (floor - 1) * house.floor_m
    cells = np.stack([edge[column], edge[column + 1], base, base + house.floor_m], axis=1)
    opening_m = np.minimum(style.width, (edge[1] - edge[0]) - 0.4)
    middle = (cells[:, 0] + cells[:, 1]) / 2
    sill = base + style.sill
    holes = np.stack([middle - opening_m / 2, middle + opening_m / 2, sill, sill + style.height], axis=1)
    pattern = rng.random(columns) < style.balconies
    with_balcony = pattern[column]
    holes[with_balcony, 2] = base[with_balcony] + 0.08
    names = _names(house, len(cells), 0)
    parts = [] if len(cells) == 0 else openings(cells, holes, style, Material.WINDOW, names)
    plain = holes[~with_balcony]
    if len(plain):
        parts += trims(plain, style, float(edge[1] - edge[0]))
    parts += [balcony(h[0], h[1], h[2] - 0.04) for h in holes[with_balcony]]
    parts += _ground_floor(house, edge)
    if house.band:
        parts.append(
            boxes([0, -0.07, house.ground_m - 0.12], [width, 0, house.ground_m + 0.1], style.trim, without="back")
        )
    parts.append(boxes([0.0, -0.05, 0.0], [0.06, 0.0, house.wall_m], style.trim, without="back bottom"))
    pipe = [[width - 0.12, -0.07, 0.05], [width - 0.12, -0.07, house.wall_m - 0.1]]
    parts.append(tube(pipe, 0.045, 6, Material.METAL))
    return parts


def _names(house: House, count: int, first: int) -> np.ndarray:
    """Variants of the windows of a house, by their numbers."""
    return ((np.arange(count) + first + 1) * 2654435761 % 2**32).astype(np.uint32)


def _ground_floor(house: House, edge: Array) -> list[Shape]:
    """The ground floor: a door in one column, and windows or shop fronts in the others."""
    style, columns = house.front, len(edge) - 1
    entry = _door_column(house, columns)
    door_cell = np.array([edge[entry], edge[entry + 1], 0.0, house.ground_m])
    parts = door(door_cell, min(1.05, door_cell[1] - door_cell[0] - 0.5), min(2.5, house.ground_m - 0.4), style, 0x33)
    others = [k for k in range(columns) if k != entry]
    if house.shop and others:
        size = max(1, round(4.5 / (edge[1] - edge[0])))
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


def _ground_windows(house: House, edge: Array, columns: list[int]) -> list[Shape]:
    style = house.front
    k = np.array(columns)
    cells = np.stack([edge[k], edge[k + 1], 0 * k, 0 * k + house.ground_m], axis=1).astype(float)
    opening_m = min(style.width, (edge[1] - edge[0]) - 0.4)
    middle = (cells[:, 0] + cells[:, 1]) / 2
    sill = min(1.0, style.sill + 0.2)
    holes = np.stack(
        [middle - opening_m / 2, middle + opening_m / 2, 0 * middle + sill, 0 * middle + sill + style.height], 1
    )
    return [
        *openings(cells, holes, style, Material.WINDOW, _names(house, len(k), 500)),
        *trims(holes, style, float(edge[1] - edge[0])),
    ]


def _back(house: House, x0: float, x1: float) -> list[Shape]:
    """The wall to the yard with plain windows, made as a front and turned by half a turn."""
    width = x1 - x0
    if width < 2.0:
        wall = [[(x1, DEPTH_M, 0), (x0, DEPTH_M, 0), (x0, DEPTH_M, house.wall_m), (x1, DEPTH_M, house.wall_m)]]
        return [quads(wall, house.front.wall)]
    columns = max(1, round(width / 3.4))
    edge = np.linspace(0, width, columns + 1)
    levels = np.concatenate([[0], house.ground_m + house.floor_m * np.arange(house.floors)])
    column, floor = (a.ravel() for a in np.meshgrid(np.arange(columns), np.arange(house.floors), indexing="xy"))
    cells = np.stack([edge[column], edge[column + 1], levels[floor], levels[floor + 1]], axis=1)
    middle = (cells[:, 0] + cells[:, 1]) / 2
    half = min(0.55, (edge[1] - edge[0]) / 2 - 0.2)
    holes = np.stack([middle - half, middle + half, levels[floor] + 0.95, levels[floor] + 2.25], axis=1)
    names = _names(house, len(cells), 1000)
    parts = openings(cells, holes, house.front, Material.WINDOW, names, plain=True)
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


def _along(house: House, width: float, left: float, right: float, y: float, z: float) -> Array:
    """The two ends (2, 3) of a line along the house at depth y and height z."""
    return np.array([(left * y / DEPTH_M, y, z), (width + right * y / DEPTH_M, y, z)])


def _cornice(house: House, width: float, height: float = 0.22, reach: float = 0.22) -> Shape:
    z = house.wall_m
    return boxes([0.0, -reach, z - height], [width, 0.0, z], house.front.trim, without="back")


def _gable(house: House, width: float, left: float, right: float) -> list[Shape]:
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
    return join([*openings(cell, hole, style, Material.WINDOW, _names(house, 1, 1500)), sides, top])


def _mansard(house: House, width: float, left: float, right: float) -> list[Shape]:
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
    columns = _columns(house, width)
    edge = np.linspace(0, width, columns + 1)
    for x in (edge[:-1] + edge[1:]) / 2:
        if max(left, 0) * 0.2 + 0.7 < x < width + min(right, 0) * 0.2 - 0.7:
            parts.append(moved(_dormer(house, rise / inset), x, 0.16, z + 0.4))
    return parts + _chimneys(house, _along(*ends, DEPTH_M / 2, z + rise))


def _flat_roof(house: House, width: float, left: float, right: float) -> list[Shape]:
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
