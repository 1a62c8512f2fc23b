"""Blocks with their sides, and the ground: road, kerbs, pavements, gardens, markings and zebra crossings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M, HalfEdge, StreetNetwork, frontages
from relocbench.datasets.synthetic.town.polylines import (
    arc_at,
    arc_lengths,
    area,
    edge_frame,
    loop_turns,
    offset_loop,
    points_at,
)
from relocbench.datasets.synthetic.town.shapes import Shape, ear_clip, join, quads, single, triangle_shape

KERB_M = 0.12
"""height of pavements above the road"""
MARKING_M = 0.004
"""height of markings above the road"""
HORIZON_M = 3000.0
_KERB_TOP_M = 0.18
_CORNER_ROOM_M = 21.0
"""length of a side that the crossing and the corner house take"""


@dataclass(frozen=True)
class Side:
    """One side of a block: consecutive edges without a corner, built in the same style."""

    style: str
    """terrace, town, villa, modern, periodic or square (no houses)"""
    pavement_m: float
    garden_m: float
    """depth of the front gardens between pavement and houses; 0 for none"""
    variant: int


@dataclass(frozen=True, eq=False)
class Block:
    """The area between streets. All loops follow the face's nodes, with the block on the left."""

    face: tuple[int, ...]
    kind: str
    """houses, square or outside"""
    sides: tuple[Side, ...]
    """(P,) side of the edge from node i to the next"""
    kerb: Array
    """(P, 2) corners of the kerb line before rounding"""
    kerb_arcs: tuple[Array, ...]
    """(K_i, 2) arc of each rounded corner"""
    pavement: Array
    """(P, 2) inner edge of the pavement"""
    building: Array
    """(P, 2) building line, where the houses begin"""
    turns: Array
    """(P,) turn at each corner in radians, left positive"""

    def edge(self, i: int) -> HalfEdge:
        return self.face[i], self.face[(i + 1) % len(self.face)]

    def straight(self, i: int, origin: Array, d: Array) -> tuple[float, float]:
        """Section of edge ``i`` with a straight kerb, in metres from ``origin`` (2,) in direction ``d`` (2,)."""
        before, after = self.kerb_arcs[i], self.kerb_arcs[(i + 1) % len(self.face)]
        return float((before[-1] - origin) @ d), float((after[0] - origin) @ d)


def make_block(network: StreetNetwork, face: tuple[int, ...], kind: str, sides: dict[HalfEdge, Side]) -> Block:
    """Compute the lines of a block from the network's kerbs and its sides' widths."""
    count = len(face)
    edges = [(face[i], face[(i + 1) % count]) for i in range(count)]
    of_edge = tuple(sides[e] for e in edges)
    centre = network.nodes[list(face)]
    turns = loop_turns(centre)
    kerb_m = [network.kerb[e] for e in edges]
    pavement_m = [k + s.pavement_m for k, s in zip(kerb_m, of_edge, strict=True)]
    building_m = [p + s.garden_m for p, s in zip(pavement_m, of_edge, strict=True)]
    kerb = offset_loop(centre, kerb_m)
    arcs = tuple(
        arc_at(kerb[i - 1], kerb[i], kerb[(i + 1) % count], network.kerb_radius(face, i, turns[i]))
        for i in range(count)
    )
    pavement, building = offset_loop(centre, pavement_m), offset_loop(centre, building_m)
    return Block(face, kind, of_edge, kerb, arcs, pavement, building, turns)


def make_blocks(network: StreetNetwork, rng: np.random.Generator, periodic: int) -> tuple[Block, ...]:
    """All blocks with random styles; both sides of the street ``periodic`` get repeating facades."""
    square = _square_face(network, periodic)
    blocks = []
    for k, face in enumerate(network.faces):
        kind = "square" if k == square else "outside" if k == len(network.faces) - 1 else "houses"
        sides: dict[HalfEdge, Side] = {}
        for group in frontages(network.nodes, face):
            is_periodic = any(network.street[e] == periodic for e in group)
            style = "square" if kind == "square" else "terrace" if is_periodic else _draw_style(rng)
            variant = int(rng.integers(1, 2**31))
            parking = network.kerb[group[0]] > LANE_M + 0.1
            widths = (2.2, 2.8) if parking else (2.6, 3.8)
            pavement_m = 3.0 if is_periodic else float(rng.choice(widths)) + 1.4 * (style == "town")
            garden_m = {"villa": 4.0, "modern": 2.0 * float(rng.random() < 0.5)}.get(style, 0.0)
            for edge in group:
                own = "periodic" if network.street[edge] == periodic else style
                sides[edge] = Side(own, pavement_m, garden_m, variant)
        blocks.append(make_block(network, face, kind, sides))
    return tuple(blocks)


def _draw_style(rng: np.random.Generator) -> str:
    return str(rng.choice(["terrace", "town", "villa", "modern"], p=[0.33, 0.37, 0.18, 0.12]))


def _square_face(network: StreetNetwork, periodic: int) -> int:
    """The smallest block that is not the outside and does not adjoin the periodic street."""
    sizes = {}
    for k, face in enumerate(network.faces[:-1]):
        edges = zip(face, (*face[1:], face[0]), strict=True)
        if all(network.street[e] != periodic for e in edges):
            sizes[k] = abs(area(network.nodes[list(face)]))
    return min(sizes, key=lambda k: sizes[k])


def periodic_street(network: StreetNetwork) -> int:
    """The straight street whose two sides have the most room for houses between the corners."""
    room: dict[int, float] = {}
    for face in network.faces:
        for group in frontages(network.nodes, face):
            for k, edge in enumerate(group):
                length = float(np.linalg.norm(network.nodes[edge[1]] - network.nodes[edge[0]]))
                corners = (k == 0) + (k == len(group) - 1)
                name = network.street[edge]
                room[name] = room.get(name, 0.0) + length - _CORNER_ROOM_M * corners
    pieces = list(network.street.values())
    straight = [name for name in room if pieces.count(name) == 2]
    return max(straight or sorted(room), key=lambda name: room[name])


def ground(network: StreetNetwork, blocks: tuple[Block, ...]) -> Mesh:
    """All flat surfaces: the road plane, raised pavements and blocks, the land to the horizon, and road markings."""
    paint = join(_markings(network, blocks))
    return merge(
        [
            single(_road(network), 0, 1, Semantic.ROAD),
            *(single(_pavement(block), 0, 2, Semantic.PAVEMENT) for block in blocks),
            *(
                single(_inside(block), 0, 3, Semantic.PAVEMENT if block.kind == "square" else Semantic.TERRAIN)
                for block in blocks
            ),
            single(paint, 0, 4, Semantic.MARKING),
        ]
    )


def _flat(points: Array, z: float) -> Array:
    """Points (..., 2) at height z: (..., 3)."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)


def _road(network: StreetNetwork) -> Shape:
    low, high = network.nodes.min(0) - 30.0, network.nodes.max(0) + 30.0
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return quads(_flat(corners, 0.0), Material.ASPHALT)


def _pavement(block: Block) -> Shape:
    """Kerb stones and the pavement of a block."""
    count = len(block.face)
    outline = np.concatenate(block.kerb_arcs)
    inner = _inset(outline, _KERB_TOP_M)
    after = np.roll(np.arange(len(outline)), -1)
    run = np.concatenate([[0], np.cumsum(np.linalg.norm(outline[after] - outline, axis=1))])
    low, high, top = _flat(outline, 0.0), _flat(outline, KERB_M), _flat(inner, KERB_M)
    face = np.stack([low, low[after], high[after], high], axis=1)
    cap = np.stack([high, high[after], top[after], top], axis=1)
    u = np.stack([run[:-1], run[1:], run[1:], run[:-1]], axis=1)
    face_uv = np.stack([u, np.broadcast_to([0, 0, KERB_M, KERB_M], u.shape)], axis=2)
    cap_uv = np.stack([u, np.broadcast_to([0, 0, _KERB_TOP_M, _KERB_TOP_M], u.shape) + KERB_M], axis=2)
    sizes = [len(a) for a in block.kerb_arcs]
    corner = np.repeat(np.arange(count), sizes)
    slabs = []
    for i in range(len(outline)):
        j = (i + 1) % len(outline)
        a, b = corner[i], corner[j]
        slabs.append([top[i], top[j], *_flat(block.pavement[[b, a]], KERB_M)])
    return join(
        [
            quads(face, Material.KERB, face_uv),
            quads(cap, Material.KERB, cap_uv),
            quads(np.array(slabs), Material.COBBLES if block.kind == "square" else Material.PAVEMENT),
        ]
    )


def _inset(outline: Array, distance: float) -> Array:
    """A closed, finely rounded outline with each point moved left by the distance along its own normal."""
    ahead, behind = np.roll(outline, -1, axis=0) - outline, outline - np.roll(outline, 1, axis=0)
    unit = ahead / np.linalg.norm(ahead, axis=1, keepdims=True) + behind / np.linalg.norm(behind, axis=1, keepdims=True)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-9)
    return outline + distance * np.stack([-unit[:, 1], unit[:, 0]], axis=1)


def _inside(block: Block) -> Shape:
    """The ground behind the pavement: gardens and yards, or for the outside the land to the horizon."""
    material = Material.COBBLES if block.kind == "square" else Material.GRASS
    points = block.pavement
    if block.kind != "outside":
        return triangle_shape(_flat(points, KERB_M), ear_clip(points), material)
    far = points / np.linalg.norm(points, axis=1, keepdims=True) * HORIZON_M
    after = np.roll(np.arange(len(points)), -1)
    near_3d, far_3d = _flat(points, KERB_M), _flat(far, KERB_M)
    return quads(np.stack([near_3d, near_3d[after], far_3d[after], far_3d], axis=1), material)


def _strip(points: Array, forward: Array, length: float, width: float) -> Array:
    """Painted rectangles (N, 4, 3) centred on points (N, 2), with ``length`` along unit directions (N, 2)."""
    ahead = forward * (length / 2)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1) * (width / 2)
    corners = [points - ahead - left, points + ahead - left, points + ahead + left, points - ahead + left]
    return _flat(np.stack(corners, axis=1), MARKING_M)


def _markings(network: StreetNetwork, blocks: tuple[Block, ...]) -> list[Shape]:
    """Dashed centre lines, stop lines, zebra crossings, and the lines of parking bays."""
    paint = []
    for name in sorted(set(network.street.values())):
        line = network.centre_line(name)
        at = arc_lengths(line)
        s = np.arange(16.0, at[-1] - 16.0, 6.0)
        place, ahead = points_at(line, at, s), points_at(line, at, s + 0.5)
        forward = (ahead - place) / np.linalg.norm(ahead - place, axis=1, keepdims=True)
        if len(s):
            paint.append(quads(_strip(place, forward, 3.0, 0.12), Material.LANE_MARKING))
    for edge in sorted(network.street):
        if network.degree(edge[1]) > 2:
            paint.append(_approach(network, edge, edge in network.zebras))
    for block in blocks:
        for _, place, direction in bays_of(network, block):
            across = np.array([-direction[1], direction[0]])
            ends = np.stack([place - 2.9 * direction, place + 2.9 * direction])
            line = _strip(ends, np.stack([across, across]), PARKING_M - 0.1, 0.09)
            paint.append(quads(line, Material.LANE_MARKING))
    return paint


def _approach(network: StreetNetwork, edge: HalfEdge, zebra: bool) -> Shape:
    """The stop line of the lane towards the crossing ``edge[1]`` and, with ``zebra``, a zebra across the road."""
    end = network.nodes[edge[1]]
    d = network.nodes[edge[0]] - end
    d /= np.linalg.norm(d)
    to_left = np.array([d[1], -d[0]])
    left_m, right_m = network.kerb[edge], network.kerb[(edge[1], edge[0])]
    clear = 11.2
    stop = end + (clear + 5.0 * zebra) * d - LANE_M / 2 * to_left
    parts = [quads(_strip(stop[None], d[None], 0.4, LANE_M - 0.3), Material.LANE_MARKING)]
    if zebra:
        across = np.arange(-right_m + 0.55, left_m - 0.3, 1.0)
        places = end + (clear + 2.0) * d + across[:, None] * to_left
        parts.append(quads(_strip(places, np.tile(d, (len(places), 1)), 3.0, 0.5), Material.LANE_MARKING))
    return join(parts)


def _kept_free(network: StreetNetwork, arriving: HalfEdge) -> float:
    """Length without parking at the end of an edge, because of crossings and zebras, in metres."""
    if network.degree(arriving[1]) == 2:
        return 0.0
    return 16.5 if arriving in network.zebras else 12.5


def bays_of(network: StreetNetwork, block: Block) -> list[tuple[int, Array, Array]]:
    """Parking bays along a block: (index of the edge, centre (2,), driving direction (2,))."""
    found = []
    for i in range(len(block.face)):
        u, v = edge = block.edge(i)
        if network.kerb[edge] < LANE_M + 0.1:
            continue
        d, inward, length = edge_frame(network.nodes[u], network.nodes[v])
        first, last = block.straight(i, network.nodes[u], d)
        start = max(first + 1.0, _kept_free(network, (v, u)))
        room = min(last - 1.0, length - _kept_free(network, (u, v))) - start
        count = max(0, int(room // 5.8))
        left = inward * (LANE_M + PARKING_M / 2)
        for k in range(count):
            s = start + (room - 5.8 * count) / 2 + 5.8 * (k + 0.5)
            found.append((i, network.nodes[u] + s * d + left, -d))
    return found
