"""Local edges: the final adjustment, in which each block of the query is tied to the reference's blocks beside it.

A submap contains the drift of the odometry that it was put together along; a single block is too short for that. The
fits of pairs of blocks are therefore linearised at the present solution, enter the graph as edges of their own in place
of the registrations, and are linearised again at the better solution: a non-rigid registration of two trajectories.
Directions that a block leaves open, such as along a smooth wall, are constrained by its neighbours and the odometry.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.edge_information import (
    LENGTH_M,
    minimum,
    sandwich_information,
    with_block_distortion,
)
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind
from relocbench.datasets.groundtruth.pose_graph.graph import Solution
from relocbench.datasets.groundtruth.pose_graph.least_squares import Covariances, solve
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise, variance_factor
from relocbench.datasets.groundtruth.pose_graph.odometry_scale import rescaled
from relocbench.datasets.groundtruth.pose_graph.outlier_test import check_used
from relocbench.datasets.groundtruth.pose_graph.selection import (
    MEDIAN_CHI2,
    check_odometry,
    downweighted,
    evenly_spaced,
    noise_converged,
    reestimated,
)
from relocbench.geometry import invert, make_transform, rotation_angle, se3_exp

_NOISE_ROUNDS = 4
"""number of times that the graph is solved and its noise estimated, in each iteration"""


@dataclass(frozen=True, eq=False)
class LocalFit:
    """The fit of a query block to a reference block: distances from points to planes, linearised at a pose."""

    H: Array
    """(6, 6) sum of w J^T J over the points, in xi = (rho, phi) of ``T_ref_query @ se3_exp(xi)``"""
    g: Array
    """(6,) sum of w J^T r over the points"""
    scatter: Array
    """(6, 6) scatter of g over the patches of surface, by :func:`scatter_by_patch`"""
    count: int
    """number of points that were matched to a plane"""


Linearise = Callable[[int, int, Array], LocalFit]
"""(reference node, query node, ``T_ref_query`` (4, 4)) -> the fit of their blocks at this pose"""


@dataclass(frozen=True)
class LocalOptions:
    """Options that decide which blocks are tied by edges, and with what information."""

    reach_m: float = 8.0
    """largest distance between the nodes of two blocks that are tied"""
    trusted_within_m: float = 20.0
    """largest distance of a block along the road from a trusted registration; further away matches may be wrong"""
    correlation: float = 4.0
    """the least variance of a distance is multiplied by this, since errors of neighbouring points are correlated"""
    repeats: float = 6.0
    """number of edges, on average, that a point takes part in; its scatter is multiplied by this"""
    inside_m: float = 3.0
    """length of odometry whose noise distorts the two blocks of an edge"""
    scale_m: float = 30.0
    """standard deviation of the window, along the road, in which the odometry's scale is estimated"""
    least_sigma_m: float = 0.003
    """least standard deviation of a distance, however well the points of a block fit"""
    least_count: int = 10
    """least number of matched points of an edge"""
    iterations: int = 4
    """largest number of times that the fits are linearised"""
    settled_m: float = 5e-4
    """the iterations end when no pair of tied blocks moves further than this"""
    significance: float = 1e-6
    """probability that a right edge is rejected as an outlier"""
    estimate_noise: bool = True
    """whether the noise of odometry, and the overstatement of the edges' information, are estimated"""
    noise_edges: int = 400
    """number of edges of odometry that its noise is estimated from"""
    factor_edges: int = 120
    """number of other edges that the overstatement of their information is estimated from, in six directions each"""
    moved_m: float = 0.002
    """a fit is linearised anew if its blocks have moved so far since, or turned so far at a distance of 10 m"""


def refine_locally(solution: Solution, linearise: Linearise, options: LocalOptions | None = None) -> Solution:
    """The solution with its registrations replaced by edges between single blocks.

    Args:
        solution: the one to improve, good enough to match points to the right planes; its verdicts are kept.
        linearise: computes the fit of a pair of blocks; called in each iteration for every pair that has moved.
    """
    options = options or LocalOptions()
    fits = _Fits(neighbouring_blocks(solution, options), linearise, options)
    T, noise, factor = solution.T_world_node, solution.noise, 1.0
    local = solution.edges[np.zeros(0, dtype=np.int64)]
    odometry = solution.drives.odometry(noise)
    for attempt in range(2):
        # First with the odometry as it is, then with its scale corrected by the first solution.
        drives = rescaled(solution.drives, T, options.scale_m) if attempt else solution.drives
        odometry = drives.odometry(noise)
        for _ in range(options.iterations):
            before = T
            local = fits.edges(T, solution.drives.reference_count, noise)
            T, local = _without_outliers(T, odometry, local, factor, options)
            for _ in range(_NOISE_ROUNDS if options.estimate_noise else 0):
                assumed = noise, factor
                noise, factor = _noise(drives, T, assumed, local, options)
                odometry = drives.odometry(noise)
                T = solve(T, Edges.join([odometry, downweighted(local, factor)]))
                if noise_converged(assumed, (noise, factor)):
                    break
            moved = invert(local.relative_poses(before)) @ local.relative_poses(T)
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
    """(reference node, query node) of all pairs of blocks to tie, in the order of the query's drive.

    The nodes must be near each other by the solution, and both must be near the nodes of one and the same registration
    along their drives. Distance in space is not enough: where a street is driven twice, only drifted odometry may
    relate one pass to the other.
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


def _along(drives: BothDrives, node: int, others: Indices) -> Array:
    """(M,) arc length from a node to others of its drive; ``inf`` across a gap of the odometry."""
    arc_length = np.abs(drives.travelled_m[others] - drives.travelled_m[node])
    return np.where(drives.segment[others] == drives.segment[node], arc_length, np.inf)


class _Fits:
    """The fits of pairs of blocks, each linearised at about the present poses."""

    def __init__(self, pairs: list[tuple[int, int]], linearise: Linearise, options: LocalOptions) -> None:
        self._pairs, self._linearise, self._options = pairs, linearise, options
        self._poses = np.tile(make_transform(np.eye(3), np.full(3, 1e9)), (len(pairs), 1, 1))
        """where each fit was linearised; far away before it was"""
        self._fits: list[LocalFit | None] = [None] * len(pairs)

    def edges(self, T_world_node: Array, reference_count: int, noise: OdometryNoise) -> Edges:
        """Edges at the minimum of the fits: ``T_ref_query @ se3_exp(-H^+ g)``.

        The information is that of the fit, reduced by the noise of the odometry inside the blocks.
        """
        first, second = np.array(self._pairs, dtype=np.int64).reshape(-1, 2).T
        second = second + reference_count
        T_ref_query = invert(T_world_node[first]) @ T_world_node[second]
        moved = invert(self._poses) @ T_ref_query
        far = np.linalg.norm(moved[:, :3, 3], axis=1) + LENGTH_M * rotation_angle(moved[:, :3, :3])
        for k in np.flatnonzero(far > self._options.moved_m).tolist():
            self._poses[k] = T_ref_query[k]
            self._fits[k] = self._linearise(*self._pairs[k], T_ref_query[k])
        rows = [k for k, fit in enumerate(self._fits) if fit is not None and fit.count >= self._options.least_count]
        fits = [fit for k in rows if (fit := self._fits[k]) is not None]
        steps = np.array([minimum(fit.H, fit.g) for fit in fits]).reshape(-1, 6)
        poses = self._poses[rows] @ se3_exp(steps)
        return Edges.of_registrations(first[rows], second[rows], poses, information_of(fits, noise, self._options))


def information_of(fits: Sequence[LocalFit], noise: OdometryNoise, options: LocalOptions) -> Array:
    """(F, 6, 6) information of the edges by F fits, less the noise of the odometry inside both blocks of each."""
    H, scatter = (np.array([getattr(fit, name) for fit in fits]).reshape(-1, 6, 6) for name in ("H", "scatter"))
    floor = options.least_sigma_m**2 * options.correlation
    own = sandwich_information(H, options.repeats * scatter, floor)
    return with_block_distortion(own, options.inside_m * noise.sigma**2)


def _without_outliers(
    T: Array, odometry: Edges, local: Edges, factor: float, options: LocalOptions
) -> tuple[Array, Edges]:
    """Poses solved without the local edges that are outliers, and the edges that are left."""
    from scipy.special import chdtri

    T = solve(T, Edges.join([odometry, downweighted(local, factor)]))
    chi2 = local.chi2(T) / factor
    typical = max(1.0, float(np.median(chi2)) / MEDIAN_CHI2) if len(local) else 1.0
    fitting = chi2 <= typical * chdtri(6, options.significance)
    if fitting.all():
        return T, local
    kept = local[fitting]
    return solve(T, Edges.join([odometry, downweighted(kept, factor)])), kept


def _noise(
    drives: BothDrives, T: Array, before: tuple[OdometryNoise, float], local: Edges, options: LocalOptions
) -> tuple[OdometryNoise, float]:
    """The noise of odometry, and the factor by which local edges overstate their information, estimated anew."""
    noise, factor = before
    odometry, local = drives.odometry(noise), downweighted(local, factor)
    covariances = Covariances(T, Edges.join([odometry, local]))
    noise = reestimated(noise, drives, odometry, T, covariances, options.noise_edges)
    some = local[evenly_spaced(len(local), options.factor_edges)]
    tested = check_used(some.residuals(T), some.information, covariances.relative(some.first, some.second))
    more = variance_factor(tested.squares.ravel(), tested.redundancy_numbers.ravel())
    return noise, factor if more is None else max(1.0, factor * more)
