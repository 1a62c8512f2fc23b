"""The random parameters of houses, which :mod:`buildings` gives a shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.facades import FrontStyle
from relocbench.datasets.synthetic.town.mesh import Material

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
    uneven: float
    """how much the columns of windows differ in width, as a share of the mean"""
    storeys: tuple[float, float]
    """heights of the windows of the first floor and of the top floor, relative to the others"""
    bays: int
    """storeys of a bay window, 0 for none"""
    plinth_m: float
    """height of the plinth, 0 for none"""
    courses: bool
    """whether a string course marks every floor"""
    strips_m: float
    """width of the strips at both ends of the front, 0 for none"""
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
    tall, terraced = style == "town", style == "terrace"
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
    bays = int(rng.random() < {"terrace": 0.5, "villa": 0.35}.get(style, 0.0))
    bays *= 1 + int(rng.random() < 0.4)
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
        uneven=float(pick([0.0, 0.25, 0.45])),
        storeys=(float(rng.uniform(1.0, 1.18)), float(rng.uniform(0.62, 1.0))),
        bays=bays,
        plinth_m=0.0 if modern and rng.random() < 0.5 else float(rng.uniform(0.3, 0.75)),
        courses=bool(rng.random() < (0.45 if tall else 0.15)),
        strips_m=float(rng.uniform(0.25, 0.5)) if rng.random() < (0.35 if tall or terraced else 0.1) else 0.0,
        variant=int(rng.integers(1, 2**31)),
        seed=int(rng.integers(2**31)),
    )


def terrace_for_rows(rng: np.random.Generator) -> House:
    """A house for rows of identical houses."""
    house = draw_house(rng, "terrace")
    return replace(house, floors=2, dormers=False, chimneys=1, door_at=0.0, front=replace(house.front, bay_m=2.4))


def columns_of(house: House, width: float) -> Array:
    """Edges (C + 1,) of the columns of windows along a front; those of uneven houses mirror each other."""
    count = max(1, round(width / house.front.bay_m))
    share = np.random.default_rng([house.seed, 1]).uniform(-1, 1, count)
    share = 1 + house.uneven * (share + share[::-1]) / 2
    edges: Array = np.concatenate([[0.0], np.cumsum(share) * (width / share.sum())])
    return edges


def door_column(house: House, columns: int) -> int:
    """The column of the door among those of a front."""
    if house.shop and columns >= 3:
        return 0 if house.door_at < 0.5 else columns - 1
    return min(int(house.door_at * columns), columns - 1)


def door_x(house: House, width: float) -> float:
    """Position of the door's middle along the front."""
    edges = columns_of(house, width)
    column = door_column(house, len(edges) - 1)
    return float(edges[column] + edges[column + 1]) / 2
