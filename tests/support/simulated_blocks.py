"""Block fits without lidar: planes beside each pair of blocks, with distances that carry noise of a known size."""

from __future__ import annotations

import numpy as np
from simulated_graph import NO_EVIDENCE, Drive

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalFit, LocalOptions
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.geometry import adjoint, apply, invert, se3_exp


class Planes:
    """Points of query blocks on planes of reference blocks: most blocks see the road and a smooth wall only."""

    def __init__(
        self, reference: Drive, query: Drive, rng: np.random.Generator, count: int = 30, sigma_m: float = 0.02
    ) -> None:
        self.reference, self.query = reference, query
        self.count, self.sigma_m = count, sigma_m
        self.seed = int(rng.integers(2**31))

    def __call__(self, ref: int, query: int, T_ref_query: Array) -> LocalFit:
        """Linearised point-to-plane distances; the same points and noise at every call."""
        rng = np.random.default_rng([self.seed, ref, query])
        true = invert(self.reference.T_world_node[ref]) @ self.query.T_world_node[query]
        points = rng.uniform([-10, -12, -1.5], [10, 12, 6], size=(self.count, 3))
        normals = np.tile([[0.0, 0, 1], [0, 1, 0], [0, -1, 0]], (self.count // 3 + 1, 1))[: self.count]
        if query % 4 == 0:  # an upright edge: what shows the way along the street
            normals[:4] = [1.0, 0, 0]
        normals = normals + 0.02 * rng.normal(size=normals.shape)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        noise = self.sigma_m * rng.normal(size=self.count)
        m = normals @ T_ref_query[:3, :3]
        J = np.hstack([m, np.cross(points, m)])
        r = np.einsum("ni,ni->n", normals, apply(T_ref_query, points) - apply(true, points)) + noise
        H, options = J.T @ J, LocalOptions()
        # Independent distances, of which each takes part in one edge alone: the information is H / sigma_m^2.
        scatter = (self.sigma_m**2 - options.least_sigma_m**2) / options.repeats * H
        return LocalFit(H, J.T @ r, scatter, self.count)


def submap_registrations(planes: Planes, half: int, every: int, rounds: int = 3) -> list[Registration]:
    """Registrations of rigid submaps: blocks laid along the odometry, all their points in one least-squares problem."""
    ref, query = planes.reference, planes.query
    count = len(ref.nodes)
    out = []
    for j in range(0, len(query.nodes), every):
        T = invert(ref.T_world_node[j]) @ query.T_world_node[j]
        H, members = np.zeros((6, 6)), [k for k in range(j - half, j + half + 1) if 0 <= k < count]
        for _ in range(rounds):
            H, g = np.zeros((6, 6)), np.zeros(6)
            for k in members:
                Q_ref = invert(ref.nodes.T_odom_node[j]) @ ref.nodes.T_odom_node[k]
                Q_query = invert(query.nodes.T_odom_node[j]) @ query.nodes.T_odom_node[k]
                fit = planes(k, k, invert(Q_ref) @ T @ Q_query)
                A = adjoint(invert(Q_query))
                H, g = H + A.T @ fit.H @ A, g + A.T @ fit.g
            T = T @ se3_exp(-np.linalg.solve(H, g))
        out.append(Registration(j, j, T, H / planes.sigma_m**2 / 20.0, NO_EVIDENCE))
    return out
