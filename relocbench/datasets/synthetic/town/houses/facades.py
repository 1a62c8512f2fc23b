"""Fronts of houses: walls with windows, doors, shop fronts, balconies.

A front lies in the plane y = 0 and is seen from -y: x to the right, z up, y into the house.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.glazing import corners_of, displays, glazed, pane
from relocbench.datasets.synthetic.town.mesh import BOARD_M, Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, boxes_of, join, quads

_FRAME_M = 0.06
_NEXT = [1, 2, 3, 0]
_STEP_M = 0.16
"""height of a step before a door"""


@dataclass(frozen=True)
class FrontStyle:
    """The style of a front's windows."""

    wall: Material
    trim: Material
    """sills, lintels and bands"""
    frame: Material
    bay_m: float
    """approximate distance between windows"""
    width: float
    height: float
    sill: float
    """height above the floor"""
    recess: float
    mullions: int
    transom: bool
    lintel: bool
    surround: bool
    shutters: bool
    balconies: float
    """share of the windows above the ground floor that have a balcony"""
    salt: int = 0
    """chooses curtains and blinds"""


def window_names(count: int, first: int) -> NDArray[np.uint32]:
    """Variants (count,) of the windows of a house, by their numbers."""
    return ((np.arange(count) + first + 1) * 2654435761 % 2**32).astype(np.uint32)


def ring_quads(outer: Array, inner: Array, y_outer: float, y_inner: float) -> Array:
    """Four quads (N, 4, 4, 3) between rectangles (N, 4) = (x0, x1, z0, z1) at two depths, facing -y or inwards."""
    a, b = corners_of(outer, y_outer), corners_of(inner, y_inner)
    return np.stack([a, a[:, _NEXT], b[:, _NEXT], b], axis=2)


def openings(
    cells: Array, holes: Array, style: FrontStyle, glass: Material, variant: NDArray[np.uint32], plain: bool = False
) -> list[Shape]:
    """Wall cells (N, 4), each with a window in a hole (N, 4): wall, reveal, frame, bars and glass.

    ``plain`` leaves out frames and bars, for the backs of houses.
    """
    zero, deep = np.zeros(len(cells)), style.recess
    parts = [
        quads(ring_quads(cells, holes, 0.0, 0.0), style.wall),
        quads(ring_quads(holes, holes, 0.0, deep), style.wall),
    ]
    if plain:
        return [*parts, pane(holes, deep, glass, variant)]
    inner = holes + _FRAME_M * np.array([1, -1, 1, -1])
    back = deep + 0.05
    parts.append(quads(ring_quads(holes, inner, deep, deep), style.frame))
    parts.append(quads(ring_quads(inner, inner, deep, back), style.frame))
    parts += glazed(inner, back, glass, variant, style.salt)
    x0, x1, z0, z1 = inner.T
    for k in range(style.mullions):
        x = x0 + (x1 - x0) * (k + 1) / (style.mullions + 1)
        low = np.stack([x - 0.025, zero + deep + 0.01, z0], axis=1)
        high = np.stack([x + 0.025, zero + back, z1], axis=1)
        parts.append(boxes(low, high, style.frame, without="back bottom top"))
    if style.transom:
        z = z0 + 0.68 * (z1 - z0)
        low = np.stack([x0, zero + deep + 0.015, z - 0.025], axis=1)
        high = np.stack([x1, zero + back, z + 0.025], axis=1)
        parts.append(boxes(low, high, style.frame, without="back left right"))
    return parts


def trims(holes: Array, style: FrontStyle, cells: Array) -> list[Shape]:
    """Sills, lintels or surrounds, and shutters of windows (N, 4) in cells (N, 4)."""
    x0, x1, z0, z1 = holes.T
    zero = np.zeros(len(holes))
    low = [np.stack([x0 - 0.08, zero - 0.09, z0 - 0.09], axis=1)]
    high = [np.stack([x1 + 0.08, zero, z0], axis=1)]
    if style.lintel or style.surround:
        low.append(np.stack([x0 - 0.12, zero - 0.03, z1], axis=1))
        high.append(np.stack([x1 + 0.12, zero, z1 + 0.18], axis=1))
    parts = [boxes(np.concatenate(low), np.concatenate(high), style.trim, without="back")]
    if style.surround:
        low = [np.stack([a, zero - 0.03, z0], axis=1) for a in (x0 - 0.12, x1)]
        high = [np.stack([b, zero, z1], axis=1) for b in (x0, x1 + 0.12)]
        parts.append(boxes(np.concatenate(low), np.concatenate(high), style.trim, without="back bottom top"))
    if style.shutters:
        half = np.minimum((x1 - x0) / 2, (cells[:, 1] - cells[:, 0] - (x1 - x0)) / 2 - 0.01)
        low = [np.stack([a, zero - 0.05, z0], axis=1) for a in (x0 - half, x1 + 0.01)]
        high = [np.stack([b, zero - 0.005, z1], axis=1) for b in (x0 - 0.01, x1 + half)]
        parts.append(boxes(np.concatenate(low), np.concatenate(high), Material.WOOD, variant=0x51))
    return parts


def balcony(x0: float, x1: float, z: float) -> Shape:
    """A slab with a railing in front of a window from x0 to x1 at floor level z."""
    left, right, reach = x0 - 0.35, x1 + 0.35, 0.85
    bars = np.linspace(left + 0.03, right - 0.03, max(4, int((right - left) / 0.19)))
    sides = np.linspace(-reach + 0.05, -0.12, 5)
    posts = [(x - 0.012, -reach + 0.02, z, x + 0.012, -reach + 0.045, z + 0.95) for x in bars]
    posts += [
        (x - 0.012, y - 0.012, z, x + 0.012, y + 0.012, z + 0.95) for x in (left + 0.03, right - 0.03) for y in sides
    ]
    rails = [
        (left, -reach, z + 0.95, right, -reach + 0.06, z + 1.0),
        (left, -reach + 0.06, z + 0.95, left + 0.06, 0.0, z + 1.0),
        (right - 0.06, -reach + 0.06, z + 0.95, right, 0.0, z + 1.0),
    ]
    rail_box = boxes_of(rails, Material.METAL)
    slab = boxes([left, -reach, z - 0.16], [right, 0.0, z], Material.CONCRETE, without="back")
    return join([boxes_of(posts, Material.METAL, without="bottom top back"), rail_box, slab])


def door(cell: Array, width: float, top: float, style: FrontStyle, variant: int, steps: int = 0) -> list[Shape]:
    """A wall cell (4,) with a door in a deep reveal, with transom light, panels, knob and steps before its sill."""
    middle = (cell[0] + cell[1]) / 2
    floor = 0.05 + _STEP_M * steps
    hole = np.array([[middle - width / 2, middle + width / 2, floor, top]])
    depth = 0.22
    parts = [
        quads(ring_quads(cell[None], hole, 0.0, 0.0), style.wall),
        quads(ring_quads(hole, hole, 0.0, depth), style.trim),
    ]
    x0, x1, z0, z1 = hole[0]
    leaf_top = min(z0 + 2.1, z1 - 0.02)
    leaf = np.array([[x0, x1, z0, leaf_top]])
    parts.append(pane(leaf, depth, Material.DOOR, variant))
    if z1 - leaf_top > 0.1:
        parts.append(pane(np.array([[x0, x1, leaf_top, z1]]), depth, Material.WINDOW, variant + 1))
    third = (x1 - x0) / 7
    panels = [
        (a, depth - 0.025, b, a + 2 * third, depth, c)
        for a in (x0 + third, x1 - 3 * third)
        for b, c in ((z0 + 0.2, z0 + 0.9), (z0 + 1.05, leaf_top - 0.18))
    ]
    parts.append(boxes_of(panels, Material.DOOR, without="back", variant=variant))
    parts.append(
        boxes([x1 - 0.12, depth - 0.08, z0 + 1.0], [x1 - 0.07, depth, z0 + 1.05], Material.METAL, without="back")
    )
    flight = [
        (x0 - 0.1, -0.32 - 0.28 * (steps - k), _STEP_M * k + 0.05 * (k == 0) - 0.05, x1 + 0.1, 0.0, _STEP_M * k + 0.05)
        for k in range(steps + 1)
    ]
    parts.append(boxes_of(flight, style.trim, without="back bottom"))
    frame = [
        (x0 - 0.14, -0.04, 0.0, x0, 0.0, z1 + 0.16),
        (x1, -0.04, 0.0, x1 + 0.14, 0.0, z1 + 0.16),
        (x0, -0.04, z1, x1, 0.0, z1 + 0.16),
    ]
    parts.append(boxes_of(frame, style.trim, without="back"))
    return parts


def shop(cell: Array, style: FrontStyle, variant: int, awning: bool, door_right: bool) -> list[Shape]:
    """A shop front in a wall cell (4,): large panes on a riser, a door, a sign, and possibly an awning."""
    x0, x1, _, z1 = cell
    hole = np.array([[x0 + 0.3, x1 - 0.3, 0.05, z1 - 0.95]])
    depth = 0.28
    frame = Material.WOOD
    parts = [
        quads(ring_quads(cell[None], hole, 0.0, 0.0), style.wall),
        quads(ring_quads(hole, hole, 0.0, depth), frame, variant=variant),
    ]
    a, b, low, high = hole[0]
    door_m = 1.0
    left, right = (a, b - door_m) if door_right else (a + door_m, b)
    entry = (right, b) if door_right else (a, left)
    riser = low + 0.45
    parts.append(boxes([left, depth - 0.12, low], [right, depth, riser], frame, without="back bottom", variant=variant))
    panes = max(1, round((right - left) / 1.7))
    edges = np.linspace(left, right, panes + 1)
    glass = np.stack([edges[:-1], edges[1:], np.full(panes, riser), np.full(panes, high)], axis=1)
    names = (variant + 17 * np.arange(panes)).astype(np.uint32)
    parts += displays(glass, depth, names, style.salt)
    posts = [(x - 0.04, depth - 0.08, low, x + 0.04, depth, high) for x in (*edges, a + 0.04, b - 0.04)]
    parts.append(boxes_of(posts, frame, without="back bottom", variant=variant))
    parts.append(pane(np.array([[*entry, low, low + 0.5]]), depth, Material.DOOR, variant))
    parts.append(pane(np.array([[*entry, low + 0.5, high]]), depth, Material.SHOP_WINDOW, variant + 5))
    sign = left, right, foot, top = np.array([a - 0.15, b + 0.15, high + 0.08, high + 0.68])
    board = boxes([left, -0.14, foot], [right, 0.0, top], Material.WOOD, without="front back", variant=variant)
    parts += [board, name_board(sign, -0.14, variant)]
    if awning:
        parts.append(_awning(a, b, high + 0.05, variant))
    return parts


def name_board(rect: Array, y: float, variant: int) -> Shape:
    """A board (4,) at a depth with a word in its middle."""
    x0, x1, z0, z1 = rect
    half = min(x1 - x0, 4 * (z1 - z0)) / 2
    edges = np.array([x0, (x0 + x1) / 2 - half, (x0 + x1) / 2 + half, x1])
    parts = np.stack([edges[:-1], edges[1:], np.full(3, z0), np.full(3, z1)], axis=1)
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    # What is beside the word shows the plain edge of its cell.
    uv = np.full((3, 4, 2), 0.02)
    uv[1] = corners * (BOARD_M, BOARD_M / 4)
    return quads(corners_of(parts, y), Material.SHOP_SIGN, uv, variant=variant)


def _awning(x0: float, x1: float, z: float, variant: int) -> Shape:
    """A sloping cloth above the pavement with a hanging edge, visible from both sides."""
    reach, drop = 1.1, 0.55
    low = z - drop - 0.2
    cloth = np.array(
        [
            [(x0, 0, z), (x0, -reach, z - drop), (x1, -reach, z - drop), (x1, 0, z)],
            [(x0, -reach, z - drop), (x0, -reach, low), (x1, -reach, low), (x1, -reach, z - drop)],
        ],
        dtype=float,
    )
    under = cloth[:, ::-1] + np.array([0, 0.004, -0.004])
    return quads(np.concatenate([cloth, under]), Material.AWNING, variant=variant ^ 0xA3)
