"""What is painted on the road: centre lines, stop lines, zebra crossings, arrows, parking bays, lines along kerbs."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M, STOP_M, ZEBRA_M, HalfEdge, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import arc_lengths, offset_line, points_at, turns_of
from relocbench.datasets.synthetic.town.shapes import Shape, at_height, join, quads
from relocbench.datasets.synthetic.town.streets import Block, bays_of

MARKING_M = 0.004
"""height of markings above the road"""
_ARROW_BEFORE_M = 7.0
"""distance of arrows from the stop line"""
_LINES_M = ((0.08, 0.15), (0.20, 0.27))
"""yellow lines, as distances from the kerb"""
_EDGE_LINE_M = (0.14, 0.24)
"""a white line in their place"""
_KERB_LINES: tuple[tuple[tuple[tuple[float, float], ...], Material], ...] = (
    ((), Material.LANE_MARKING),
    (_LINES_M, Material.KERB_LINE),
    ((_EDGE_LINE_M,), Material.LANE_MARKING),
    (_LINES_M, Material.KERB_LINE),
)
"""what there may be along a kerb"""
_STRAIGHT_ON = np.radians(45)


def _strip(points: Array, forward: Array, length: float, width: float) -> Array:
    """Painted rectangles (N, 4, 3) centred on points (N, 2), with ``length`` along unit directions (N, 2)."""
    ahead = forward * (length / 2)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1) * (width / 2)
    corners = [points - ahead - left, points + ahead - left, points + ahead + left, points - ahead + left]
    return at_height(np.stack(corners, axis=1), MARKING_M)


def markings(network: StreetNetwork, blocks: tuple[Block, ...]) -> list[Shape]:
    """Dashed centre lines, what is before crossings, and lines along kerbs and of parking bays."""
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
        paint += _kerb_lines(network, block)
        for place, direction in bays_of(network, block):
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
    if (7 * edge[0] + 13 * edge[1]) % 3:
        parts.append(_arrow(network, edge, stop + _ARROW_BEFORE_M * d, -d))
    return join(parts)


def _arrow(network: StreetNetwork, edge: HalfEdge, place: Array, ahead: Array) -> Shape:
    """An arrow on a lane that shows the ways on from the crossing ``edge[1]``, about a place (2,)."""
    u, v = edge
    turns = [float(turns_of(network.nodes[[u, v, w]])[0]) for w in network.neighbours(v) if w != u]
    rows = [(-2.0, -0.08, 0.3, 0.08)]
    heads: list[list[tuple[float, float]]] = []
    if any(abs(t) < _STRAIGHT_ON for t in turns):
        rows.append((0.3, -0.08, 1.1, 0.08))
        heads.append([(1.1, -0.32), (2.3, 0.0), (1.1, 0.32)])
    for side in (-1, 1):
        if any(side * t >= _STRAIGHT_ON for t in turns):
            rows.append((0.14, min(0.08 * side, 0.5 * side), 0.3, max(0.08 * side, 0.5 * side)))
            heads.append([(-0.25, 0.5 * side), (0.7, 0.5 * side), (0.22, 1.0 * side)][::side])
    flat = [[(a, b), (c, b), (c, e), (a, e)] for a, b, c, e in rows] + [[*h, h[2]] for h in heads]
    local = np.array(flat)
    left = np.array([-ahead[1], ahead[0]])
    points = place + local[..., :1] * ahead + local[..., 1:] * left
    return quads(at_height(points, MARKING_M), Material.LANE_MARKING)


def _kerb_lines(network: StreetNetwork, block: Block) -> list[Shape]:
    """Lines along the kerbs of a block where nobody may park: two yellow ones, a white one, or none on a side."""
    count = len(block.face)
    kinds = [
        0 if network.kerb[block.edge(i)] > LANE_M + 0.1 else block.sides[i].variant % len(_KERB_LINES)
        for i in range(count)
    ]
    lines: list[Shape] = []
    for i, kind in enumerate(kinds):
        arc, after = block.kerb_arcs[i], block.kerb_arcs[(i + 1) % count]
        line = np.concatenate([arc, after[:1]] if kinds[i - 1] == kind else [arc[-1:], after[:1]])
        lines += [_beside(line, *band, _KERB_LINES[kind][1]) for band in _KERB_LINES[kind][0]]
    return lines


def _beside(line: Array, near: float, far: float, material: Material) -> Shape:
    """A band to the right of a line (P, 2), from ``near`` to ``far`` metres of it."""
    step = np.diff(line, axis=0)
    step = step[np.linalg.norm(step, axis=1) > 1e-6]
    line = np.concatenate([line[:1], line[:1] + np.cumsum(step, axis=0)])
    inner, outer = (offset_line(line, [-at] * len(step)) for at in (near, far))
    # The lines lie below other markings, which they may cross.
    corners = np.stack([outer[:-1], outer[1:], inner[1:], inner[:-1]], axis=1)
    return quads(at_height(corners, MARKING_M - 0.001), material)
