"""The last word: every block of the query against the reference's blocks beside it, all in one adjustment.

A submap is laid along the odometry and carries its drift. A block is too short for that. Points of single blocks are
therefore linearised at the present solution and enter the graph as Gaussian edges of their own, and again at the better
solution: a non-rigid registration of two trajectories, in which each point counts once. What a block leaves open (the
way along a smooth wall) its neighbours and the odometry close.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.edge_information import (
    minimum,
    sandwich_information,
    with_block_distortion,
)
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind
from relocbench.datasets.groundtruth.pose_graph.graph import Solution
from relocbench.datasets.groundtruth.pose_graph.least_squares import Covariances, solve
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise, estimate, variance_factor
from relocbench.datasets.groundtruth.pose_graph.odometry_scale import rescaled
from relocbench.datasets.groundtruth.pose_graph.outlier_test import check_used
from relocbench.datasets.groundtruth.pose_graph.selection import check_odometry, downweighted, noise_converged, spread
from relocbench.errors import ConfigError
from relocbench.geometry import invert, se3_exp

Array = NDArray[np.float64]

_NOISE_ROUNDS = 4
"""of solving and estimating noise, each iteration"""


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Distances from points of a query block to planes of a reference block, linearised at a pose."""

    H: Array
    """(6, 6) sum of w J J^T over the points, by xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)``"""
    g: Array
    """(6,) sum of w J r, metres"""
    sigma_m: float
    """robust standard deviation of the distances r"""
    count: int
    """points that found a plane"""
    scatter: Array | None = None
    """(6, 6) of g, as its parts say (:func:`scatter_by_patch`); None: all points err alike, with sigma_m"""


Linearise = Callable[[int, int, Array], LocalFit]
"""(reference node, query node, ``T_ref_query`` (4, 4)) -> the fit of their blocks there"""


@dataclass(frozen=True)
class LocalOptions:
    """Which blocks meet, and how much a point is worth."""

    reach_m: float = 8.0
    """reference blocks whose nodes lie no further from the query block's node meet it"""
    trusted_within_m: float = 20.0
    """along the road from a trusted registration: further away, blocks would be drawn to whatever lies near"""
    correlation: float = 4.0
    """neighbouring points err alike: so many count as one, where a fit does not say how alike"""
    repeats: float = 6.0
    """each point meets about so many blocks of the other drive, and takes part in as many edges"""
    inside_m: float = 3.0
    """odometry over so many metres distorts the two blocks of an edge"""
    scale_m: float = 30.0
    """of road over which the scale of the odometry is found (:mod:`.odometry_scale`)"""
    least_sigma_m: float = 0.003
    """of a distance, however well the points of a block fit"""
    least_count: int = 10
    """points of a block without which it is left out"""
    iterations: int = 4
    settled_m: float = 5e-4
    """the iterations end when no block moves further against its neighbour"""
    characteristic_length_m: float = 10.0
    """at which rotations are weighed against translations when directions are called open"""
    open_share: float = 1e-4
    """a direction with so little of the strongest one's information is open: it is not moved, and keeps what it has"""
    significance: float = 1e-6
    """probability with which a right edge is thrown out"""
    estimate_noise: bool = True
    noise_edges: int = 400
    """edges of each kind that noise is estimated from"""

    def __post_init__(self) -> None:
        positive = (
            self.reach_m,
            self.trusted_within_m,
            self.correlation,
            self.least_sigma_m,
            self.characteristic_length_m,
            self.scale_m,
        )
        if min(positive) <= 0 or min(self.iterations, self.least_count, self.noise_edges, self.repeats) < 1:
            raise ConfigError("reaches, correlation, sigma and counts of local edges must be positive")
        if not 0 < self.open_share < 1 or not 0 < self.significance < 1:
            raise ConfigError("open_share and significance of local edges lie between 0 and 1")


def refine_locally(solution: Solution, linearise: Linearise, options: LocalOptions | None = None) -> Solution:
    """The solution with its registrations replaced by edges between single blocks.

    Args:
        solution: near enough for points to find their planes; verdicts and trust are kept.
        linearise: fits blocks; called for every pair of blocks that meet, once an iteration.
    """
    options = options or LocalOptions()
    pairs = neighbouring_blocks(solution, options)
    T, noise, factor = solution.T_world_node, solution.noise, 1.0
    local = solution.edges[np.zeros(0, dtype=np.int64)]
    odometry = solution.drives.odometry(noise)
    for attempt in range(2):
        # First with the odometry as it is, then with its scale as that has shown it to be.
        drives = rescaled(solution.drives, T, options.scale_m) if attempt else solution.drives
        odometry = drives.odometry(noise)
        for _ in range(options.iterations):
            before = T
            local = local_edges(solution, T, pairs, linearise, options, noise)
            T, local = _without_outliers(T, odometry, local, factor, options)
            for _ in range(_NOISE_ROUNDS if options.estimate_noise else 0):
                assumed = noise, factor
                noise, factor = _noise(drives, T, assumed, local, options)
                odometry = drives.odometry(noise)
                T = solve(T, Edges.join([odometry, downweighted(local, factor)]))
                if noise_converged(assumed, (noise, factor)):
                    break
            moved = invert(local.apart(before)) @ local.apart(T)
            if np.linalg.norm(moved[:, :3, 3], axis=1).max(initial=0.0) < options.settled_m:
                break
    edges = Edges.join([odometry, downweighted(local, factor)])
    T = solve(T, edges)
    return replace(
        solution,
        T_world_node=T,
        edges=edges,
        noise=noise,
        odometry_tested=check_odometry(T, edges),
        information_factor=factor,
    )


def neighbouring_blocks(solution: Solution, options: LocalOptions) -> list[tuple[int, int]]:
    """(reference node, query node) of all blocks that meet, in the order of the query's drive.

    Near in space is not enough: where a street is driven twice, nothing but drifted odometry may tell how one time lies
    to the other. A registration must say of both nodes, along their drives, that they belong together.
    """
    drives, count = solution.drives, solution.drives.reference_count
    near = solution.arc_length_to_trusted.min(axis=1) <= options.trusted_within_m
    registered = solution.edges[solution.edges.kind == Kind.REGISTRATION]
    out = []
    for query in np.flatnonzero(near[count:]).tolist():
        apart = np.linalg.norm(solution.T_world_ref[:, :3, 3] - solution.T_world_query[query, :3, 3], axis=1)
        close = np.flatnonzero((apart <= options.reach_m) & near[:count])
        around = registered.first[_along(drives, count + query, registered.second) <= options.trusted_within_m]
        out += [
            (ref, query) for ref in close.tolist() if (_along(drives, ref, around) <= options.trusted_within_m).any()
        ]
    return out


def _along(drives: BothDrives, node: int, others: NDArray[np.int64]) -> Array:
    """(M,) metres along its drive from a node to others; ``inf`` where a gap of the odometry lies between."""
    arc_length = np.abs(drives.travelled_m[others] - drives.travelled_m[node])
    return np.where(drives.segment[others] == drives.segment[node], arc_length, np.inf)


def local_edges(
    solution: Solution,
    T_world_node: Array,
    pairs: list[tuple[int, int]],
    linearise: Linearise,
    options: LocalOptions,
    noise: OdometryNoise,
) -> Edges:
    """Edges of blocks that meet: ``T_ref_query @ se3_exp(-H^+ g)``, with the information of their fit less what the
    odometry inside the blocks takes from it."""
    count = solution.drives.reference_count
    first, second, poses, information = [], [], [], []
    for ref, query in pairs:
        T_ref_query = invert(T_world_node[ref]) @ T_world_node[count + query]
        fit = linearise(ref, query, T_ref_query)
        if fit.count < options.least_count:
            continue
        first.append(ref)
        second.append(count + query)
        poses.append(T_ref_query @ se3_exp(minimum(fit.H, fit.g, options.characteristic_length_m, options.open_share)))
        information.append(with_block_distortion(_information(fit, options), options.inside_m * noise.sigma**2))
    return Edges(
        np.array(first, dtype=np.int64),
        np.array(second, dtype=np.int64),
        np.array(poses, dtype=np.float64).reshape(-1, 4, 4),
        np.array(information, dtype=np.float64).reshape(-1, 6, 6),
        np.full(len(first), Kind.REGISTRATION, dtype=np.int64),
    )


def _information(fit: LocalFit, options: LocalOptions) -> Array:
    if fit.scatter is None:
        return np.asarray(fit.H / (max(fit.sigma_m, options.least_sigma_m) ** 2 * options.correlation))
    floor = options.least_sigma_m**2 * options.correlation
    return sandwich_information(fit.H, options.repeats * fit.scatter, floor, options.characteristic_length_m)


def _without_outliers(
    T: Array, odometry: Edges, local: Edges, factor: float, options: LocalOptions
) -> tuple[Array, Edges]:
    """Poses, and the local edges that fit them."""
    from scipy.special import chdtri

    T = solve(T, Edges.join([odometry, downweighted(local, factor)]))
    chi2 = local.chi2(T) / factor
    typical = max(1.0, float(np.median(chi2)) / 5.348) if len(local) else 1.0
    fitting = chi2 <= typical * chdtri(6, options.significance)
    if fitting.all():
        return T, local
    kept = local[fitting]
    return solve(T, Edges.join([odometry, downweighted(kept, factor)])), kept


def _noise(
    drives: BothDrives, T: Array, before: tuple[OdometryNoise, float], local: Edges, options: LocalOptions
) -> tuple[OdometryNoise, float]:
    """Odometry's noise, and by how much local edges overstate themselves, from the poses solved with those before."""
    noise, factor = before
    odometry, local = drives.odometry(noise), downweighted(local, factor)
    covariances = Covariances(T, Edges.join([odometry, local]))
    some = odometry[spread(len(odometry), options.noise_edges)]
    posterior = np.diagonal(covariances.relative(some.first, some.second), axis1=1, axis2=2)
    noise = estimate(noise, drives.arc_length(some.first, some.second), some.residuals(T), posterior)
    some = local[spread(len(local), options.noise_edges)]
    tested = check_used(some.residuals(T), some.information, covariances.relative(some.first, some.second))
    more = variance_factor(tested.squares.ravel(), tested.redundancy_numbers.ravel())
    return noise, factor if more is None else max(1.0, factor * more)
