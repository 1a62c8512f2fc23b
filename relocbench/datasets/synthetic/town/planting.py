"""Objects on pavements, in gardens, on the square and on the outskirts: plants and street furniture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from relocbench.arrays import Array, Floats, Indices
from relocbench.datasets.synthetic.town import furniture
from relocbench.datasets.synthetic.town.ageing import Rows, no_rows
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.town.network import LANE_M, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import edge_frame, inside, offset_loop
from relocbench.datasets.synthetic.town.rows import PERIOD_M, Plot
from relocbench.datasets.synthetic.town.shapes import Shape, at_height, instances, poses, quads, single
from relocbench.datasets.synthetic.town.streets import KERB_M, Block
from relocbench.datasets.synthetic.town.vegetation import (
    LOOK_STEP,
    STREET_TYPES,
    TREE_TYPES,
    evergreen,
    hedge_shapes,
    tree_shapes,
)

_ON_PAVEMENT_M = KERB_M + 0.004
"""height of soil around trees and of paths in gardens"""
_SLIM = (2, 3, 5)
"""kinds of trees for narrow pavements"""
_APART = 3.0
"""how far trees differ in when they shed: the time from the first to the last tree, in times that one tree takes"""
_LAST = 1 - 1e-6
"""largest rank, so that all leaves are there in summer"""


@dataclass(eq=False)
class Planting:
    """Collects objects by shape, so that each shape becomes one mesh with many copies."""

    rng: np.random.Generator
    names: Iterator[int]
    static: list[Mesh] = field(default_factory=list)
    foliage: list[Mesh] = field(default_factory=list)
    lamps: list[Array] = field(default_factory=list)
    trees: list[tuple[float, float, float, float, int, bool]] = field(default_factory=list)
    """x, y, yaw, scale, kind, coarse"""
    things: dict[Semantic, list[tuple[Shape, Array, int]]] = field(default_factory=dict)
    bins: Rows = field(default_factory=no_rows)
    """those of households, once finished"""
    near: list[Rows] = field(default_factory=list)
    """trees that are not coarse, by kind, once finished"""

    def add(self, shape: Shape, place: Array, facing: Array, semantic: Semantic, variant: int | None = None) -> Array:
        """Add an object at (2,) on the pavement that faces a direction (2,); returns its transform (4, 4)."""
        transform: Array = poses(place[0], place[1], KERB_M, np.arctan2(facing[1], facing[0]))[0]
        look = int(self.rng.integers(1, 2**31)) if variant is None else variant
        self.things.setdefault(semantic, []).append((shape, transform, look))
        return transform

    def lamp(self, place: Array, facing: Array, variant: int | None = None) -> None:
        transform = self.add(furniture.lamp_post(), place, facing, Semantic.POLE, variant)
        self.lamps.append((transform @ np.append(furniture.LAMP_HEAD, 1))[:3])

    def tree(self, place: Array, kind: int, scale: float, coarse: bool = False) -> None:
        yaw = float(self.rng.uniform(0, 2 * np.pi))
        self.trees.append((float(place[0]), float(place[1]), yaw, scale, kind, coarse))

    def hedge(self, start: Array, end: Array, height: float) -> None:
        length = float(np.linalg.norm(end - start))
        if length < 0.8:
            return
        core, leaves = hedge_shapes(length, height, int(self.rng.integers(2**31)))
        transform = poses(start[0], start[1], KERB_M, np.arctan2(*(end - start)[::-1]))
        name, look = np.array([next(self.names)]), self._looks(1)
        self.static.append(instances(core, transform, name, look, Semantic.HEDGE))
        self.foliage.append(instances(leaves, transform, name, look, Semantic.HEDGE))

    def places(self) -> Array:
        """(N, 2) ground points of the objects and trees that are collected."""
        things = [T[:2, 3] for entries in self.things.values() for _, T, _ in entries]
        return np.array([*things, *(tree[:2] for tree in self.trees)]).reshape(-1, 2)

    def finish(self) -> tuple[list[Mesh], list[Mesh]]:
        """The meshes of all collected objects: static ones and foliage."""
        for semantic, entries in self.things.items():
            by_shape: dict[int, list[tuple[Shape, Array, int]]] = {}
            for entry in entries:
                by_shape.setdefault(id(entry[0]), []).append(entry)
            for group in by_shape.values():
                numbers = np.array([next(self.names) for _ in group])
                transforms, looks = np.stack([t for _, t, _ in group]), np.array([v for _, _, v in group])
                if group[0][0] is furniture.wheeled_bin():
                    self.bins = Rows(numbers, transforms, np.zeros_like(numbers))
                self.static.append(instances(group[0][0], transforms, numbers, looks, semantic))
        for kind, coarse in sorted({(t[4], t[5]) for t in self.trees}):
            rows = np.array([t[:4] for t in self.trees if (t[4], t[5]) == (kind, coarse)])
            transforms = poses(rows[:, 0], rows[:, 1], KERB_M, rows[:, 2], rows[:, 3])
            numbers = np.array([next(self.names) for _ in rows])
            looks = self._looks(len(rows))
            if not coarse:
                self.near.append(Rows(numbers, transforms, np.full(len(numbers), kind)))
            wood, leaves = tree_shapes(kind, coarse)
            self.static.append(instances(wood, transforms, numbers, looks, Semantic.TREE))
            crowns = instances(leaves, transforms, numbers, looks, Semantic.TREE)
            if evergreen(kind):
                self.static.append(replace(crowns, rank=np.zeros_like(crowns.rank)))
            else:
                self.foliage.append(replace(crowns, rank=self._shed_in_turn(crowns.rank.reshape(len(rows), -1))))
        return self.static, self.foliage

    def _looks(self, count: int) -> Indices:
        """Variants (count,) of plants."""
        return self.rng.integers(1, 2**31 // LOOK_STEP, count) * LOOK_STEP

    def _shed_in_turn(self, rank: Floats) -> Floats:
        """Ranks (N leaves,) from those within each tree (N, leaves), so that some trees are bare before others.

        With x = rank + w t for a tree's own t in (0, 1), the new rank is the share of leaves with a smaller x, so that
        a share f of all leaves is present when the foliage is f.
        """
        x = rank + _APART * self.rng.random(len(rank))[:, None]
        rising, falling = x**2 / (2 * _APART), 1 - (1 + _APART - x) ** 2 / (2 * _APART)
        share = np.where(x < 1, rising, np.where(x < _APART, (x - 0.5) / _APART, falling))
        return np.asarray(share.ravel().clip(max=_LAST), dtype=np.float32)


def _kerb_section(network: StreetNetwork, block: Block, i: int) -> tuple[Array, Array, Array, float, float]:
    """The kerb along a block's edge: a point on the kerb line at the edge's start, the directions along it and into the
    block, and the section (from, to) in metres that is clear of crossings."""
    u, v = block.edge(i)
    d, inward, length = edge_frame(network.nodes[u], network.nodes[v])
    first, last = block.straight(i, network.nodes[u], d)
    start = max(first + 1.5, 13.5 if network.degree(u) > 2 else 0.0)
    end = min(last - 1.5, length - (13.5 if network.degree(v) > 2 else 0.0))
    return network.nodes[u] + network.kerb[(u, v)] * inward, d, inward, start, end


def line_streets(planting: Planting, network: StreetNetwork, block: Block, phase: Array | None) -> None:
    """Add trees, lamps, signs, benches, bins and bollards along the kerb.

    A periodic side has only lamps, a whole number of periods apart, starting from ``phase`` (2,).
    """
    rng = planting.rng
    kind_of: dict[int, int] = {}
    for i in range(len(block.face)):
        side = block.sides[i]
        origin, d, inward, start, end = _kerb_section(network, block, i)
        if side.style == "periodic" and phase is not None:
            first = float((phase - origin) @ d) % (4 * PERIOD_M)
            for s in np.arange(first, end, 4 * PERIOD_M):
                if s > start:
                    planting.lamp(origin + s * d + 0.45 * inward, -inward, variant=1)
            continue
        kind = kind_of.setdefault(side.variant, int(rng.integers(STREET_TYPES)))
        kind = kind if side.pavement_m > 3.5 else _SLIM[kind % len(_SLIM)]
        leafy = side.pavement_m > 2.7 and side.variant % 4 != 0
        gap = 8.0 + side.variant % 5
        taken = []
        for s in np.arange(start + 2.0, end - 1.0, gap) if leafy else []:
            place = origin + s * d + 1.05 * inward
            planting.tree(place, kind, float(rng.uniform(0.85, 1.1)))
            planting.static.append(_tree_pit(place, d))
            taken.append(s)
        for s in np.arange(start + 1.0 + 9.0 * rng.random(), end, 23.0):
            near = [t for t in taken if abs(t - s) < 1.6]
            planting.lamp(origin + (s + 2.2 * bool(near)) * d + 0.45 * inward, -inward)
            taken.append(s + 2.2 * bool(near))
        _scatter(planting, network, block, i, taken)
        _signs(planting, network, block, i)


def free_places(network: StreetNetwork, block: Block, taken: Array) -> list[Array]:
    """Transforms (4, 4) of places on the pavement, 1.5 m from kerbs without a parking lane, away from ``taken`` (N, 2).

    x is along the kerb, z up from the pavement.
    """
    found = []
    for i in range(len(block.face)):
        if network.kerb[block.edge(i)] > LANE_M + 0.1 or block.sides[i].style in ("periodic", "square"):
            continue
        origin, d, inward, start, end = _kerb_section(network, block, i)
        for s in np.arange(start + 3.0, end - 3.0, 7.0):
            place = origin + s * d + 1.5 * inward
            if (np.linalg.norm(taken - place, axis=1) > 2.7).all():
                found.append(poses(place[0], place[1], KERB_M, np.arctan2(d[1], d[0]))[0])
    return found


def _tree_pit(place: Array, d: Array) -> Mesh:
    """A square of bare soil around a trunk."""
    n = np.array([-d[1], d[0]])
    corners = np.array([place + 0.65 * (a * d + b * n) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return single(quads(at_height(corners, _ON_PAVEMENT_M), Material.SOIL), 0, 5, Semantic.TERRAIN)


def _scatter(planting: Planting, network: StreetNetwork, block: Block, i: int, taken: list[float]) -> None:
    """Add benches, bins, bollards and a few shelters in free places."""
    rng = planting.rng
    origin, d, inward, start, end = _kerb_section(network, block, i)
    wide = block.sides[i].pavement_m > 2.5
    for s in np.arange(start + 1.0, end - 1.0, 5.5):
        s = s + rng.uniform(-1.5, 1.5)
        draw = rng.random()
        clear = 3.2 if draw < 0.03 else 1.6
        if any(abs(t - s) < clear for t in taken):
            continue
        place = origin + s * d
        if draw < 0.03 and block.sides[i].pavement_m > 3.5:
            planting.add(furniture.shelter(), place + 1.5 * inward, -inward, Semantic.FURNITURE)
        elif draw < 0.12 and wide:
            planting.add(furniture.bench(), place + 0.7 * inward, inward, Semantic.FURNITURE)
        elif draw < 0.22:
            planting.add(furniture.bin_shape(), place + 0.55 * inward, -inward, Semantic.FURNITURE)
        elif draw < 0.34 and block.sides[i].style in ("terrace", "villa"):
            planting.add(furniture.wheeled_bin(), place + 0.6 * inward, -inward, Semantic.FURNITURE)
        elif draw < 0.44:
            for k in range(4):
                beside = place + (1.2 * k - 1.8) * d + 0.35 * inward
                planting.add(furniture.bollard(), beside, -inward, Semantic.FURNITURE)
        elif draw < 0.48 and block.sides[i].pavement_m > 3.5:
            planting.add(furniture.column(), place + 1.15 * inward, -inward, Semantic.FURNITURE)
        else:
            continue
        taken.append(s)


def _signs(planting: Planting, network: StreetNetwork, block: Block, i: int) -> None:
    """Add signs that face the traffic on this side, one before the crossing and some elsewhere."""
    rng = planting.rng
    u, _ = block.edge(i)
    origin, d, inward, start, end = _kerb_section(network, block, i)

    def add_sign(s: float) -> None:
        sign = furniture.sign(int(rng.integers(furniture.SIGN_KINDS)))
        planting.add(sign, origin + s * d + 0.5 * inward, d, Semantic.SIGN)

    if network.degree(u) > 2 and rng.random() < 0.8:
        add_sign(start - 2.0)
    if rng.random() < 0.5 and end - start > 8:
        add_sign(rng.uniform(start + 3.0, end - 3.0))


def plant_gardens(planting: Planting, block: Block, plots: list[Plot]) -> None:
    """Add hedges in front of gardens, with a gap and a path for every door, and trees in gardens and yards."""
    count = len(block.face)
    for i in range(count):
        side = block.sides[i]
        if side.garden_m < 1.0:
            continue
        a, b = block.pavement[i], block.pavement[(i + 1) % count]
        d, inward, length = edge_frame(a, b)
        doors = sorted(float((p.door - a) @ d) for p in plots if p.edge == i)
        ends = [0.4, *(x + o for x in doors for o in (-0.8, 0.8)), length - 0.4]
        height = float(planting.rng.uniform(0.8, 1.5))
        for start, end in zip(ends[::2], ends[1::2], strict=True):
            planting.hedge(a + start * d + 0.45 * inward, a + end * d + 0.45 * inward, height)
        for x in doors:
            rim = ((-0.6, 0), (0.6, 0), (0.6, side.garden_m), (-0.6, side.garden_m))
            corners = np.array([a + (x + e) * d + y * inward for e, y in rim])
            path = quads(at_height(corners, _ON_PAVEMENT_M), Material.PAVEMENT)
            planting.static.append(single(path, 0, 6, Semantic.PAVEMENT))
        if side.garden_m > 3.0:
            for x in np.arange(3.0, length - 3.0, 9.0):
                if planting.rng.random() < 0.5 and all(abs(x - door) > 1.5 for door in doors):
                    planting.tree(a + x * d + 2.1 * inward, 5, float(planting.rng.uniform(0.6, 0.8)))
    if block.kind == "houses":
        _yard_trees(planting, block)


def _yard_trees(planting: Planting, block: Block) -> None:
    """Add a tree per 250 square metres behind the houses."""
    yard = offset_loop(block.building, [13.0] * len(block.building))
    low, high = yard.min(0), yard.max(0)
    for place in planting.rng.uniform(low, high, (max(2, int(np.prod(high - low) / 250)), 2)):
        if inside(yard, place):
            kind, scale = int(planting.rng.integers(TREE_TYPES)), float(planting.rng.uniform(0.9, 1.3))
            planting.tree(place, kind, scale, coarse=True)


def plant_square(planting: Planting, block: Block) -> None:
    """Add a fountain in the middle of a square, with benches and bollards around it and trees along the edge."""
    rng = planting.rng
    middle = block.pavement.mean(0)
    planting.add(furniture.fountain(), middle, np.array([1.0, 0.0]), Semantic.FURNITURE)
    inner = offset_loop(block.pavement, [6.0] * len(block.pavement))
    kind = int(rng.integers(STREET_TYPES))
    for k in range(len(inner)):
        a, b = inner[k], inner[(k + 1) % len(inner)]
        d, toward, length = edge_frame(a, b)
        for s in np.arange(2.0, length - 1.0, 7.0):
            planting.tree(a + s * d, kind, float(rng.uniform(0.9, 1.1)))
            planting.static.append(_tree_pit(a + s * d, d))
            if rng.random() < 0.6 and s + 3.5 < length:
                planting.add(furniture.bench(), a + (s + 3.5) * d, toward, Semantic.FURNITURE)
    planting.add(furniture.column(), inner[0] + 0.25 * (middle - inner[0]), np.array([1.0, 0.0]), Semantic.FURNITURE)
    for angle in np.linspace(0, 2 * np.pi, 9)[:-1]:
        out = np.array([np.cos(angle), np.sin(angle)])
        planting.add(furniture.bollard(), middle + 4.2 * out, out, Semantic.FURNITURE)
        if round(angle / (np.pi / 4)) % 2 == 0:
            planting.add(furniture.bench(), middle + 5.6 * out, -out, Semantic.FURNITURE)


def plant_outskirts(planting: Planting, block: Block) -> None:
    """Add three loose belts of trees behind the outermost houses, which block the view between them."""
    for distance, gap, scale in ((15.0, 11.0, 1.2), (26.0, 11.0, 1.6), (42.0, 13.0, 2.1)):
        line = offset_loop(block.building, [distance] * len(block.building))
        for k in range(len(line)):
            a, b = line[k], line[(k + 1) % len(line)]
            length = float(np.linalg.norm(b - a))
            for s in np.arange(0.0, length, gap):
                place = a + (b - a) * s / length + planting.rng.normal(0, 1.2, 2)
                kind = int(planting.rng.integers(TREE_TYPES))
                planting.tree(place, kind, scale * float(planting.rng.uniform(0.85, 1.25)), coarse=True)
