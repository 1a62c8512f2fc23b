"""Where people walk: round each block, along the middle of its pavement, and across the road on zebras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.network import ZEBRA_M, HalfEdge, StreetNetwork
from relocbench.datasets.synthetic.town.polylines import arc_lengths, edge_frame, inset, points_at
from relocbench.datasets.synthetic.town.shapes import poses
from relocbench.datasets.synthetic.town.streets import KERB_M, Block

_FROM_KERB_M = 1.55
"""between the lamps and bins at the kerb and the steps of the houses on a narrow pavement"""
_WIDE_M = 3.5
"""width from which a pavement has trees and shelters, and people walk behind them"""
_FROM_HOUSES_M = 1.1
_OFF_KERB_M = 0.35
"""distance from the kerb at which those who cross are seen first"""


@dataclass(frozen=True, eq=False)
class Footpath:
    """A closed line on a pavement, or to and fro on a zebra."""

    points: Array
    """(P, 2) metres, the last like the first; the block is on the left"""
    lengths: Array
    """(P,) metres along the line"""
    on_road: bool = False

    @property
    def length(self) -> float:
        return float(self.lengths[-1])

    def poses(self, s: Array, aside_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        """Poses (N, 4, 4) at ``s`` (N,) metres along the line, taken round: x along it, z up from the ground.

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
        return poses(x, y, 0.0 if self.on_road else KERB_M, heading + yaw_rad)


def make_footpaths(network: StreetNetwork, blocks: Sequence[Block]) -> tuple[Footpath, ...]:
    """The footpath of each block, and those on zebras."""
    zebras = [_across(network, edge) for edge in sorted(network.zebras)]
    return *(_round(block) for block in blocks), *zebras


def _across(network: StreetNetwork, edge: HalfEdge) -> Footpath:
    """The way over the zebra before the end of an edge, from kerb to kerb and back."""
    d, to_left, length = edge_frame(*network.nodes[list(edge)])
    middle = network.nodes[edge[0]] + (length - ZEBRA_M) * d
    left, right = network.kerb[edge] - _OFF_KERB_M, network.kerb[edge[::-1]] - _OFF_KERB_M
    points = np.array([middle - right * to_left, middle + left * to_left, middle - right * to_left])
    return Footpath(points, arc_lengths(points), on_road=True)


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
