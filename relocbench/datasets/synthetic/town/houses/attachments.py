"""What is built onto the fronts of houses: bay windows and satellite dishes, in the house's frame."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.facades import FrontStyle, openings, window_names
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, join, moved, quads, triangle_shape, tube

BAY_M = 0.6
"""how far a bay window stands out"""


def bay_window(x0: float, x1: float, levels: Array, style: FrontStyle) -> list[Shape]:
    """A bay window from the ground up in place of the wall from x0 to x1.

    Args:
        levels: (S + 1,) heights of the floors of its S storeys and of its top, metres.
    """
    splay = min(0.55, (x1 - x0) / 4)
    plan = np.array([[x0, 0.0], [x0 + splay, -BAY_M], [x1 - splay, -BAY_M], [x1, 0.0]])
    plain = replace(style, shutters=False, mullions=1, transom=True)
    parts = []
    for side, (a, b) in enumerate(pairwise(plan)):
        length = float(np.linalg.norm(b - a))
        d = (b - a) / length
        turn = np.array([[d[0], -d[1], 0.0], [d[1], d[0], 0.0], [0.0, 0.0, 1.0]])
        cells = np.array([[0.0, length, low, high] for low, high in pairwise(levels)])
        holes = cells + np.array([0.13, -0.13, 0.85, -0.45])
        own = plain if side == 1 else replace(plain, mullions=0)
        facet = [
            *openings(cells, holes, own, Material.WINDOW, window_names(len(cells), 2000 + 8 * side)),
            boxes([0.0, -0.06, levels[-1] - 0.2], [length, 0.0, levels[-1]], style.trim, without="back"),
        ]
        parts += [replace(s, vertices=s.vertices @ turn.T + np.array([*a, 0.0])) for s in facet]
    top, ridge = float(levels[-1]), float(levels[-1]) + 0.45
    eave = np.column_stack([plan, np.full(4, top)])
    wall = np.array([[x0, 0.0, ridge], [x1, 0.0, ridge]])
    parts.append(quads([[eave[1], eave[2], wall[1], wall[0]]], Material.ROOF_FLAT))
    ends = np.array([eave[0], eave[1], wall[0], eave[2], eave[3], wall[1]])
    parts.append(triangle_shape(ends, [[0, 1, 2], [3, 4, 5]], Material.ROOF_FLAT))
    return parts


def dish(x: float, z: float) -> Shape:
    """A satellite dish on a bracket in front of the wall."""
    turn = 2 * np.pi * np.arange(10) / 10
    rim = np.stack([0.3 * np.cos(turn), -0.26 + 0.08 * np.sin(turn), 0.3 * np.sin(turn)], axis=1)
    middle = np.array([0.0, -0.18, -0.03])
    after = np.roll(np.arange(10), -1)
    spread = np.broadcast_to(middle, rim.shape)
    face = np.stack([spread, rim, rim[after]], axis=1)
    behind = face[:, ::-1] + np.array([0.0, 0.012, 0.0])
    both = np.concatenate([face, behind]).reshape(-1, 3)
    bowl = triangle_shape(both, np.arange(60).reshape(-1, 3), Material.PLASTIC)
    arm = tube([[0.0, 0.0, -0.1], [0.0, -0.2, -0.06]], 0.02, 4, Material.METAL)
    return moved(join([bowl, arm]), x, 0.0, z)
