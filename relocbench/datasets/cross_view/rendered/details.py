"""Details that only aerial views show, on roofs and in yards, so that no two houses look alike to a drone.

The towns were designed for drives, whose datasets do not contain these details: windows, solar panels and machines on
roofs; sheds, terraces, beds, hedges and parking in the yards. They are placed only where rays from above hit a flat
part of a roof or a free lawn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.cross_view.rendered.flight import nearest_street
from relocbench.datasets.cross_view.rendered.places import buildings
from relocbench.datasets.synthetic.conditions.presets import SPLITS
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.raycast import NOTHING, Scene
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, instances, join, quads
from relocbench.datasets.synthetic.town.town import District
from relocbench.geometry import make_transform

_FROM_M = 80.0
"""height at which rays begin, above all roofs"""
_FIRST_INSTANCE = 2**30
_TRIES_PER_ROOF, _MOST_PER_ROOF = 14, 5
_AREA_PER_TRY_M2 = 35.0
"""area of the town per attempt to place a detail in a yard"""
_LAWN_UV_SCALE = 0.07
"""stretches the lawns' pattern, whose 1.7 m tile would be visible as a grid from above"""


@dataclass(frozen=True, eq=False)
class _Detail:
    """A shape around the origin, and half the sides of the rectangle of ground that it needs."""

    shape: Shape
    half: tuple[float, float]
    semantic: Semantic


def with_aerial_details(district: District) -> District:
    """The town with details on roofs and in yards, and lawns without a visible grid. Deterministic in the town."""
    rng = np.random.default_rng([district.seed, SPLITS.index(district.split), 41])
    probe = _Probe(district.static)
    placed = [*_on_roofs(district, probe, rng), *_in_yards(district, probe, rng)]
    meshes = [
        instances(detail.shape, transform[None], [_FIRST_INSTANCE + k], [rng.integers(1, 2**31)], detail.semantic)
        for k, (detail, transform) in enumerate(placed)
    ]
    return replace(district, static=merge([_lawns(district.static), *meshes]))


def _lawns(mesh: Mesh) -> Mesh:
    uv = mesh.uv.copy()
    lawn = (mesh.material == Material.GRASS) & (mesh.semantic == Semantic.TERRAIN)
    uv[lawn] *= np.float32(_LAWN_UV_SCALE)
    return replace(mesh, uv=uv)


class _Probe:
    """Casts rays straight down on a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.scene = Scene(mesh)

    def plane(self, middle: Array, along: Array, half: tuple[float, float]) -> tuple[int, Array, float] | None:
        """Material, unit normal and height of the single plane below a rectangle; None if there is no such plane.

        ``along`` (2,) is the direction of the rectangle's first side.
        """
        across = np.array([-along[1], along[0]])
        steps = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=float) * half
        points = middle + steps @ np.stack([along, across])
        rays = np.column_stack([points, np.full(9, _FROM_M), np.zeros((9, 2)), np.full(9, -1.0)]).astype(np.float32)
        hit = self.scene.closest(rays)
        if (hit == NOTHING).any():
            return None
        material = self.mesh.material[hit]
        corners = self.mesh.vertices[self.mesh.triangles[hit]].astype(np.float64)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        if (material != material[4]).any() or (normal @ normal[4]).min() < 0.999 or normal[4, 2] < 0.3:
            return None
        if (self.mesh.instance[hit] != self.mesh.instance[hit[4]]).any():
            return None
        n = normal[4]
        off = (corners[:, 0] - corners[4, 0]) @ n
        if np.abs(off).max() > 0.02:
            return None
        height = corners[4, 0, 2] - ((middle - corners[4, 0, :2]) @ n[:2]) / n[2]
        return int(material[4]), n, float(height)


def _on_roofs(district: District, probe: _Probe, rng: np.random.Generator) -> list[tuple[_Detail, Array]]:
    found: list[tuple[_Detail, Array]] = []
    for building in buildings(district, every=True):
        taken: list[tuple[Array, float]] = []
        most = int(rng.integers(0, _MOST_PER_ROOF + 1))
        for _ in range(_TRIES_PER_ROOF):
            middle = building.centre + rng.uniform(-0.5, 0.5, 2) * building.sides_m
            kind = float(rng.random())
            sizes = rng.random(3)
            if len(taken) >= most:
                continue
            spot = probe.plane(middle, np.array([1.0, 0.0]), (0.1, 0.1))
            if spot is None or spot[0] not in (Material.ROOF_TILES, Material.ROOF_FLAT):
                continue
            if spot[1][2] < 0.97:
                along = np.array([-spot[1][1], spot[1][0]]) / float(np.hypot(*spot[1][:2]))
                detail = _on_slope(kind, sizes)
            else:
                along = nearest_street(middle, district.network)[1]
                detail = _on_flat(kind, sizes)
            room = (detail.half[0] + 0.2, detail.half[1] * float(spot[1][2]) + 0.2)
            if _place(probe, middle, along, room, taken, spot[0]) is not None:
                found.append((detail, _frame(middle, spot[2], along, spot[1])))
    return found


def _in_yards(district: District, probe: _Probe, rng: np.random.Generator) -> list[tuple[_Detail, Array]]:
    found: list[tuple[_Detail, Array]] = []
    taken: list[tuple[Array, float]] = []
    low, high = district.network.nodes.min(0) - 12.0, district.network.nodes.max(0) + 12.0
    for _ in range(int(np.prod(high - low) / _AREA_PER_TRY_M2)):
        middle, kind, sizes = rng.uniform(low, high), float(rng.random()), rng.random(3)
        _, along = nearest_street(middle, district.network)
        detail = _in_yard(kind, sizes)
        room = (detail.half[0] + 0.4, detail.half[1] + 0.4)
        height = _place(probe, middle, along, room, taken, Material.GRASS)
        if height is not None:
            found.append((detail, _frame(middle, height, along, np.array([0.0, 0.0, 1.0]))))
    return found


def _place(
    probe: _Probe,
    middle: Array,
    along: Array,
    room: tuple[float, float],
    taken: list[tuple[Array, float]],
    material: int,
) -> float | None:
    """Height at which a detail fits on a plane of the material, or None; its circle is added to ``taken``."""
    radius = float(np.hypot(*room))
    if any(np.hypot(*(middle - other)) < radius + size for other, size in taken):
        return None
    plane = probe.plane(middle, along, room)
    if plane is None or plane[0] != material:
        return None
    taken.append((middle, radius))
    return plane[2]


def _frame(middle: Array, height: float, along: Array, normal: Array) -> Array:
    """T_world_detail (4, 4): x along the given direction, z along the plane's normal."""
    x = np.array([*along, 0.0])
    return make_transform(np.stack([x, np.cross(normal, x), normal], axis=1), [*middle, height])


def _slab(a: float, b: float, low: float, high: float, material: Material) -> Shape:
    return boxes([-a, -b, low], [a, b, high], material, without="bottom")


def _on_slope(kind: float, sizes: Array) -> _Detail:
    if kind < 0.5:
        return _Detail(_slab(0.4, 0.6, -0.05, 0.06, Material.WINDOW), (0.4, 0.6), Semantic.FURNITURE)
    columns, rows = 2 + int(4 * sizes[0]), 1 + int(2 * sizes[1])
    a, b = 0.55 * columns, 0.85 * rows
    x, y = np.meshgrid(np.linspace(-a, a, columns + 1)[:-1], np.linspace(-b, b, rows + 1)[:-1])
    low = np.stack([x.ravel() + 0.03, y.ravel() + 0.03, np.zeros(x.size)], axis=1)
    panels = boxes(low, low + np.array([1.04, 1.64, 0.1]), Material.CAR_GLASS, without="bottom")
    return _Detail(panels, (a, b), Semantic.FURNITURE)


def _on_flat(kind: float, sizes: Array) -> _Detail:
    if kind < 0.35:
        a, b, h = 0.5 + 1.2 * sizes[0], 0.4 + 0.7 * sizes[1], 0.6 + 1.2 * sizes[2]
        return _Detail(_slab(a, b, 0.0, h, Material.METAL), (a, b), Semantic.FURNITURE)
    if kind < 0.55:
        a, b = 0.5 + 0.6 * sizes[0], 0.5 + 0.3 * sizes[1]
        dome = join([_slab(a, b, 0.0, 0.25, Material.CONCRETE), _slab(a - 0.1, b - 0.1, 0.25, 0.35, Material.WINDOW)])
        return _Detail(dome, (a, b), Semantic.FURNITURE)
    if kind < 0.8:
        count, a = 2 + int(3 * sizes[0]), 1.0 + 1.5 * sizes[1]
        y = np.arange(count) * 1.4 - 0.7 * (count - 1)
        rows = [[(-a, v - 0.4, 0.1), (a, v - 0.4, 0.1), (a, v + 0.4, 0.5), (-a, v + 0.4, 0.5)] for v in y]
        return _Detail(quads(np.array(rows), Material.CAR_GLASS), (a, 0.7 * count), Semantic.FURNITURE)
    a, b = 1.5 + 2.0 * sizes[0], 1.2 + 1.5 * sizes[1]
    material = Material.GRASS if sizes[2] < 0.5 else Material.WOOD
    return _Detail(_slab(a, b, 0.0, 0.06, material), (a, b), Semantic.FURNITURE)


def _in_yard(kind: float, sizes: Array) -> _Detail:
    if kind < 0.25:
        a, b = 1.0 + 1.2 * sizes[0], 0.9 + 0.8 * sizes[1]
        material = Material.WOOD if sizes[2] < 0.6 else Material.ROOF_FLAT
        top = _slab(a + 0.15, b + 0.15, 2.1, 2.25, Material.ROOF_TILES if sizes[2] < 0.3 else Material.ROOF_FLAT)
        return _Detail(join([_slab(a, b, 0.0, 2.1, material), top]), (a + 0.15, b + 0.15), Semantic.FURNITURE)
    if kind < 0.5:
        a, b = 1.2 + 2.5 * sizes[0], 1.0 + 1.5 * sizes[1]
        material = (Material.PAVEMENT, Material.COBBLES, Material.WOOD)[int(3 * sizes[2])]
        return _Detail(_flat(a, b, material), (a, b), Semantic.TERRAIN)
    if kind < 0.68:
        a, b = 1.0 + 2.5 * sizes[0], 0.6 + 1.0 * sizes[1]
        return _Detail(_flat(a, b, Material.SOIL), (a, b), Semantic.TERRAIN)
    if kind < 0.9:
        a = 2.0 + 3.5 * sizes[0]
        detail = _slab(a, 0.4, 0.0, 1.0 + sizes[1], Material.HEDGE)
        if sizes[2] < 0.5:
            turned = detail.vertices[:, [1, 0, 2]] * np.array([-1.0, 1.0, 1.0])
            return _Detail(replace(detail, vertices=turned), (0.4, a), Semantic.HEDGE)
        return _Detail(detail, (a, 0.4), Semantic.HEDGE)
    a, b = 3.0 + 4.0 * sizes[0], 2.5 + 2.5 * sizes[1]
    return _Detail(_flat(a, b, Material.FRESH_ASPHALT), (a, b), Semantic.TERRAIN)


def _flat(a: float, b: float, material: Material) -> Shape:
    """A rectangle on the ground."""
    return quads([[(-a, -b, 0.01), (a, -b, 0.01), (a, b, 0.01), (-a, b, 0.01)]], material)
