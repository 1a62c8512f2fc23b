"""Two drives of one road without lidar: exact nodes, odometry that drifts, and registrations of known noise.

``benchmarks/lidar/stated_uncertainty.py`` measures on them how honest stated uncertainties are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.pose_graph.graph import Solution
from relocbench.datasets.groundtruth.pose_graph.selection import GraphOptions
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.datasets.synthetic.drives.odometry import OdometryErrors, visual_odometry
from relocbench.geometry import invert, make_transform, se3_exp, se3_log, so3_exp

STEP_M = 0.6
"""sixteen odometry steps a second at 10 m/s"""
NODE_M = 2.0
NO_EVIDENCE = Evidence(0.8, 0.8, 0.01, 0.01, 0.0, 0.0, 0.02, (1.0, 0.0, 0.0), 0.02)
WHITE = OdometryErrors(scale=0.0, turn_rad_per_m=0.0)
"""odometry whose errors are white"""
WHITE_SIGMA = np.array([0.002] * 3 + [2e-4] * 3) / np.sqrt(STEP_M)
"""its standard deviations along a metre, metres and radians"""
INDEPENDENT = GraphOptions(shared_points=False)
"""for registrations that share no points"""
SIGMA = np.array([0.015, 0.008, 0.008, 4e-4, 4e-4, 4e-4])
"""of a registration, metres and radians"""
CAMERA = make_transform(so3_exp([0.0, np.pi / 2, 0.0]) @ so3_exp([0.0, 0.0, -np.pi / 2]), [1.5, 0.0, 1.2])
"""``T_rig_cam`` of a camera that looks ahead"""


@dataclass(frozen=True, eq=False)
class Drive:
    nodes: Nodes
    T_world_node: Array
    """(K, 4, 4) exact"""


def road(length_m: float, lateral_m: float = 0.0, heading: float = 0.0) -> tuple[Array, Array]:
    """(N, 4, 4) true poses every step along a winding road, and (N,) the way."""
    way = np.arange(0.0, length_m, STEP_M)
    yaw = 0.6 * np.sin(way / 90.0) + 0.3 * np.sin(way / 37.0)
    pitch = 0.02 * np.sin(way / 60.0)
    at = np.cumsum(np.stack([np.cos(yaw), np.sin(yaw), -np.sin(pitch)], axis=1) * STEP_M, axis=0)
    side = np.stack([-np.sin(yaw), np.cos(yaw), 0 * yaw], axis=1)
    turn = np.stack([0 * yaw, pitch, yaw + heading], axis=1)
    R = so3_exp(turn[:, 2:] * np.array([0, 0, 1.0])) @ so3_exp(turn[:, 1:2] * np.array([0, 1.0, 0]))
    return make_transform(R, at + lateral_m * side), way


def drive(
    length_m: float, rng: np.random.Generator, errors: OdometryErrors, lateral_m: float = 0.0, start_ns: int = 0
) -> Drive:
    """Nodes every :data:`NODE_M` with odometry that errs."""
    true, way = road(length_m, lateral_m)
    steps = visual_odometry(true, errors, rng)
    odometry = [np.eye(4)]
    for T in steps:
        odometry.append(odometry[-1] @ T)
    chosen = np.unique(np.searchsorted(way, np.arange(0.0, length_m, NODE_M)).clip(max=len(way) - 1))
    nodes = Nodes(start_ns + chosen * 62_500_000, np.stack(odometry)[chosen], way[chosen])
    return Drive(nodes, true[chosen])


def two_drives(
    length_m: float, seed: int, errors: OdometryErrors | None = None
) -> tuple[Drive, Drive, list[Registration]]:
    """A reference, a query 0.7 m beside it, and the registrations of both."""
    rng = np.random.default_rng(seed)
    errors = errors or OdometryErrors()
    reference, query = drive(length_m, rng, errors), drive(length_m, rng, errors, 0.7, 10**12)
    return reference, query, registrations(reference, query, rng)


def registrations(
    reference: Drive,
    query: Drive,
    rng: np.random.Generator,
    offsets: tuple[int, ...] = (0, -3, 3),
    sigma: Array = SIGMA,
    stated: float = 1.0,
) -> list[Registration]:
    """Each query node against the nearest reference node and some of its neighbours.

    Args:
        stated: the sigma that is stated over the true one.
    """
    out = []
    information = np.diag(1.0 / (stated * sigma) ** 2)
    for j, T_world_query in enumerate(query.T_world_node):
        near = int(np.argmin(np.linalg.norm(reference.T_world_node[:, :3, 3] - T_world_query[:3, 3], axis=1)))
        for i in (near + k for k in offsets):
            if 0 <= i < len(reference.nodes):
                T = invert(reference.T_world_node[i]) @ T_world_query @ se3_exp(sigma * rng.normal(size=6))
                out.append(Registration(i, j, T, information, NO_EVIDENCE))
    return out


def slid(registration: Registration, T_wrong: Array) -> Registration:
    """With the query somewhere else."""
    return Registration(
        registration.ref,
        registration.query,
        T_wrong @ registration.T_ref_query,
        registration.information,
        registration.evidence,
    )


def grossly_wrong(registration: Registration, rng: np.random.Generator) -> Registration:
    """Slid along the street by metres, turned a little, or facing the other way."""
    kind = rng.integers(3)
    along = rng.choice([-1, 1]) * rng.uniform(0.5, 30.0)
    if kind == 0:
        return slid(registration, se3_exp([along, 0, 0, 0, 0, 0]))
    if kind == 1:
        return slid(registration, se3_exp([along, rng.normal(), 0, 0, 0, rng.normal() * 0.05]))
    return slid(registration, se3_exp([along, 0, 0, 0, 0, np.pi]))


def with_gross_errors(found: list[Registration], rng: np.random.Generator) -> tuple[list[Registration], Mask]:
    """The registrations, of which each twentieth is grossly wrong, and (N,) which are."""
    wrong = rng.random(len(found)) < 0.05
    return [grossly_wrong(r, rng) if w else r for r, w in zip(found, wrong, strict=True)], wrong


def true_error(reference: Drive, query: Drive, ref: int, query_node: int, T_ref_query: Array) -> Array:
    """(6,) twist from an estimate to the truth, so that its covariance is that of the estimate."""
    true = invert(reference.T_world_node[ref]) @ query.T_world_node[query_node]
    return np.asarray(se3_log(invert(T_ref_query) @ true))


def normalised_squares(solution: Solution, reference: Drive, query: Drive, offsets: tuple[int, ...] = (0,)) -> Array:
    """(M,) squared errors of all pairs of nodes side by side over the stated covariances, divided by six."""
    out = []
    for j in range(len(query.nodes)):
        for i in (j + k for k in offsets):
            if 0 <= i < len(reference.nodes):
                error = true_error(reference, query, i, j, solution.pose(i, j))
                out.append(error @ np.linalg.solve(solution.covariance(i, j), error) / 6)
    return np.array(out)


def translation_errors(solution: Solution, reference: Drive, query: Drive) -> Array:
    """(M,) metres, of all pairs of nodes side by side."""
    return np.array(
        [np.linalg.norm(true_error(reference, query, j, j, solution.pose(j, j))[:3]) for j in range(len(query.nodes))]
    )
