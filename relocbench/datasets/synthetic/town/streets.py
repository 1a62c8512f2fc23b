"""Blocks with their sides, and the parking bays along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M, HalfEdge, StreetNetwork, frontages
from relocbench.datasets.synthetic.town.polylines import arc_at, area, edge_frame, loop_turns, offset_loop

KERB_M = 0.12
"""height of pavements above the road"""
_CORNER_ROOM_M = 21.0
"""length of a side that the crossing and the corner house take"""

_STYLES = ("terrace", "town", "villa", "modern")
_TOWNS = {
    "terraces": (0.56, 0.26, 0.12, 0.06),
    "flats": (0.1, 0.5, 0.08, 0.32),
    "detached": (0.26, 0.2, 0.46, 0.08),
}
"""shares of the styles of houses in kinds of towns"""


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
    """All blocks in the styles of one of three kinds of town; both sides of the street ``periodic`` repeat a facade."""
    shares = list(_TOWNS.values())[int(rng.integers(len(_TOWNS)))]
    square = _square_face(network, periodic)
    blocks = []
    for k, face in enumerate(network.faces):
        kind = "square" if k == square else "outside" if k == len(network.faces) - 1 else "houses"
        sides: dict[HalfEdge, Side] = {}
        for group in frontages(network.nodes, face):
            is_periodic = any(network.street[e] == periodic for e in group)
            style = _draw_style(rng, shares, outermost=kind == "outside")
            style = "square" if kind == "square" else "terrace" if is_periodic else style
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


def _draw_style(rng: np.random.Generator, shares: tuple[float, ...], *, outermost: bool) -> str:
    """The style of a block's side. The outermost houses mostly stand wall to wall and close the ends of streets."""
    style = str(rng.choice(_STYLES, p=shares))
    return "terrace" if outermost and style == "villa" and rng.random() < 0.5 else style


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


def _kept_free(network: StreetNetwork, arriving: HalfEdge) -> float:
    """Length without parking at the end of an edge, because of crossings and zebras, in metres."""
    if network.degree(arriving[1]) == 2:
        return 0.0
    return 16.5 if arriving in network.zebras else 12.5


def bays_of(network: StreetNetwork, block: Block) -> list[tuple[Array, Array]]:
    """Parking bays along a block: (centre (2,), driving direction (2,))."""
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
            found.append((network.nodes[u] + s * d + left, -d))
    return found
