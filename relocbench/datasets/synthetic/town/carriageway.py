"""The asphalt of the streets, with coordinates along and across them, which tell where wheels roll and repairs lie."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M, HalfEdge, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import arc_at, arc_lengths, offset_loop, points_at, turns_of
from relocbench.datasets.synthetic.town.shapes import Shape, at_height, quads

_REACH_M = LANE_M + PARKING_M + 4.5
"""distance from the centre line that the asphalt covers; beyond the kerb it is hidden below the pavement"""


@dataclass(frozen=True, eq=False)
class _Run:
    """The centre line from one crossing to the next, with rounded bends."""

    points: Array
    """(P, 2) metres; one of them is the middle"""
    edges: tuple[HalfEdge, ...]
    """(P - 1) edge of the network that each piece belongs to"""
    number: int

    def from_crossing(self) -> Array:
        """Distances (P,) along the line from the nearer end."""
        at = arc_lengths(self.points)
        return np.asarray(np.minimum(at, at[-1] - at))


def carriageway(network: StreetNetwork) -> Shape:
    """The asphalt of all streets, which cover each other nowhere.

    Surface coordinates are metres along the street from the nearer crossing, and from the centre line to the left as
    seen from there. Halves of streets have variants of their own, which are odd where a parking lane is beside.
    """
    runs = _runs(network)
    corners: list[Array] = []
    coordinates: list[Array] = []
    variants: list[int] = []
    for face in network.faces:
        line, pieces = _around(network, runs, face)
        outer = offset_loop(line, [_REACH_M] * len(line))
        for k, (run, i, ahead) in enumerate(pieces):
            after = (k + 1) % len(line)
            along = run.from_crossing()
            from_start = arc_lengths(run.points)[i] < arc_lengths(run.points)[-1] / 2 - 1e-9
            first, second = (along[i], along[i + 1]) if ahead else (along[i + 1], along[i])
            d = (line[after] - line[k]) / np.linalg.norm(line[after] - line[k])
            growing = 1.0 if second > first else -1.0
            u = [first, second, second, first]
            # At crossings a piece ends in the bisector of two streets, elsewhere its coordinate is that of the line.
            if first == 0:
                u[3] += growing * float((outer[k] - line[k]) @ d)
            if second == 0:
                u[2] += growing * float((outer[after] - line[after]) @ d)
            v = _REACH_M if ahead == from_start else -_REACH_M
            corners.append(np.stack([line[k], line[after], outer[after], outer[k]]))
            coordinates.append(np.stack([u, [0.0, 0.0, v, v]], axis=1))
            edge = run.edges[i] if ahead else run.edges[i][::-1]
            parking = network.kerb[edge[0], edge[1]] > LANE_M + 0.1
            variants.append(2 * (2 * run.number + from_start) + parking)
    return quads(at_height(np.array(corners), 0.0), Material.ASPHALT, np.array(coordinates), np.array(variants))


def laid_on(paint: Shape, road: Shape) -> Shape:
    """The shape of triangles on the road, with its surface coordinates and variants."""
    where = _containing(road.vertices[road.triangles][..., :2], paint.vertices[paint.triangles][..., :2].mean(axis=1))
    corners = road.vertices[road.triangles[where]][..., :2]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    offset = paint.vertices[paint.triangles][..., :2] - corners[:, :1]
    weights = np.linalg.solve(sides[:, None], offset[..., None])[..., 0]
    uv = road.uv[where]
    steps = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1)
    uv = uv[:, :1] + weights @ steps
    return Shape(paint.vertices, paint.triangles, uv, paint.material, road.variant[where], paint.rank)


def _containing(triangles: Array, points: Array) -> Indices:
    """For each point (N, 2) the triangle (T, 3, 2) that it lies in, or that it is least outside of."""
    least = np.full((len(points), len(triangles)), np.inf)
    for i in range(3):
        a, b = triangles[:, i], triangles[:, (i + 1) % 3]
        side = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        inward = np.stack([-side[:, 1], side[:, 0]], axis=1)
        np.minimum(least, points @ inward.T - (a * inward).sum(axis=1), out=least)
    return np.asarray(least.argmax(axis=1))


def _runs(network: StreetNetwork) -> dict[tuple[int, ...], _Run]:
    """The lines between crossings, each by its nodes in one of the two orders."""
    runs: dict[tuple[int, ...], _Run] = {}
    for edge in sorted(network.street):
        if network.degree(edge[0]) == 2:
            continue
        chain = list(edge)
        while network.degree(chain[-1]) == 2:
            chain.append(next(n for n in network.neighbours(chain[-1]) if n != chain[-2]))
        if tuple(chain[::-1]) not in runs:
            runs[tuple(chain)] = _run(network, chain, len(runs))
    return runs


def _run(network: StreetNetwork, chain: list[int], number: int) -> _Run:
    nodes = network.nodes[chain]
    turns = turns_of(nodes)
    parts = [nodes[:1]]
    edges: list[HalfEdge] = []
    for i, turn in enumerate(turns, start=1):
        arc = arc_at(nodes[i - 1], nodes[i], nodes[i + 1], network.bend_radius(chain[i], float(turn)))
        parts.append(arc)
        half = (len(arc) - 1) // 2
        edges += [(chain[i - 1], chain[i])] * (1 + half) + [(chain[i], chain[i + 1])] * (len(arc) - 1 - half)
    line = np.concatenate([*parts, nodes[-1:]])
    edges.append((chain[-2], chain[-1]))
    at = arc_lengths(line)
    middle = int(np.searchsorted(at, at[-1] / 2))
    line = np.insert(line, middle, points_at(line, at, np.array([at[-1] / 2]))[0], axis=0)
    edges.insert(middle, edges[middle - 1])
    return _Run(line, tuple(edges), number)


def _around(
    network: StreetNetwork, runs: dict[tuple[int, ...], _Run], face: tuple[int, ...]
) -> tuple[Array, list[tuple[_Run, int, bool]]]:
    """The closed centre line (P, 2) around a face, and of each piece its run, number there, and whether it is ahead."""
    crossings = [i for i, node in enumerate(face) if network.degree(node) != 2]
    turned = face[crossings[0] :] + face[: crossings[0]] + (face[crossings[0]],)
    cuts = [i for i, node in enumerate(turned) if network.degree(node) != 2]
    parts: list[Array] = []
    pieces: list[tuple[_Run, int, bool]] = []
    for a, b in pairwise(cuts):
        chain = turned[a : b + 1]
        ahead = chain in runs
        run = runs[chain if ahead else chain[::-1]]
        order = list(range(len(run.edges)))
        parts.append(run.points[:-1] if ahead else run.points[:0:-1])
        pieces += [(run, i, ahead) for i in (order if ahead else order[::-1])]
    return np.concatenate(parts), pieces
