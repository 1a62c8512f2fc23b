"""What is painted on the road: centre lines, stop lines, zebra crossings and parking bays."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M, STOP_M, ZEBRA_M, HalfEdge, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import arc_lengths, points_at
from relocbench.datasets.synthetic.town.shapes import Shape, at_height, join, quads
from relocbench.datasets.synthetic.town.streets import Block, bays_of

MARKING_M = 0.004
"""height of markings above the road"""


def _strip(points: Array, forward: Array, length: float, width: float) -> Array:
    """Painted rectangles (N, 4, 3) centred on points (N, 2), with ``length`` along unit directions (N, 2)."""
    ahead = forward * (length / 2)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1) * (width / 2)
    corners = [points - ahead - left, points + ahead - left, points + ahead + left, points - ahead + left]
    return at_height(np.stack(corners, axis=1), MARKING_M)


def markings(network: StreetNetwork, blocks: tuple[Block, ...]) -> list[Shape]:
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
    stop = end + (STOP_M + 5.0 * zebra) * d - LANE_M / 2 * to_left
    parts = [quads(_strip(stop[None], d[None], 0.4, LANE_M - 0.3), Material.LANE_MARKING)]
    if zebra:
        across = np.arange(-right_m + 0.55, left_m - 0.3, 1.0)
        places = end + ZEBRA_M * d + across[:, None] * to_left
        parts.append(quads(_strip(places, np.tile(d, (len(places), 1)), 3.0, 0.5), Material.LANE_MARKING))
    return join(parts)
