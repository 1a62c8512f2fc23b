"""Initialisation of the pose graph: each node is placed by the nearest registration and its drive's odometry."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.pose_graph.edges import Edges
from relocbench.geometry import invert


def initial_poses(edges: Edges, T_odom_node: Array, travelled_m: Array, segment: Indices) -> Array:
    """Initial poses of all nodes, in the odometry frame of the first segment.

    One segment after another is placed relative to those that are placed already, each of its nodes by the registration
    nearest to it along its drive. Neighbouring nodes of two drives thus start near each other, however far both have
    drifted.

    Args:
        edges: the registrations to use.
        T_odom_node: (N, 4, 4) of all nodes, each in its own odometry.
        travelled_m: (N,) arc length of each node along its drive.
        segment: (N,) number of the segment of odometry that each node lies in.

    Returns:
        (N, 4, 4) ``T_world_node``; segments that no registration ties keep their poses by odometry.
    """
    T_world_node = T_odom_node.copy()
    placed = segment == segment[0]
    while True:
        forward = placed[edges.first] & ~placed[edges.second]
        backward = placed[edges.second] & ~placed[edges.first]
        if not (forward.any() or backward.any()):
            return T_world_node
        known = np.concatenate([edges.first[forward], edges.second[backward]])
        new = np.concatenate([edges.second[forward], edges.first[backward]])
        T_known_new = np.concatenate([edges.T_first_second[forward], invert(edges.T_first_second[backward])])
        # The segment that most registrations tie is placed first.
        names, counts = np.unique(segment[new], return_counts=True)
        chosen = names[np.argmax(counts)]
        links = np.flatnonzero(segment[new] == chosen)
        nodes = np.flatnonzero(segment == chosen)
        apart = np.abs(travelled_m[nodes, None] - travelled_m[None, new[links]])
        by = links[np.argmin(apart, axis=1)]
        T_new_node = invert(T_odom_node[new[by]]) @ T_odom_node[nodes]
        T_world_node[nodes] = T_world_node[known[by]] @ T_known_new[by] @ T_new_node
        placed[nodes] = True
