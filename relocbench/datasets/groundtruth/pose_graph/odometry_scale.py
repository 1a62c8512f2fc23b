"""The scale of odometry, estimated from the solved graph.

The scale of visual odometry is off by a percent or so, and changes slowly. This is not noise: it adds up over tens of
metres, and the weak constraints along a street would have to correct it block by block. The scale of each drive is
therefore estimated, in a window along the road, by comparing the steps of the graph with those of the odometry, and
corrected before the final adjustment. Only the ratio of two drives' scales is observable; each gets half of it.

The remaining scale error is not noise either: where nothing constrains the position along the street, it grows with arc
length and not with its root. Covariances therefore have it as unknowns of their own (:class:`Scales`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind
from relocbench.datasets.groundtruth.pose_graph.least_squares import Scales
from relocbench.geometry import invert

_NEAR = 3.0
"""half width of the window, in standard deviations"""
_SIGMA = 0.02
"""standard deviation of the scale error"""
_CHANGE = 0.0015
"""standard deviation of its change after one metre of road; ``sqrt(d)`` times as much after d metres"""
_PIECE_M = 10.0
"""length of road with one scale"""


def scales_of(drives: BothDrives, edges: Edges) -> Scales:
    """An unknown scale for each 10 m of each drive, which changes as a random walk from piece to piece.

    Args:
        edges: E edges; only those of odometry have a scale.
    """
    of_node = np.zeros(len(drives), dtype=np.int64)
    count = 0
    neighbours: list[tuple[int, int]] = []
    begins = []
    for segment in np.unique(drives.segment).tolist():
        members = np.flatnonzero(drives.segment == segment)
        piece = ((drives.travelled_m[members] - drives.travelled_m[members[0]]) // _PIECE_M).astype(np.int64)
        of_node[members] = count + piece
        begins.append(count)
        neighbours += [(count + k, count + k + 1) for k in range(int(piece[-1]))]
        count += int(piece[-1]) + 1
    number = np.where(edges.kind == Kind.REGISTRATION, -1, of_node[edges.first])
    return Scales(
        number,
        np.array(begins, dtype=np.int64),
        _SIGMA,
        np.array(neighbours, dtype=np.int64).reshape(-1, 2),
        _CHANGE * float(np.sqrt(_PIECE_M)),
    )


def rescaled(drives: BothDrives, T_world_node: Array, window_m: float) -> BothDrives:
    """The drives with the scale of their odometry corrected to that of the graph.

    Args:
        T_world_node: (N, 4, 4) poses by the graph.
        window_m: standard deviation of the Gaussian window along the road.
    """
    T_steps = invert(drives.T_odom_node[:-1]) @ drives.T_odom_node[1:]
    by_odometry = np.linalg.norm(T_steps[:, :3, 3], axis=1)
    by_graph = np.linalg.norm((invert(T_world_node[:-1]) @ T_world_node[1:])[:, :3, 3], axis=1)
    begins = np.flatnonzero(np.diff(drives.segment, prepend=-1))
    T_odom_node = drives.T_odom_node.copy()
    for begin, end in zip(begins, [*begins[1:], len(drives)], strict=True):
        steps = slice(begin, end - 1)
        ratio = _scale(drives.travelled_m[begin:end], by_odometry[steps], by_graph[steps], window_m)
        for node in range(begin, end - 1):
            T_step = T_steps[node].copy()
            T_step[:3, 3] *= ratio[node - begin]
            T_odom_node[node + 1] = T_odom_node[node] @ T_step
    return replace(drives, T_odom_node=T_odom_node)


def _scale(travelled_m: Array, by_odometry: Array, by_graph: Array, window_m: float) -> Array:
    """(K - 1,) ratio of the graph's to the odometry's mean step length in a window around each step between K nodes."""
    middle = 0.5 * (travelled_m[1:] + travelled_m[:-1])
    ratio = np.ones(len(middle))
    first = np.searchsorted(middle, middle - _NEAR * window_m)
    last = np.searchsorted(middle, middle + _NEAR * window_m)
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        weight = np.exp(-0.5 * np.square((middle[a:b] - middle[k]) / window_m))
        expected = float(weight @ by_odometry[a:b])
        if expected > 0:
            ratio[k] = float(weight @ by_graph[a:b]) / expected
    return ratio
