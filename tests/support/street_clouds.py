"""Clouds of a street made of planes, sampled as a car that drives along x would measure them; the truth is exact."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes, Surface
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.geometry import apply, invert, make_transform, so3_exp

HEIGHT = 1.8
"""of the sensor"""


@dataclass(frozen=True)
class Street:
    """Facades on both sides: where each begins along x, and how far behind y = 9 it stands."""

    starts: tuple[Array, Array]
    depths: tuple[Array, Array]
    length: float


def irregular(seed: int, length: float = 240.0, deepest: float = 4.0) -> Street:
    """A street whose houses differ; ``deepest`` 0 makes it two bare walls."""
    rng = np.random.default_rng(seed)
    starts, depths = [], []
    for _ in range(2):
        at = np.cumsum(rng.uniform(4.0, 13.0, size=round(length / 4)))
        starts.append(np.concatenate([[0.0], at[at < length]]))
        depths.append(rng.uniform(0.0, deepest, size=len(starts[-1])))
    return Street((starts[0], starts[1]), (depths[0], depths[1]), length)


def periodic(period: float, length: float = 240.0) -> Street:
    """A street of the same two house fronts over and over."""
    starts = np.arange(0.0, length, period / 2)
    depths = np.where(np.arange(len(starts)) % 2 == 0, 0.0, 1.2)
    return Street((starts, starts), (depths, depths), length)


def measure(street: Street, seed: int, low: float, high: float, noise: float = 0.01) -> dict[str, Array]:
    """Points in the street's frame between two places along x, with normals, origins and surface."""
    rng = np.random.default_rng(seed)
    points, normals, origins, surface = [], [], [], []

    def add(p: Array, normal: tuple[float, float, float], origin_x: Array, kind: Surface) -> None:
        inside = (p[:, 0] > low) & (p[:, 0] < high) & (origin_x > low) & (origin_x < high)
        n = np.broadcast_to(np.array(normal), p.shape)
        points.append((p + noise * rng.normal(size=(len(p), 1)) * n)[inside])
        normals.append(n[inside])
        origins.append(np.column_stack([origin_x, np.zeros(len(p)), np.full(len(p), HEIGHT)])[inside])
        surface.append(np.full(int(inside.sum()), kind))

    for side, sign in enumerate((1.0, -1.0)):
        starts, depths = street.starts[side], street.depths[side]
        ends = np.append(starts[1:], street.length)
        for k, (begin, end, depth) in enumerate(zip(starts, ends, depths, strict=True)):
            count = round((end - begin) * 6.0 * 25)
            x, z = rng.uniform(begin, end, count), rng.uniform(0.3, 6.3, count)
            wall = np.column_stack([x, np.full(count, sign * (9 + depth)), z])
            add(wall, (0.0, -sign, 0.0), x, Surface.STRUCTURE)
            if k + 1 < len(depths) and abs(depths[k + 1] - depth) > 0.1:
                # The flank of the house that stands further forward, seen slantwise from where the other one is.
                near, far = sorted((depth, float(depths[k + 1])))
                back = 1.0 if depths[k + 1] > depth else -1.0
                count = round((far - near) * 6.0 * 40)
                y = rng.uniform(9 + near, 9 + far, count)
                flank = np.column_stack([np.full(count, end), sign * y, rng.uniform(0.3, 6.3, count)])
                add(flank, (back, 0.0, 0.0), np.full(count, end) + back * 0.3 * y, Surface.STRUCTURE)
    count = round((high - low) * 16 * 8)
    x = rng.uniform(low, high, count)
    add(np.column_stack([x, rng.uniform(-8, 8, count), np.zeros(count)]), (0.0, 0.0, 1.0), x, Surface.GROUND)
    return {
        "points": np.concatenate(points),
        "normals": np.concatenate(normals),
        "origins": np.concatenate(origins),
        "surface": np.concatenate(surface),
    }


def submap(street: Street, seed: int, T_street_node: Array, half: float = 30.0, node: int = 0) -> Submap:
    """The submap of a node that stands somewhere on the street."""
    at = float(T_street_node[0, 3])
    measured = measure(street, seed, at - half, at + half)
    T_node_street = invert(T_street_node)
    points, origins = (apply(T_node_street, measured[name]) for name in ("points", "origins"))
    normals = measured["normals"] @ T_node_street[:3, :3].T
    count = len(points)
    return Submap(
        points.astype(np.float32),
        normals.astype(np.float32),
        origins.astype(np.float32),
        measured["surface"].astype(np.uint8),
        np.ones(count, np.float32),
        np.zeros(count, np.int32),
    )


def pose(x: float, y: float = 0.0, yaw_deg: float = 0.0) -> Array:
    """(4, 4) ``T_street_node`` of a car at a place, turned to the left."""
    return make_transform(so3_exp([0.0, 0.0, np.radians(yaw_deg)]), [x, y, 0.0])


class Drive:
    """A drive along a street: nodes every two metres with odometry that drifts, submaps laid along the truth."""

    def __init__(self, street: Street, seed: int, first: float, last: float, lateral: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self.street, self.seed, self.stretch = street, seed, 1.0
        self.T_street_node = np.array([pose(x, lateral, float(rng.normal())) for x in np.arange(first, last, 2.0)])
        steps = invert(self.T_street_node[:-1]) @ self.T_street_node[1:]
        steps[:, :3, 3] *= 1.01
        odometry = [np.eye(4)]
        for step in steps:
            odometry.append(odometry[-1] @ step)
        count = len(odometry)
        self.nodes = Nodes(np.arange(count) * 200_000_000, np.array(odometry), np.arange(count, dtype=float) * 2.0)

    def at(self, node: int) -> Submap:
        true = submap(self.street, 1000 * self.seed + node, self.T_street_node[node], node=node)
        along = np.array([self.stretch, 1.0, 1.0], np.float32)
        return replace(true, points=true.points * along, origins=true.origins * along)

    def stretched(self, factor: float) -> Drive:
        """The drive by odometry that is ``factor`` times as long, and submaps that are stretched with it."""
        other = copy(self)
        other.nodes, other.stretch = self.nodes.stretched(factor), self.stretch * factor
        return other
