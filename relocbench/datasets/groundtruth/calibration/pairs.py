"""What is compared to calibrate lidars: pairs of blocks that two lidars, of one drive or of two, measured in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.groundtruth.pose_graph.graph import Solution
from relocbench.datasets.groundtruth.pose_graph.selection import evenly_spaced
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.sensors.recording import LidarStream

_MOST_NODES = 150
"""of each drive; with more, they are chosen evenly"""
_ALONG_M = 2.0
"""largest distance along the street between the places of two lidars that measured the same, one of which may be
push-broom and see one plane only"""
_ASIDE_M = 8.0
"""largest distance between these places"""
_SPINNING_M = 4.0
"""largest distance along the street between the places of two spinning lidars of different drives, and least distance
between those of one spinning lidar, which would measure the same twice from one place"""
_SAME_PASS_M = 30.0
"""largest distance along a drive between two blocks of it; over more, odometry is not good to millimetres"""


@dataclass(frozen=True)
class Measured:
    """What one lidar measured along one block of road."""

    drive: int
    """0: reference, 1: query"""
    node: int
    lidar: int


@dataclass(frozen=True, eq=False)
class _Lidar:
    drive: int
    number: int
    stream: LidarStream
    first: int
    """number in the solution of the drive's first node"""
    T_world_node: Array
    travelled_m: Array
    segment: Indices

    @property
    def spins(self) -> bool:
        return self.stream.pattern == "spinning"

    @property
    def positions(self) -> Array:
        """(K, 3) of the lidar at each node of its drive."""
        T = self.T_world_node
        return np.asarray(T[:, :3, :3] @ self.stream.T_rig_lidar[:3, 3] + T[:, :3, 3])


def measured_in_common(solution: Solution, drives: tuple[Drive, Drive], known: Mask) -> list[tuple[Measured, Measured]]:
    """Pairs (planes of, points of), in the order of the drives.

    Args:
        solution: poses of the nodes of ``drives``.
        known: (N,) nodes where the two drives' relative pose is known.
    """
    lidars = _lidars(solution, drives)
    out: list[tuple[Measured, Measured]] = []
    for b in lidars:
        nodes = np.flatnonzero(known[b.first : b.first + len(b.T_world_node)])
        for node in nodes[evenly_spaced(len(nodes), _MOST_NODES)].tolist():
            for a in lidars:
                others = np.flatnonzero(_common(a, b, node, known[a.first : a.first + len(a.T_world_node)]))
                out += [(Measured(a.drive, k, a.number), Measured(b.drive, node, b.number)) for k in others.tolist()]
    return out


def _lidars(solution: Solution, drives: tuple[Drive, Drive]) -> list[_Lidar]:
    count = solution.drives.reference_count
    out = []
    for drive, (first, poses) in enumerate(((0, solution.T_world_ref), (count, solution.T_world_query))):
        mine = slice(first, first + len(poses))
        way, segment = solution.drives.travelled_m[mine], solution.drives.segment[mine]
        out += [
            _Lidar(drive, k, stream, first, poses, way, segment)
            for k, stream in enumerate(drives[drive].recording.lidars)
        ]
    return out


def _common(a: _Lidar, b: _Lidar, node: int, known: Mask) -> Mask:
    """(K,) which blocks of lidar ``a`` show what lidar ``b`` measured at a node. Each pair is compared once."""
    nothing: Mask = np.zeros(len(a.T_world_node), dtype=np.bool_)
    if a.drive > b.drive or (a.drive == b.drive and a.number > b.number):
        return nothing
    apart = a.positions - b.positions[node]
    along = np.abs(apart @ b.T_world_node[node, :3, 0])
    near: Mask = np.linalg.norm(apart, axis=1) <= _ASIDE_M
    both_spin = a.spins and b.spins
    if a.drive != b.drive:
        return np.asarray(near & known & (along <= (_SPINNING_M if both_spin else _ALONG_M)))
    near &= a.segment == b.segment[node]
    way = b.travelled_m[node] - a.travelled_m
    if a.number == b.number:
        return np.asarray(near & (way >= _SPINNING_M)) if both_spin else nothing
    return np.asarray(near & (np.abs(way) <= _SAME_PASS_M) & (along <= _ALONG_M))
