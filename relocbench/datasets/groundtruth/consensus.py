"""Which registrations agree with those nearby: a vote that needs no start, before any graph is solved.

Two registrations and the odometry of both drives between them form a cycle. After Mangelsen et al., Pairwise consistent
measurement set maximization (2018), but with a local vote in place of the largest clique: one drive has thousands of
registrations, wrong ones come in runs, and right ones are the majority of every longer stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.edges import Edges
from relocbench.errors import ConfigError
from relocbench.geometry import invert, rotation_angle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VoteOptions:
    """Who votes about whom, and what cycles may miss."""

    reach_m: float = 60.0
    """registrations no further away than this along both drives vote"""
    closure_m: float = 0.5
    """by which a cycle may fail to close however short it is"""
    closure_per_m: float = 0.03
    """by which more, for each metre of its way along one drive"""
    closure_deg: float = 2.0
    """in angle"""
    share: float = 0.5
    """of its voters that a registration needs"""

    def __post_init__(self) -> None:
        if min(self.reach_m, self.closure_m, self.closure_deg) <= 0 or not 0 < self.share <= 1:
            raise ConfigError("a vote needs positive limits and a share in (0, 1]")


def agreeing(
    edges: Edges, T_odom_node: Array, travelled_m: Array, stretch: NDArray[np.int64], options: VoteOptions
) -> NDArray[np.bool_]:
    """Whether each registration closes cycles with the larger part of those nearby.

    Args:
        edges: E registrations.
        T_odom_node: (N, 4, 4) of all nodes, each in its own drive's odometry.
        travelled_m: (N,) along its own drive.
        stretch: (N,) number of the piece of odometry, different for both drives.

    Returns:
        (E,) a registration without any other nearby passes: there is nobody to speak against it.
    """
    way_first, way_second = travelled_m[edges.first], travelled_m[edges.second]
    order = np.argsort(way_second, kind="stable")
    # The query's odometry frame seen from the reference's, as each registration puts it.
    T_a_b = T_odom_node[edges.first] @ edges.T_first_second @ invert(T_odom_node[edges.second])
    sorted_way = way_second[order]
    out = np.ones(len(edges), dtype=bool)
    for e in range(len(edges)):
        near = order[
            np.searchsorted(sorted_way, way_second[e] - options.reach_m) : np.searchsorted(
                sorted_way, way_second[e] + options.reach_m, side="right"
            )
        ]
        apart = np.maximum(np.abs(way_first[near] - way_first[e]), np.abs(way_second[near] - way_second[e]))
        same = (stretch[edges.first[near]] == stretch[edges.first[e]]) & (
            stretch[edges.second[near]] == stretch[edges.second[e]]
        )
        near = near[(apart <= options.reach_m) & same & (near != e)]
        if not len(near):
            continue
        # What the neighbour says of this query node, against what the registration itself says.
        T_said = invert(T_odom_node[edges.first[e]]) @ T_a_b[near] @ T_odom_node[edges.second[e]]
        offset = invert(edges.T_first_second[e]) @ T_said
        apart = np.maximum(np.abs(way_first[near] - way_first[e]), np.abs(way_second[near] - way_second[e]))
        metres = np.linalg.norm(offset[:, :3, 3], axis=1)
        closed = metres <= options.closure_m + options.closure_per_m * apart
        closed &= np.degrees(rotation_angle(offset[:, :3, :3])) <= options.closure_deg
        out[e] = closed.mean() >= options.share
    return out
