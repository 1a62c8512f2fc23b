"""The nodes of two drives in one numbering, and the odometry edges along each drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise
from relocbench.geometry import invert


@dataclass(frozen=True, eq=False)
class BothDrives:
    """N nodes: the R nodes of the reference first, then those of the query."""

    reference_count: int
    T_odom_node: Array
    """(N, 4, 4) pose of each node, in its own drive's odometry"""
    travelled_m: Array
    """(N,) arc length of each node along its own drive, metres"""
    segment: Indices
    """(N,) number of the segment of odometry that each node lies in; no number is used by both drives"""

    @classmethod
    def of(cls, reference: Nodes, query: Nodes) -> BothDrives:
        """Number the nodes of a reference and a query drive."""
        segments = [nodes.segments().astype(np.int64) for nodes in (reference, query)]
        after = int(segments[0].max(initial=-1)) + 1
        return cls(
            len(reference),
            np.concatenate([reference.T_odom_node, query.T_odom_node]),
            np.concatenate([reference.travelled_m, query.travelled_m]),
            np.concatenate([segments[0], segments[1] + after]),
        )

    def __len__(self) -> int:
        return len(self.T_odom_node)

    def odometry(self, noise: OdometryNoise) -> Edges:
        """Edges from each node to the next in its segment."""
        first = np.arange(len(self) - 1)
        first = first[(self.segment[1:] == self.segment[:-1]) & (first + 1 != self.reference_count)]
        kind = np.where(first < self.reference_count, Kind.REFERENCE_ODOMETRY, Kind.QUERY_ODOMETRY)
        T = invert(self.T_odom_node[first]) @ self.T_odom_node[first + 1]
        return Edges(first, first + 1, T, noise.information(self.arc_length(first, first + 1)), kind.astype(np.int64))

    def arc_length(self, first: Indices, second: Indices) -> Array:
        """Metres driven between pairs of nodes of the same drive."""
        return np.abs(self.travelled_m[second] - self.travelled_m[first])

    def arc_length_to(self, nodes: Indices) -> Array:
        """(N, 2) arc length from each node back to the last, and on to the next, of the given nodes in its segment.

        Both are 0 for the given nodes themselves, and ``inf`` where there is none.
        """
        out = np.full((len(self), 2), np.inf)
        chosen = np.zeros(len(self), dtype=bool)
        chosen[nodes] = True
        for piece in np.unique(self.segment).tolist():
            members = np.flatnonzero(self.segment == piece)
            at = self.travelled_m[members]
            stops = at[chosen[members]]
            if not len(stops):
                continue
            after = np.searchsorted(stops, at, side="left")
            before = np.searchsorted(stops, at, side="right") - 1
            out[members, 0] = np.where(before >= 0, at - stops[np.maximum(before, 0)], np.inf)
            out[members, 1] = np.where(after < len(stops), stops[np.minimum(after, len(stops) - 1)] - at, np.inf)
        return out
