"""Where people walk: round each block, along the middle of its pavement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.polylines import arc_lengths, inset, points_at
from relocbench.datasets.synthetic.town.shapes import poses
from relocbench.datasets.synthetic.town.streets import KERB_M, Block

_FROM_KERB_M = 1.55
"""between the lamps and bins at the kerb and the steps of the houses on a narrow pavement"""
_WIDE_M = 3.5
"""width from which a pavement has trees and shelters, and people walk behind them"""
_FROM_HOUSES_M = 1.1


@dataclass(frozen=True, eq=False)
class Footpath:
    """A closed line on a pavement."""

    points: Array
    """(P, 2) metres, the last like the first; the block is on the left"""
    lengths: Array
    """(P,) metres along the line"""

    @property
    def length(self) -> float:
        return float(self.lengths[-1])

    def poses(self, s: Array, aside_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """Poses (N, 4, 4) at ``s`` (N,) metres along the line, taken round: x along it, z up from the pavement.

        Args:
            aside_m: to the left of the line, towards the houses.
            yaw_rad: turn to the left.
        """
        at = s % self.length
        i = np.clip(np.searchsorted(self.lengths, at, side="right"), 1, len(self.lengths) - 1)
        d = self.points[i] - self.points[i - 1]
        heading = np.arctan2(d[:, 1], d[:, 0])
        place = points_at(self.points, self.lengths, at)
        x, y = place[:, 0] - aside_m * np.sin(heading), place[:, 1] + aside_m * np.cos(heading)
        return poses(x, y, KERB_M, heading + yaw_rad)


def make_footpaths(blocks: Sequence[Block]) -> tuple[Footpath, ...]:
    """The footpath of each block."""
    return tuple(_round(block) for block in blocks)


def _round(block: Block) -> Footpath:
    outline = np.concatenate(block.kerb_arcs)
    off = [
        _FROM_KERB_M if side.pavement_m < _WIDE_M else max(_FROM_KERB_M, side.pavement_m - _FROM_HOUSES_M)
        for side in block.sides
    ]
    distance = np.concatenate([np.linspace(off[i - 1], off[i], len(arc)) for i, arc in enumerate(block.kerb_arcs)])
    line = inset(outline, distance[:, None])
    points = np.concatenate([line, line[:1]])
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], step > 0.05])]
    return Footpath(points, arc_lengths(points))
