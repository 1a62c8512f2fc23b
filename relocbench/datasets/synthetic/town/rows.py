"""Rows of houses along the blocks, mitred at corners, and rows of identical houses with repeating facades."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.houses.buildings import house_shape
from relocbench.datasets.synthetic.town.houses.house import DEPTH_M, House, door_x, draw_house, terrace_for_rows
from relocbench.datasets.synthetic.town.mesh import Mesh, Semantic
from relocbench.datasets.synthetic.town.polylines import edge_frame
from relocbench.datasets.synthetic.town.shapes import instances
from relocbench.datasets.synthetic.town.streets import KERB_M, Block
from relocbench.geometry import make_transform

PERIOD_M = 4.8
_CORNER = np.radians(35)
_WIDTHS = {"terrace": (5.0, 7.5), "town": (8.0, 14.0), "villa": (8.0, 11.0), "modern": (12.0, 20.0)}


@dataclass(frozen=True, eq=False)
class PeriodicFront:
    """A row of identical facades."""

    start: Array
    """(2,) metres, ground point of the first facade's left edge, seen from the street"""
    end: Array
    """(2,) ground point of the last facade's right edge"""
    period_m: float
    houses: int


@dataclass(frozen=True, eq=False)
class Plot:
    """A house with its place in a block."""

    house: House
    width: float
    left: float
    right: float
    T_world_house: Array
    edge: int
    """index of the block's edge"""
    corner: int
    """index of the block's corner if it is a corner house, else -1"""

    @property
    def door(self) -> Array:
        """(2,) ground point of the door."""
        out: Array = (self.T_world_house @ np.array([door_x(self.house, self.width), 0, 0, 1]))[:2]
        return out


def plots_of(block: Block, rng: np.random.Generator) -> tuple[list[Plot], list[PeriodicFront]]:
    """The houses of a block, in order of its edges, and its rows of identical houses."""
    if block.kind == "square":
        return [], []
    count = len(block.face)
    corner_house = [draw_house(rng, _corner_style(block, i), corner=True) for i in range(count)]
    pattern = terrace_for_rows(rng)
    plots: list[Plot] = []
    fronts: list[PeriodicFront] = []
    for i in range(count):
        row = _Row(block, i, corner_house)
        if block.sides[i].style == "periodic":
            fronts.append(row.repeat(pattern))
        else:
            row.fill(rng)
        plots += row.plots
    return plots, fronts


def _corner_style(block: Block, i: int) -> str:
    style = block.sides[i].style
    return "terrace" if style == "periodic" else style


def _closed(style: str) -> bool:
    """Whether houses of the style stand wall to wall."""
    return style != "villa"


class _Row:
    """The houses along one edge of a block, from left to right as seen from the street."""

    def __init__(self, block: Block, i: int, corner_house: list[House]) -> None:
        self.block, self.i = block, i
        count = len(block.face)
        start, end = block.building[i], block.building[(i + 1) % count]
        d, inward, self.length = edge_frame(start, end)
        self.frame = make_transform(np.stack([[*d, 0], [*inward, 0], [0, 0, 1]], axis=1), [*start, KERB_M])
        self.plots: list[Plot] = []
        self.mitre = [0.0, 0.0]
        self.free = [0.0, self.length]
        corners = i, (i + 1) % count
        for end_of_row, corner in enumerate(corners):
            self._prepare_end(end_of_row, corner)
        self._place_corners(corner_house, corners)

    def _prepare_end(self, end: int, corner: int) -> None:
        """Mitre the row where the next one adjoins, or keep a distance from it."""
        turn = float(self.block.turns[corner])
        other = self.block.sides[self.i - 1 if end == 0 else (self.i + 1) % len(self.block.face)].style
        own = self.block.sides[self.i].style
        sign = 1 if end == 0 else -1
        if (_closed(own) and _closed(other)) or (abs(turn) <= _CORNER and _closed(own)):
            self.mitre[end] = sign * DEPTH_M * float(np.tan(turn / 2))
        elif not _closed(own):
            convex = turn > _CORNER
            self.free[end] += sign * (DEPTH_M + 3.0 if convex and (_closed(other) or end == 0) else 1.5)
        else:
            lean = np.pi - turn
            self.free[end] += sign * max(0.0, DEPTH_M / float(np.tan(lean)) - 1.5) if lean < np.pi / 2 else 0.0

    def _place_corners(self, corner_house: list[House], corners: tuple[int, int]) -> None:
        """Place a house at each mitred corner, whose other half is at the end of the adjoining row."""
        wanted = [0.0, 0.0]
        for end, corner in enumerate(corners):
            if self.mitre[end] and abs(self.block.turns[corner]) > _CORNER:
                wanted[end] = max(9.0, abs(self.mitre[end]) * (self.block.turns[corner] > 0) + 3.5)
        room = self.free[1] - self.free[0]
        if sum(wanted) > room:
            loss = (sum(wanted) - room) / 2
            wanted = [w - loss if all(wanted) else min(w, room) for w in wanted]
        if wanted[0]:
            self._add(corner_house[corners[0]], self.free[0], wanted[0], corners[0])
            self.free[0] += wanted[0]
        if wanted[1]:
            self._add(corner_house[corners[1]], self.free[1] - wanted[1], wanted[1], corners[1])
            self.free[1] -= wanted[1]

    def _add(self, house: House, x: float, width: float, corner: int = -1) -> None:
        """Add a house from x to x + width, mitred if it is at an end of the row."""
        frame = self.frame.copy()
        frame[:3, 3] += self.frame[:3, 0] * x
        left = self.mitre[0] if abs(x) < 1e-6 else 0.0
        right = self.mitre[1] if abs(x + width - self.length) < 1e-6 else 0.0
        self.plots.append(Plot(house, width, left, right, frame, self.i, corner))

    def fill(self, rng: np.random.Generator) -> None:
        """Fill the row with random houses of the side's style; terraced and modern houses often repeat a design."""
        style = self.block.sides[self.i].style
        x, end = self.free
        closed = _closed(style)
        house = draw_house(rng, style)
        for width in _divide(end - x, _WIDTHS[style], rng):
            if rng.random() > {"terrace": 0.6, "modern": 0.3}.get(style, 0.05):
                house = draw_house(rng, style)
            look = replace(house, variant=int(rng.integers(1, 2**31)), door_at=float(rng.random()))
            gap = 0.0 if closed else min(float(rng.uniform(2.0, 3.5)), width - 6.5)
            if width > 4.0:
                self._add(look, x, width - max(gap, 0.0))
            x += width

    def repeat(self, pattern: House) -> PeriodicFront:
        """Fill the row with identical houses, and the remaining gaps at its ends with narrower links."""
        x, end = self.free
        count = int((end - x) // PERIOD_M)
        rest = (end - x - count * PERIOD_M) / 2
        first = x + rest
        for k in range(count):
            self._add(pattern, first + k * PERIOD_M, PERIOD_M)
        other = replace(pattern, variant=pattern.variant ^ 0x5555, chimneys=0)
        for side, width in ((x, rest), (end - rest, rest)):
            if width > 0.05:
                self._add(_link(other), side, width)
        origin, d = self.frame[:2, 3], self.frame[:2, 0]
        return PeriodicFront(origin + first * d, origin + (first + count * PERIOD_M) * d, PERIOD_M, count)


def _link(house: House) -> House:
    """A lower link between neighbouring houses, for a gap of up to one period."""
    return replace(house, floors=1, front=replace(house.front, shutters=False, bay_m=4.0, width=0.9))


def _divide(length: float, widths: tuple[float, float], rng: np.random.Generator) -> Iterator[float]:
    """Random widths that add up to the length."""
    if length < 4.0:
        return
    drawn: list[float] = []
    while sum(drawn) < length - widths[0] / 2:
        drawn.append(float(rng.uniform(*widths)))
    yield from np.array(drawn or [length]) * (length / sum(drawn or [length]))


def build(plots: list[Plot], names: Iterator[int]) -> list[Mesh]:
    """Meshes of the houses; the two halves of a corner house are the same object."""
    corners: dict[int, int] = {}
    meshes = []
    for plot in plots:
        name = corners.setdefault(plot.corner, next(names)) if plot.corner >= 0 else next(names)
        shape = house_shape(plot.house, plot.width, plot.left, plot.right)
        look = np.array([plot.house.variant])
        meshes.append(instances(shape, plot.T_world_house[None], np.array([name]), look, Semantic.BUILDING))
    return meshes
