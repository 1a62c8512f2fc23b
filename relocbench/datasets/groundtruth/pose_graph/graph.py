"""The pose graph of two drives: poses of all nodes from both odometries and all registrations, with covariances.

The world is the odometry frame of the reference's first segment. Segments of odometry are tied to each other only by
registrations. Several query drives are solved one by one against the same reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.consensus import find_runs
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind, components
from relocbench.datasets.groundtruth.pose_graph.least_squares import Covariances
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise
from relocbench.datasets.groundtruth.pose_graph.odometry_scale import scales_of
from relocbench.datasets.groundtruth.pose_graph.outlier_test import OutlierTest
from relocbench.datasets.groundtruth.pose_graph.selection import GraphOptions, Selected, select
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.geometry import adjoint, invert, rotation_angle

_CONTROLLED = 1.0
"""least redundancy, out of six, of a registration that others confirm"""


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Errors that all edges have in common, such as those of the lidars' calibration."""

    by_shared: Array
    """(N, 6, K) derivative of the poses' twists, ``T_world_node @ se3_exp(twist)``, by the shared errors"""
    covariance: Array
    """(K, K)"""

    def relative(self, first: int, second: int, T_second_first: Array) -> Array:
        """(6, 6) the covariance that they add to ``xi`` in ``T_first_second @ se3_exp(xi)``."""
        by = self.by_shared[second] - adjoint(T_second_first) @ self.by_shared[first]
        return np.asarray(by @ self.covariance @ by.T)


@dataclass(frozen=True, eq=False)
class Solution:
    """The solved pose graph: poses of both drives' nodes in one world, with covariances."""

    drives: BothDrives
    T_world_node: Array
    """(N, 4, 4) poses of the R nodes of the reference, then of the Q nodes of the query"""
    edges: Edges
    """the edges of the graph, with the information they had"""
    noise: OdometryNoise
    """noise of odometry that the graph was solved with"""
    trusted: Mask
    """(E,) whether each registration is part of the graph and confirmed by others"""
    verdicts: tuple[str, ...]
    """(E,) why each registration is not part of the graph; empty if it is"""
    odometry_tested: OutlierTest
    """test of each odometry edge against the rest of the graph"""
    arc_length_to_trusted: Array
    """(N, 2) arc length back to the last and on to the next node with a trusted registration, metres"""
    information_factor: float = 1.0
    """factor that the information of registrations was divided by"""
    shared: SharedErrors | None = None
    """errors that all edges have in common"""

    @property
    def T_world_ref(self) -> Array:
        """(R, 4, 4)"""
        return self.T_world_node[: self.drives.reference_count]

    @property
    def T_world_query(self) -> Array:
        """(Q, 4, 4)"""
        return self.T_world_node[self.drives.reference_count :]

    @cached_property
    def part(self) -> Indices:
        """(N,) the connected part of the graph that each node is in: the smallest number of its nodes."""
        return components(len(self.drives), self.edges.first, self.edges.second)

    def connected(self, ref: int, query: int) -> bool:
        """Whether the graph connects a reference node and a query node, so that their relative pose is known."""
        return bool(self.part[ref] == self.part[self.drives.reference_count + query])

    def pose(self, ref: int, query: int) -> Array:
        """(4, 4) ``T_ref_query``, node to node."""
        return np.asarray(invert(self.T_world_ref[ref]) @ self.T_world_query[query])

    @cached_property
    def _covariances(self) -> Covariances:
        return Covariances(self.T_world_node, self.edges, scales_of(self.drives, self.edges))

    def covariance(self, ref: int, query: int, shared: bool = True) -> Array:
        """(6, 6) covariance of ``xi = (rho, phi)`` in ``T_ref_query @ se3_exp(xi)``, node to node.

        Calls in the order of the road are fastest, since neighbouring pairs share most of the work.

        Args:
            shared: whether errors that all edges have in common are part of the covariance.

        Raises:
            ValueError: nothing connects the two nodes.
        """
        if not self.connected(ref, query):
            raise ValueError(f"nothing connects reference node {ref} with query node {query}")
        second = query + self.drives.reference_count
        covariance = self._covariances.relative(np.array([ref]), np.array([second]))[0]
        if shared and self.shared is not None:
            covariance = covariance + self.shared.relative(ref, second, invert(self.pose(ref, query)))
        return np.asarray(covariance)

    def contradicted_odometry(self, significance: float = 1e-9) -> list[tuple[int, int]]:
        """Odometry edges that registrations contradict: (node, next node).

        A run of wrong registrations that agree with each other, as repeating facades cause it, shows at its ends. Nodes
        are numbered as in :class:`BothDrives`.
        """
        odometry = self.edges[self.edges.kind != Kind.REGISTRATION]
        bad = np.flatnonzero(self.odometry_tested.p_value < significance)
        return [(int(odometry.first[e]), int(odometry.second[e])) for e in bad]


def optimise(
    nodes_ref: Nodes,
    nodes_query: Nodes,
    registrations: Sequence[Registration],
    odometry_noise: OdometryNoise | None = None,
    options: GraphOptions | None = None,
) -> Solution:
    """Solve for the poses of all nodes from both odometries and the registrations between them.

    Args:
        registrations: in any order; those that are not trusted are left out, with their reason as the verdict.
        odometry_noise: the noise to start from; it is estimated unless the options disable this.
    """
    options = options or GraphOptions()
    drives = BothDrives.of(nodes_ref, nodes_query)
    cross = registration_edges(drives, registrations)
    trusted = np.array([r.trusted for r in registrations], dtype=bool)
    believed = np.flatnonzero(trusted)
    runs = find_runs(cross[believed], drives, options.runs)
    candidates, doubtful = trusted.copy(), np.zeros(len(cross), dtype=bool)
    candidates[believed], doubtful[believed] = runs.won, runs.doubtful
    start = initial_poses(cross[candidates], drives)
    selected = select(drives, cross, candidates, start, odometry_noise or OdometryNoise(), options)
    verdicts = _verdicts(registrations, cross, candidates, doubtful, selected)
    controlled = selected.used & (selected.tested.redundancy >= _CONTROLLED)
    return Solution(
        drives,
        selected.T_world_node,
        selected.edges,
        selected.noise,
        controlled,
        verdicts,
        selected.odometry_tested,
        drives.arc_length_to(np.concatenate([cross.first[controlled], cross.second[controlled]])),
        selected.information_factor,
    )


def registration_edges(drives: BothDrives, registrations: Sequence[Registration]) -> Edges:
    """The registrations as edges, in their order."""
    return Edges.of_registrations(
        [r.ref for r in registrations],
        [r.query + drives.reference_count for r in registrations],
        [r.T_ref_query for r in registrations],
        [r.information for r in registrations],
    )


def _verdicts(
    registrations: Sequence[Registration], cross: Edges, candidates: Mask, doubtful: Mask, selected: Selected
) -> tuple[str, ...]:
    """Why each registration is not part of the graph, with its distance from the solution; empty if it is."""
    T = selected.T_world_node
    offset = invert(cross.T_first_second) @ cross.relative_poses(T)
    metres = np.linalg.norm(offset[:, :3, 3], axis=1)
    degrees = np.degrees(rotation_angle(offset[:, :3, :3]))
    out = []
    for e, registration in enumerate(registrations):
        off = f"{metres[e]:.2f} m, {degrees[e]:.2f} deg off"
        if selected.used[e]:
            out.append("")
        elif registration.reason:
            out.append(registration.reason)
        elif doubtful[e]:
            out.append("runs of registrations contradict each other and none is much longer")
        elif candidates[e]:
            out.append(f"contradicts both odometries and other registrations: {off}")
        else:
            out.append(f"contradicts a longer run of registrations: {off}")
    return tuple(out)


def initial_poses(edges: Edges, drives: BothDrives) -> Array:
    """Initial poses of all nodes, in the odometry frame of the first segment.

    One segment after another is placed relative to those that are placed already, each of its nodes by the registration
    nearest to it along its drive. Neighbouring nodes of two drives thus start near each other, however far both have
    drifted.

    Args:
        edges: the registrations to use.

    Returns:
        (N, 4, 4) ``T_world_node``; segments that no registration ties keep their poses by odometry.
    """
    T_odom_node, travelled_m, segment = drives.T_odom_node, drives.travelled_m, drives.segment
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
