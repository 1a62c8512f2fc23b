"""Streets as a planar graph, the blocks between them, and drives along the right-hand lanes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.polylines import (
    arc_lengths,
    area,
    loop_turns,
    offset_line,
    offset_loop,
    points_at,
    resampled,
    rounded,
    turns_of,
)
from relocbench.datasets.synthetic.town.shapes import poses
from relocbench.errors import ConfigError

LANE_M = 3.2
"""width of a traffic lane; one each way"""
PARKING_M = 2.1
"""width of the parking lane of a street side that has one"""
STOP_M, ZEBRA_M = 11.2, 13.2
"""distance from the middle of a crossing to the stop line or the edge of a zebra, and to the zebra's middle"""
KERB_RADIUS_M = 5.5
"""kerb radius of block corners at crossings"""
_STRAIGHT = np.radians(35)
"""turns up to this angle are bends of a street, larger ones are corners"""
_STEP_M = 0.25
RUN_IN_M = 12.0
"""length of a walk before its path begins"""

HalfEdge = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Path:
    """A smooth, evenly sampled path on the road."""

    points: Array
    """(P, 2) metres"""
    heading: Array
    """(P,) radians from east, unwrapped"""
    step: float
    """metres between samples"""
    streets: tuple[tuple[float, float, int], ...]
    """(from, to, street id) in metres along the path; sections end in the middle of crossings"""
    left_lane: bool = False
    """whether it lies in the left-hand lane, against that lane's traffic"""

    @property
    def other_lane_m(self) -> float:
        """Metres from the path to the middle of the other lane, positive to the left."""
        return -LANE_M if self.left_lane else LANE_M

    @property
    def length(self) -> float:
        """Length in metres."""
        return self.step * (len(self.points) - 1)

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """T_world_vehicle (4, 4) at ``s`` metres: x forward, y left, z up, origin on the road.

        The vehicle is ``lateral_m`` left of the path and turned by ``yaw_rad`` to the left. Raises ConfigError if ``s``
        is outside the path.
        """
        if not -1e-6 <= s <= self.length + 1e-6:
            raise ConfigError(f"the path is {self.length:.1f} m long and has no place at {s:.1f} m")
        at = np.arange(len(self.points)) * self.step
        x, y, heading = (np.interp(s, at, v) for v in (self.points[:, 0], self.points[:, 1], self.heading))
        x, y = x - lateral_m * np.sin(heading), y + lateral_m * np.cos(heading)
        return np.asarray(poses(x, y, 0.0, heading + yaw_rad)[0])


@dataclass(frozen=True, eq=False)
class StreetNetwork:
    """A planar graph of streets. Nodes are crossings and bends; edges are straight pieces with a lane each way."""

    nodes: Array
    """(N, 2) metres"""
    street: dict[HalfEdge, int]
    """street id of each directed edge, the same for both directions"""
    faces: tuple[tuple[int, ...], ...]
    """blocks as loops of nodes with the block on the left; the last one is the outside, in clockwise order"""
    kerb: dict[HalfEdge, float]
    """distance of the kerb on the left of each directed edge from the centre line"""
    zebras: frozenset[HalfEdge]
    """directed edges with a zebra crossing before their end"""

    def neighbours(self, node: int) -> list[int]:
        return sorted(v for u, v in self.street if u == node)

    def degree(self, node: int) -> int:
        return len(self.neighbours(node))

    def bend_radius(self, node: int, turn: float) -> float:
        """Radius (m) of the centre line at a node that joins two edges, given its turn (rad)."""
        return 11.0 if abs(turn) > _STRAIGHT else 35.0

    def kerb_radius(self, face: Sequence[int], i: int, turn: float) -> float:
        """Radius (m) of the kerb at corner ``i`` of a face; concentric with the centre line in a bend."""
        node = face[i]
        if self.degree(node) == 2:
            out: float = self.bend_radius(node, turn) - np.sign(turn) * self.kerb[(face[i - 1], node)]
            return out
        return KERB_RADIUS_M if abs(turn) > _STRAIGHT else 15.0

    def nodes_of(self, street: int) -> list[int]:
        """The nodes of a street from the crossing at one end to that at the other."""
        members = [(u, v) for (u, v), name in self.street.items() if name == street and u < v]
        ends = [n for n in {n for e in members for n in e} if self.degree(n) != 2 or sum(n in e for e in members) == 1]
        chain = [min(ends)]
        while len(chain) <= len(members):
            chain.append(
                next(v for v in self.neighbours(chain[-1]) if self.street[(chain[-1], v)] == street and v not in chain)
            )
        return chain

    def centre_line(self, street: int) -> Array:
        """The centre line (P, 2) of a street between the crossings at its ends, with rounded bends."""
        chain = self.nodes_of(street)
        points = self.nodes[chain]
        turns = turns_of(points)
        return rounded(points, [self.bend_radius(n, t) for n, t in zip(chain[1:-1], turns, strict=True)])

    def drive(self, length_m: float, seed: int) -> Path:
        """A path of ``length_m`` in the middle of the right-hand lane that prefers the streets it has driven least.

        It is determined by the network and the seed and never turns back. Raises ConfigError unless the length is
        positive.
        """
        if length_m <= 0:
            raise ConfigError(f"a drive needs a positive length, got {length_m} m")
        return self.path(self.walk(length_m, seed), RUN_IN_M, length_m)

    def walk(self, length_m: float, seed: int) -> list[int]:
        """The nodes that :meth:`drive` passes, and some more at the end; a longer walk extends a shorter one."""
        return self._route(1.25 * length_m + 60.0, np.random.default_rng(seed))

    def path(self, chain: Sequence[int], start_m: float, length_m: float, *, left_lane: bool = False) -> Path:
        """A path of ``length_m`` in the middle of a lane along a chain of nodes, from ``start_m`` on.

        Args:
            left_lane: in the left-hand lane, which is that of the way back, instead of in the right-hand one.

        Raises:
            ConfigError: the nodes do not reach that far.
        """
        nodes = self.nodes[list(chain)]
        side = 1 if left_lane else -1
        lane = offset_line(nodes, [side * LANE_M / 2] * (len(chain) - 1))
        turns = turns_of(nodes)
        line = rounded(lane, [self._lane_radius(n, -side * t) for n, t in zip(chain[1:-1], turns, strict=True)])
        points, heading = _smooth(line, start_m, length_m)
        return Path(points, heading, _STEP_M, self._streets_along(chain, lane, points), left_lane)

    def _route(self, length_m: float, rng: np.random.Generator) -> list[int]:
        """Nodes of a walk that takes the least driven edge at every crossing, without turning back or sharp turns."""
        edges = sorted(self.street)
        chain = list(edges[rng.integers(len(edges))])
        driven = dict.fromkeys(edges, 0)
        length = 0.0
        while length < length_m:
            u, v = chain[-2:]
            driven[(u, v)] += 1
            driven[(v, u)] += 1
            length += float(np.linalg.norm(self.nodes[v] - self.nodes[u]))
            ways = [w for w in self.neighbours(v) if w != u]
            gentle = [w for w in ways if abs(turns_of(self.nodes[[u, v, w]])[0]) < np.radians(125)]
            chain.append(min(gentle or ways, key=lambda w: driven[(v, w)] + 0.9 * rng.random()))
        return chain

    def _lane_radius(self, node: int, turn: float) -> float:
        """The radius of the right lane's middle; in a right turn (negative) it is inside of the centre line."""
        if self.degree(node) == 2:
            out: float = self.bend_radius(node, turn) + np.sign(turn) * LANE_M / 2
            return out
        if abs(turn) < _STRAIGHT:
            return 40.0
        return KERB_RADIUS_M + LANE_M / 2 if turn < 0 else 9.0

    def _streets_along(self, chain: Sequence[int], lane: Array, points: Array) -> tuple[tuple[float, float, int], ...]:
        """The sections of the path on each street of the walk."""
        last = len(points) - 1
        cuts, start = [0], 0
        for node in lane[1:-1]:
            ahead = np.linalg.norm(points[start : start + int(260 / _STEP_M)] - node, axis=1)
            near = start + int(np.argmin(_first_minimum(ahead)))
            cuts.append(near)
            start = near
        cuts.append(last)
        result: list[tuple[float, float, int]] = []
        for k, (a, b) in enumerate(pairwise(cuts)):
            name = self.street[(chain[k], chain[k + 1])]
            if b <= a:
                continue
            if result and result[-1][2] == name:
                result[-1] = (result[-1][0], b * _STEP_M, name)
            else:
                result.append((a * _STEP_M, b * _STEP_M, name))
        return tuple(result)


def _first_minimum(distance: Array) -> Array:
    """The distances up to the first approach to zero; later ones are set to infinity."""
    near = np.flatnonzero(distance < 12.0)
    if len(near) == 0:
        return distance
    gap = np.flatnonzero(np.diff(near) > 1)
    end = near[gap[0]] if len(gap) else near[-1]
    return np.where(np.arange(len(distance)) <= end, distance, np.inf)


def _smooth(line: Array, start_m: float, length_m: float) -> tuple[Array, Array]:
    """Samples and headings of a line of arcs, smoothed by averaging over 4 m twice for a continuous curvature."""
    fine = resampled(line, 0.1)
    kernel = np.convolve(np.full(41, 1 / 41), np.full(41, 1 / 41))
    soft = np.stack([np.convolve(fine[:, k], kernel, mode="valid") for k in range(2)], axis=1)
    at = arc_lengths(soft)
    if start_m < 0 or at[-1] < start_m + length_m:
        raise ConfigError(f"the walk is {at[-1]:.1f} m long, too short for {length_m:.1f} m from {start_m:.1f} m on")
    count = int(np.ceil(length_m / _STEP_M)) + 1
    s = start_m + np.arange(count) * _STEP_M
    points = points_at(soft, at, s)
    tangent = np.gradient(points, axis=0)
    return points, np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))


def make_network(rng: np.random.Generator, extent_m: float) -> StreetNetwork:
    """A random network in a square of ``extent_m``, with its outer streets about 28 m from the edge."""
    for _ in range(200):
        nodes, street = _graph(rng, extent_m)
        faces = _faces(nodes, street)
        if all(_is_roomy(nodes, face) for face in faces):
            ends = [e for e in sorted(street) if sum(u == e[1] for u, _ in street) > 2]
            zebras = frozenset(e for e in ends if rng.random() < 0.5)
            return StreetNetwork(nodes, street, faces, _kerbs(rng, nodes, faces), zebras)
    raise ConfigError(f"no street network found for an extent of {extent_m} m")


def _graph(rng: np.random.Generator, extent_m: float) -> tuple[Array, dict[HalfEdge, int]]:
    """A randomly perturbed grid without some of its inner streets and with bends in some of the others."""
    count = max(3, int((extent_m - 56) / 60) + 1)
    spacing = (extent_m - 56) / (count - 1)
    line = (np.arange(count) - (count - 1) / 2) * spacing
    nodes = [np.array([x, y]) + rng.uniform(-0.12, 0.12, 2) * spacing for y in line for x in line]
    across = [(j * count + i, j * count + i + 1) for j in range(count) for i in range(count - 1)]
    along = [(j * count + i, j * count + i + count) for j in range(count - 1) for i in range(count)]
    rim = {n for n in range(count * count) if n % count in (0, count - 1) or n // count in (0, count - 1)}
    inner = [e for e in across + along if not (e[0] in rim and e[1] in rim)]
    gone: list[HalfEdge] = []
    for k in rng.permutation(len(inner)):
        if len(gone) < count - 2 and not any(set(inner[k]) & set(e) for e in gone):
            gone.append(inner[k])
    street: dict[HalfEdge, int] = {}
    for name, (u, v) in enumerate(e for e in across + along if e not in gone):
        chain = [u, v]
        if rng.random() < 0.4:
            d = nodes[v] - nodes[u]
            bow = rng.choice([-1, 1]) * rng.uniform(0.05, 0.09)
            nodes.append(nodes[u] + rng.uniform(0.42, 0.58) * d + bow * np.array([-d[1], d[0]]))
            chain = [u, len(nodes) - 1, v]
        for a, b in pairwise(chain):
            street[(a, b)] = street[(b, a)] = name
    return np.array(nodes), street


def _faces(nodes: Array, street: dict[HalfEdge, int]) -> tuple[tuple[int, ...], ...]:
    """The faces of the graph as loops with the face on the left; the outside (negative area) is last."""
    around: dict[int, list[int]] = {}
    for u in range(len(nodes)):
        ends = [b for a, b in street if a == u]
        around[u] = sorted(ends, key=lambda v: float(np.arctan2(*(nodes[v] - nodes[u])[::-1])))
    left = set(street)
    faces = []
    for first in sorted(street):
        if first not in left:
            continue
        loop, edge = [], first
        while edge in left:
            left.remove(edge)
            loop.append(edge[0])
            ring = around[edge[1]]
            edge = (edge[1], ring[ring.index(edge[0]) - 1])
        faces.append(tuple(loop))
    return tuple(sorted(faces, key=lambda f: (area(nodes[list(f)]) < 0, f)))


def _is_roomy(nodes: Array, face: tuple[int, ...]) -> bool:
    """Whether a block has room for pavements and houses: its polygon must keep its shape when shrunk by 22 m."""
    polygon = nodes[list(face)]
    moved = offset_loop(polygon, [22.0] * len(face))
    before, after = (np.roll(p, -1, axis=0) - p for p in (polygon, moved))
    turn = loop_turns(polygon)
    fits = (before * after).sum(axis=1) > 2.0 * np.linalg.norm(before, axis=1)
    return bool(fits.all() and (np.abs(turn) < np.radians(115)).all() and (np.abs(_not_between(turn)) > 0).all())


def _not_between(turn: Array) -> Array:
    """Zero for turns of 35 to 50 deg, for which neither the kerb of a bend nor that of a corner fits, else one."""
    return np.where((np.abs(turn) > _STRAIGHT) & (np.abs(turn) < np.radians(50)), 0.0, 1.0)


def frontages(nodes: Array, face: tuple[int, ...]) -> list[list[HalfEdge]]:
    """The edges of a face, grouped into the sides of the block, which are separated by corners."""
    turn = loop_turns(nodes[list(face)])
    count = len(face)
    corners = [i for i in range(count) if abs(turn[i]) > _STRAIGHT]
    if not corners:
        return [[(face[i], face[(i + 1) % count]) for i in range(count)]]
    return [
        [(face[i % count], face[(i + 1) % count]) for i in range(first, after)]
        for first, after in pairwise([*corners, corners[0] + count])
    ]


def _kerbs(rng: np.random.Generator, nodes: Array, faces: tuple[tuple[int, ...], ...]) -> dict[HalfEdge, float]:
    """Kerb distances of all directed edges; two in three block sides have a parking lane."""
    kerb = {}
    for face in faces:
        for group in frontages(nodes, face):
            parking = rng.random() < 0.67
            kerb.update(dict.fromkeys(group, LANE_M + PARKING_M * parking))
    return kerb
