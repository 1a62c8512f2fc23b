"""Panes of glass and what is seen through them: curtains, blinds, and goods in shop windows.

What is behind a pane is drawn on it: a pane is parted into rectangles of glass and of what hangs or lies behind glass.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.datasets.synthetic.town.shapes import Shape, quads

_DRESSES = (0.34, 0.58, 0.78, 0.9)
"""cumulative shares of windows with nothing, two curtains, a blind, and a net in the lower half; others are closed"""
_LEAST_M = 0.015


def corners_of(rect: Array, y: float) -> Array:
    """Corners (N, 4, 3) of rectangles (N, 4) = (x0, x1, z0, z1) at a depth, counter-clockwise seen from -y."""
    corners = np.empty((len(rect), 4, 3))
    corners[..., 0] = rect[:, [0, 1, 1, 0]]
    corners[..., 1] = y
    corners[..., 2] = rect[:, [2, 2, 3, 3]]
    return corners


def pane(rect: Array, y: float, material: Material, variant: NDArray[np.uint32] | int = 0) -> Shape:
    """Rectangles (N, 4) at a depth, each with surface coordinates relative to its lower left corner."""
    corners = corners_of(rect, y)
    uv = corners[:, :, [0, 2]] - corners[:, :1, [0, 2]]
    return quads(corners, material, uv, variant=variant)


def _drawn(variant: NDArray[np.uint32], salt: int, count: int) -> Array:
    """Numbers (N, count) in [0, 1) that depend on each window's variant and on the house alone."""
    return np.stack([np.random.default_rng([salt, int(v)]).random(count) for v in variant])


def glazed(rect: Array, y: float, glass: Material, variant: NDArray[np.uint32], salt: int) -> list[Shape]:
    """Panes (N, 4) at a depth: bare, or with curtains, a blind or a net behind them."""
    dress, amount, skew = _drawn(variant, salt, 3).T
    x0, x1, z0, z1 = rect.T
    wide, high = x1 - x0, z1 - z0
    kind = np.searchsorted(_DRESSES, dress, side="right")
    side = np.where(kind == 1, (0.1 + 0.22 * amount) * wide, 0.0)
    left, right = x0 + side * (0.4 + 1.2 * skew), x1 - side * (1.6 - 1.2 * skew)
    upper = z1 - np.where(kind == 2, (0.15 + 0.75 * amount) * high, 0.0)
    upper = np.where(kind == 4, z0, upper)
    lower = z0 + np.where(kind == 3, (0.35 + 0.3 * amount) * high, 0.0)
    parts = []
    for material, part in (
        (glass, (left, right, lower, upper)),
        (Material.CURTAIN, (x0, left, z0, z1)),
        (Material.CURTAIN, (right, x1, z0, z1)),
        (Material.CURTAIN, (left, right, upper, z1)),
        (Material.CURTAIN, (left, right, z0, np.minimum(lower, upper))),
    ):
        shown = (part[1] - part[0] > _LEAST_M) & (part[3] - part[2] > _LEAST_M)
        if shown.any():
            parts.append(pane(np.stack(part, axis=1)[shown], y, material, variant[shown]))
    return parts


def displays(rect: Array, y: float, variant: NDArray[np.uint32], salt: int) -> list[Shape]:
    """Panes (N, 4) of a shop at a depth, with goods of different heights in front of a darker room."""
    goods, rest, looks, rooms = [], [], [], []
    for (x0, x1, z0, z1), name in zip(rect, variant, strict=True):
        rng = np.random.default_rng([salt, int(name)])
        edges = x0 + (x1 - x0) * np.concatenate([[0.0], np.cumsum(share := rng.uniform(0.4, 1.6, 5)) / share.sum()])
        for k, (a, b) in enumerate(pairwise(edges)):
            top = z0 + (z1 - z0) * rng.choice([0.0, 0.18, 0.3, 0.45, 0.62])
            hung = z1 - (z1 - z0) * rng.choice([0.0, 0.0, 0.0, 0.15])
            look = int(name) ^ (k + 1) * 7919
            for low, high in ((z0, top), (hung, z1)):
                if high > low:
                    goods.append([a, b, low, high])
                    looks.append(look)
            rest.append([a, b, top, hung])
            rooms.append(int(name))
    parts = [pane(np.array(rest), y, Material.SHOP_WINDOW, np.array(rooms, dtype=np.uint32))]
    if goods:
        parts.append(pane(np.array(goods), y, Material.GOODS, np.array(looks, dtype=np.uint32)))
    return parts
