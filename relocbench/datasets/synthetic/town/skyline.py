"""The land behind the last houses: hills with woods and fields, distant houses, towers and chimneys.

All of it is geometry with the depth that it has, hundreds of metres to kilometres away; the haze of the air between
makes it pale. It has the class of the land, so that nothing which is computed for the town reaches so far.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.buildings import house_shape
from relocbench.datasets.synthetic.town.houses.house import draw_house
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, instances, join, poses, quads, single, tube
from relocbench.datasets.synthetic.town.vegetation import LOOK_STEP, distant_tree

_RADII_M = np.array([380.0, 560.0, 800.0, 1100.0, 1500.0, 2000.0, 2600.0])
"""distances of the hills' rings from the town's edge"""
_RISE = np.array([0.0, 0.05, 0.16, 0.36, 0.66, 1.0, 0.8])
"""height of each ring, as a share of that of the ridge behind it"""
_AROUND = 240
_RIDGE_DEG = (0.6, 5.4)
"""elevation of ridges as seen from the middle of the town; lower than the sun in any named condition by day"""
_SUBURB_M = (75.0, 330.0)
_HOUSES, _TREES, _GROVES = 26, 340, 26
_FIELDS = (Material.GRASS, Material.GRASS, Material.SOIL, Material.HEDGE)


def skyline(rng: np.random.Generator, edge_m: float, names: Iterator[int]) -> tuple[Mesh, Mesh]:
    """What stands and lies outside a circle of ``edge_m``, and the leaves on it."""
    heights = _ridges(rng, edge_m)
    wood, leaves = _woods(rng, edge_m, heights, names)
    return merge([_hills(rng, edge_m, heights), *_suburb(rng, edge_m, names), *wood]), merge(leaves)


def _ridges(rng: np.random.Generator, edge_m: float) -> Array:
    """Heights (rings, directions) of the hills."""
    turn = 2 * np.pi * np.arange(_AROUND) / _AROUND
    waves = [rng.normal(0, 1 / k) * np.cos(k * turn + rng.uniform(0, 2 * np.pi)) for k in (1, 2, 3, 5, 8, 13)]
    shape = np.sum(waves, axis=0)
    shape = (shape - shape.min()) / np.ptp(shape)
    low, high = np.tan(np.radians(_RIDGE_DEG)) * rng.uniform(0.45, 1.0)
    ridge = (low + (high - low) * shape) * (edge_m + _RADII_M[-2])
    rough = rng.normal(0, 1, (len(_RADII_M), _AROUND))
    rough = (rough + np.roll(rough, 1, axis=1)) * (2.0 * (_RISE > 0.1))[:, None]
    bent = _RISE[:, None] * (1 + 0.2 * np.sin(3 * turn + rng.uniform(0, 6)) * (_RISE < 1)[:, None])
    return np.asarray((ridge * bent + rough).clip(min=-1.0))


def _hills(rng: np.random.Generator, edge_m: float, heights: Array) -> Mesh:
    """Fields and woods on the hills, in pieces of a few directions and one ring each."""
    turn = 2 * np.pi * np.arange(_AROUND) / _AROUND
    flat = (edge_m + _RADII_M)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)[None]
    points = np.concatenate([flat, heights[..., None]], axis=-1)
    after = np.roll(points, -1, axis=1)
    faces = np.stack([points[:-1], points[1:], after[1:], after[:-1]], axis=2)
    pieces = np.repeat(rng.integers(0, len(_FIELDS), (len(_RADII_M) - 1, _AROUND // 4)), 4, axis=1)
    pieces[-2:] = np.where(rng.random(pieces[-2:].shape) < 0.8, len(_FIELDS) - 1, pieces[-2:])
    material = np.array([int(m) for m in _FIELDS])[pieces].ravel()
    look = np.repeat(rng.integers(0, 2**20, (len(_RADII_M) - 1, _AROUND // 4)), 4, axis=1).ravel() * LOOK_STEP
    return single(quads(faces.reshape(-1, 4, 3), material, variant=look), 0, 0, Semantic.TERRAIN)


def _height_at(place: Array, edge_m: float, heights: Array) -> Array:
    """Heights (N,) of the hills at places (N, 2)."""
    far = np.linalg.norm(place, axis=1) - edge_m
    column = np.floor(np.arctan2(place[:, 1], place[:, 0]) / (2 * np.pi) * _AROUND).astype(int) % _AROUND
    ring = np.clip(np.searchsorted(_RADII_M, far, side="right") - 1, 0, len(_RADII_M) - 2)
    part = ((far - _RADII_M[ring]) / (_RADII_M[ring + 1] - _RADII_M[ring])).clip(0, 1)
    between = heights[ring, column] * (1 - part) + heights[ring + 1, column] * part
    return np.asarray(between * (far > _RADII_M[0]))


def _woods(
    rng: np.random.Generator, edge_m: float, heights: Array, names: Iterator[int]
) -> tuple[list[Mesh], list[Mesh]]:
    """Trees in groves, on the plain and on the slopes: wood and needles, and leaves."""
    angle, far = rng.uniform(0, 2 * np.pi, _GROVES), 60 + 900 * rng.random(_GROVES) ** 1.5
    grove = rng.integers(0, _GROVES, _TREES)
    along, across = rng.normal(0, 0.35, _TREES), rng.normal(0, 14.0, _TREES)
    distance = edge_m + np.maximum(far[grove] + across, 60.0)
    turn = angle[grove] + along * 200.0 / distance
    place = distance[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    z = _height_at(place, edge_m, heights)
    size, yaw, evergreen = rng.uniform(0.8, 1.6, _TREES), rng.uniform(0, 2 * np.pi, _TREES), (grove % 4) == 0
    wood: list[Mesh] = []
    leaves: list[Mesh] = []
    for kind in range(3):
        for needles in (False, True):
            rows = np.flatnonzero((np.arange(_TREES) % 3 == kind) & (evergreen == needles))
            if len(rows) == 0:
                continue
            transforms = poses(place[rows, 0], place[rows, 1], z[rows], yaw[rows], size[rows])
            looks = rng.integers(1, 2**20, len(rows)) * LOOK_STEP
            numbers = np.array([next(names) for _ in rows])
            stem, crown = distant_tree(kind, needles)
            wood.append(instances(stem, transforms, numbers, looks, Semantic.TERRAIN))
            (wood if needles else leaves).append(instances(crown, transforms, numbers, looks, Semantic.TERRAIN))
    return wood, leaves


def _suburb(rng: np.random.Generator, edge_m: float, names: Iterator[int]) -> Iterator[Mesh]:
    """Houses, blocks of flats, a church and chimneys outside the town."""
    for k in range(_HOUSES):
        angle, far = 2 * np.pi * (k + rng.random()) / _HOUSES, rng.uniform(*_SUBURB_M)
        kind = ("villa", "terrace", "town", "modern")[int(rng.integers(4))]
        house = draw_house(rng, kind)
        house = replace(house, front=replace(house.front, balconies=0.0))
        if kind == "modern":
            house = replace(house, floors=int(rng.integers(5, 13)))
        shape = house_shape(house, float(rng.uniform(9.0, 22.0)))
        place = (edge_m + far) * np.array([np.cos(angle), np.sin(angle)])
        yaw = angle - np.pi / 2 + rng.normal(0, 0.5)
        yield _put(shape, place, float(yaw), next(names), house.variant)
    for shape in (_church(), *(_chimney(h) for h in rng.uniform(28, 55, int(rng.integers(0, 3))))):
        angle = rng.uniform(0, 2 * np.pi)
        place = (edge_m + rng.uniform(*_SUBURB_M)) * np.array([np.cos(angle), np.sin(angle)])
        yield _put(shape, place, rng.uniform(0, np.pi), next(names), int(rng.integers(1, 2**31)))


def _put(shape: Shape, place: Array, yaw: float, name: int, look: int) -> Mesh:
    transform = poses(place[0], place[1], 0.0, yaw)
    return instances(shape, transform, np.array([name]), np.array([look]), Semantic.TERRAIN)


def _church() -> Shape:
    """A tower with a spire."""
    half, eave, top = 3.2, 26.0, 46.0
    tower = boxes([-half, -half, 0.0], [half, half, eave], Material.STONE, without="bottom")
    corners = np.array([(-half, -half, eave), (half, -half, eave), (half, half, eave), (-half, half, eave)]) * 1.0
    tip = np.array([0.0, 0.0, top])
    spire = quads([[corners[k], corners[(k + 1) % 4], tip, tip] for k in range(4)], Material.ROOF_FLAT)
    openings = boxes(
        [[-0.9, -half - 0.05, 19.0], [-half - 0.05, -0.9, 19.0]],
        [[0.9, half + 0.05, 23.0], [half + 0.05, 0.9, 23.0]],
        Material.ROOF_FLAT,
    )
    nave = boxes([half, -4.5, 0.0], [half + 24.0, 4.5, 9.0], Material.STONE, without="bottom")
    ridge = np.array([(half, 0.0, 15.0), (half + 24.0, 0.0, 15.0)])
    low = np.array([(half, -4.9, 8.8), (half + 24.0, -4.9, 8.8), (half, 4.9, 8.8), (half + 24.0, 4.9, 8.8)])
    roof = quads([[low[0], low[1], ridge[1], ridge[0]], [low[3], low[2], ridge[0], ridge[1]]], Material.ROOF_TILES)
    gable = quads([[low[1], low[3], ridge[1], ridge[1]]], Material.STONE)
    return join([tower, spire, openings, nave, roof, gable])


def _chimney(height: float) -> Shape:
    """The chimney of a factory."""
    return tube([[0.0, 0.0, 0.0], [0.0, 0.0, height]], [2.0, 1.2], 10, Material.BRICK)
