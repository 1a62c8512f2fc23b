"""Wires above streets: between poles and to the houses beside them, and across from house to house."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.town.network import HalfEdge, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import edge_frame
from relocbench.datasets.synthetic.town.rows import Plot
from relocbench.datasets.synthetic.town.shapes import Shape, join, single, tube
from relocbench.datasets.synthetic.town.streets import KERB_M, Block, Side

_POLE_M, _BAR_M = 7.4, 7.1
"""height of a pole and of its crossbar"""
_BETWEEN_M = 31.0
"""distance of poles"""
_REACH_M = 16.0
"""greatest length of a wire from a pole to a house"""
_CLEAR_M = 15.0
"""distance of poles from crossings"""
_RADIUS_M = 0.017
"""of a bundle of wires; a single one could not be seen"""
_ACROSS_M, _ACROSS_AT_M = 24.0, 6.6
"""distance of wires across the street from each other, and their height"""
_SHARE = 0.6
"""of the sides of blocks that can have wires"""


def _wire(start: Array, end: Array, sag_m: float) -> Shape:
    """A wire that hangs between two points (3,) on a parabola."""
    t = np.linspace(0, 1, 7)[:, None]
    points = start + t * (end - start)
    points[:, 2] -= 4 * sag_m * (t * (1 - t))[:, 0]
    return tube(points, _RADIUS_M, 3, Material.RUBBER)


def _pole(foot: Array, d: Array) -> Shape:
    """A wooden pole at (3,) with a crossbar across the direction (2,) of the wires."""
    top = foot + np.array([0, 0, _POLE_M])
    post = tube(np.stack([foot, top]), [0.13, 0.09], 8, Material.BARK)
    across = np.array([-d[1], d[0], 0.0])
    bar = foot + np.array([0, 0, _BAR_M])
    return join([post, tube(np.stack([bar - 0.6 * across, bar + 0.6 * across]), 0.05, 4, Material.BARK)])


def string_wires(
    network: StreetNetwork,
    blocks: Sequence[Block],
    plots: Mapping[int, Sequence[Plot]],
    names: Iterator[int],
    rng: np.random.Generator,
) -> list[Mesh]:
    """The wires of a district: along streets of low houses on poles, across streets of high ones.

    Streets that have trees, and the one that repeats itself, have none.

    Args:
        plots: houses by the number of their block.
    """
    side_of = {block.edge(i): block.sides[i] for block in blocks for i in range(len(block.face))}
    found: list[Mesh] = []
    for number, block in enumerate(blocks):
        for i in range(len(block.face)):
            edge, side = block.edge(i), block.sides[i]
            wanted = rng.random() < _SHARE
            if not wanted or "periodic" in (side.style, side_of[edge[::-1]].style):
                continue
            if side.style in ("terrace", "villa") and edge < edge[::-1]:
                houses = [plot for plot in plots.get(number, ()) if plot.edge == i]
                found += _along(network, block, i, houses, names)
            elif {side.style, side_of[edge[::-1]].style} <= {"town", "modern"} and edge < edge[::-1]:
                found += _across(network, edge, (side_of[edge], side_of[edge[::-1]]), names)
    return found


def _along(
    network: StreetNetwork, block: Block, i: int, houses: Sequence[Plot], names: Iterator[int]
) -> Iterator[Mesh]:
    """Poles along a side of a block, with wires between them and to the houses."""
    u, v = block.edge(i)
    d, inward, length = edge_frame(network.nodes[u], network.nodes[v])
    first, last = block.straight(i, network.nodes[u], d)
    start, end = max(first + 1.0, _CLEAR_M), min(last - 1.0, length - _CLEAR_M)
    if end - start < _BETWEEN_M / 2:
        return
    line = network.nodes[u] + (network.kerb[(u, v)] + 0.35) * inward
    feet = [np.append(line + s * d, KERB_M) for s in np.linspace(start, end, round((end - start) / _BETWEEN_M) + 1)]
    parts = [_pole(foot, d) for foot in feet]
    across = 0.5 * np.append(inward, 0.0)
    for a, b in pairwise(feet):
        up = np.array([0, 0, _BAR_M + 0.08])
        parts += [_wire(a + k * across + up, b + k * across + up, 0.45) for k in (-1, 0.4, 1)]
    for plot in houses:
        eaves = (plot.T_world_house @ [plot.width * 0.4, -0.03, min(plot.house.wall_m, 7.0) - 0.35, 1.0])[:3]
        pole = min(feet, key=lambda foot: float(np.linalg.norm(foot - eaves)))
        if np.linalg.norm(pole - eaves) < _REACH_M:
            parts.append(_wire(pole + np.array([0, 0, _BAR_M - 0.15]), eaves, 0.3))
    yield single(join(parts), next(names), 1, Semantic.POLE)


def _across(network: StreetNetwork, edge: HalfEdge, sides: Sequence[Side], names: Iterator[int]) -> Iterator[Mesh]:
    """Wires from house to house."""
    d, inward, length = edge_frame(*network.nodes[list(edge)])
    reach = [
        network.kerb[e] + side.pavement_m + side.garden_m for e, side in zip((edge, edge[::-1]), sides, strict=True)
    ]
    parts = []
    for s in np.arange(_ACROSS_M, length - 20.0, _ACROSS_M):
        foot = network.nodes[edge[0]] + s * d
        a, b = (np.append(foot + way * inward, _ACROSS_AT_M) for way in (reach[0], -reach[1]))
        parts.append(_wire(a, b, 0.35))
    if parts:
        yield single(join(parts), next(names), 1, Semantic.POLE)
