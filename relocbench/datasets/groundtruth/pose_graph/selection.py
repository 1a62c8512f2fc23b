"""Selection of the registrations to trust, along with the noise of odometry: solve, test each edge, and repeat.

The filters become stricter from step to step. Consensus (:mod:`.consensus`) needs only odometry. A robust kernel then
finds the registrations that are off by more than their information allows. Last, Baarda's outlier test removes the
wrong ones that are left, one at a time in each neighbourhood, since a wrong edge makes its right neighbours look bad,
and readmits those that agree with the solution. The noise of odometry is estimated in each round.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.consensus import RunOptions
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind, components
from relocbench.datasets.groundtruth.pose_graph.least_squares import Covariances, solve
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise, estimate, variance_factor
from relocbench.datasets.groundtruth.pose_graph.outlier_test import OutlierTest, check_left_out, check_used

MEDIAN_CHI2 = 5.348
"""median of chi2 with six degrees of freedom"""


@dataclass(frozen=True)
class GraphOptions:
    """Options that decide which registrations are trusted."""

    runs: RunOptions = field(default_factory=RunOptions)
    kernel: float = 3.0
    """scale of the robust kernel: a residual of so many standard deviations has a weight of 1/4"""
    significance: float = 1e-5
    """probability that a right registration is rejected"""
    readmission: float = 1e-2
    """p-value above which a registration that was left out is readmitted"""
    neighbourhood_m: float = 20.0
    """of registrations within this arc length that fail the test, only the worst is removed in one round"""
    rounds: int = 10
    """largest number of rounds"""
    estimate_noise: bool = True
    """whether the noise of odometry, and the overstatement of the registrations' information, are estimated"""
    shared_points: bool = True
    """whether submaps overlap, so that errors of their registrations are correlated and make odometry look too good; if
    so, its noise is never estimated to be less than assumed"""
    noise_edges: int = 600
    """number of odometry edges that noise is estimated from"""


@dataclass(frozen=True, eq=False)
class Selected:
    """The solved graph and the registrations that are part of it."""

    T_world_node: Array
    """(N, 4, 4)"""
    edges: Edges
    """the edges of the graph, with the information they had"""
    used: Mask
    """(E,) whether each registration is part of the graph"""
    tested: OutlierTest
    """(E,) test of each registration against the rest of the graph"""
    odometry_tested: OutlierTest
    """test of each odometry edge against the rest of the graph"""
    noise: OdometryNoise
    information_factor: float
    """factor that the information of registrations was divided by"""


def downweighted(edges: Edges, factor: float) -> Edges:
    """The edges with their information divided by a factor."""
    return replace(edges, information=edges.information / factor)


def select(
    drives: BothDrives, cross: Edges, candidates: Mask, start: Array, noise: OdometryNoise, options: GraphOptions
) -> Selected:
    """Solve the graph of odometry and registrations, and select the registrations to trust.

    Args:
        cross: E registrations.
        candidates: (E,) whether each may be part of the graph.
        start: (N, 4, 4) initial poses.
        noise: of odometry, initially.
    """
    T, used, factor = _robust(drives, cross, candidates, start, noise, options)
    was_out, assumed = ~used, noise
    for _ in range(options.rounds):
        odometry = drives.odometry(noise)
        edges = Edges.join([odometry, downweighted(cross[used], factor)])
        T = solve(T, edges)
        covariances = Covariances(T, edges)
        tested = _test_registrations(covariances, T, downweighted(cross, factor), used, edges)
        before = noise, factor
        if options.estimate_noise:
            noise = reestimated(noise, drives, odometry, T, covariances, options.noise_edges)
            noise = noise.at_least(assumed) if options.shared_points else noise
            more = variance_factor(tested.squares[used].ravel(), tested.redundancy_numbers[used].ravel())
            # The factor is at least 1: registrations that share points have correlated errors and look too good.
            factor = max(1.0, factor * (1.0 if more is None else more))
        drop = _worst(drives, cross, used & (tested.p_value < options.significance), tested, options)
        back = (
            candidates
            & ~used
            & was_out
            & (tested.redundancy_numbers.sum(axis=1) > 0)
            & (tested.p_value > options.readmission)
        )
        used = (used & ~drop) | back
        was_out &= ~back
        if not drop.any() and not back.any() and noise_converged(before, (noise, factor)):
            break
    noise, factor = before
    edges = Edges.join([odometry, downweighted(cross[used], factor)])
    if drop.any() or back.any():
        T = solve(T, edges)
        tested = _test_registrations(Covariances(T, edges), T, downweighted(cross, factor), used, edges)
    return Selected(T, edges, used, tested, check_odometry(T, edges), noise, factor)


def check_odometry(T_world_node: Array, edges: Edges) -> OutlierTest:
    """Test the odometry edges of a solved graph against the rest of it."""
    odometry = edges[edges.kind != Kind.REGISTRATION]
    posterior = Covariances(T_world_node, edges).relative(odometry.first, odometry.second)
    return check_used(odometry.residuals(T_world_node), odometry.information, posterior)


def _robust(
    drives: BothDrives, cross: Edges, used: Mask, start: Array, noise: OdometryNoise, options: GraphOptions
) -> tuple[Array, Mask, float]:
    """Poses by a robust kernel, the registrations that fit them, and the factor by which these overstate themselves.

    The first solution has no kernel, so that drives which pass a place twice are drawn together before any registration
    is doubted.
    """
    from scipy.special import chdtri

    edges = Edges.join([drives.odometry(noise), cross[used]])
    T = solve(start, edges)
    T = solve(T, edges, options.kernel, np.arange(len(edges)) >= len(edges) - int(used.sum()))
    chi2 = cross.chi2(T)
    factor = max(1.0, float(np.median(chi2[used])) / MEDIAN_CHI2) if used.any() else 1.0
    return T, used & (chi2 <= factor * chdtri(6, options.significance)), factor


def _test_registrations(covariances: Covariances, T: Array, cross: Edges, used: Mask, edges: Edges) -> OutlierTest:
    """Test every registration whose nodes are connected; those of the others have no redundancy.

    A query node that was found nowhere has no node of the reference where GNSS does not name the nearest one.
    """
    part = components(len(T), edges.first, edges.second)
    connected = np.flatnonzero((cross.first >= 0) & (part[cross.first] == part[cross.second]))
    squares, redundancy_numbers = np.zeros((len(cross), 6)), np.zeros((len(cross), 6))
    residuals, posterior = cross.residuals(T), np.zeros((len(cross), 6, 6))
    posterior[connected] = covariances.relative(cross.first[connected], cross.second[connected])
    for which, check in ((used, check_used), (~used, check_left_out)):
        some = connected[which[connected]]
        out = check(residuals[some], cross.information[some], posterior[some])
        squares[some], redundancy_numbers[some] = out.squares, out.redundancy_numbers
    return OutlierTest(squares, redundancy_numbers)


def reestimated(
    noise: OdometryNoise, drives: BothDrives, odometry: Edges, T_world_node: Array, covariances: Covariances, most: int
) -> OdometryNoise:
    """The noise of odometry estimated anew from at most ``most`` of its edges in a solved graph."""
    some = odometry[evenly_spaced(len(odometry), most)]
    posterior = np.diagonal(covariances.relative(some.first, some.second), axis1=1, axis2=2)
    return estimate(noise, drives.arc_length(some.first, some.second), some.residuals(T_world_node), posterior)


def evenly_spaced(count: int, most: int) -> Indices:
    """At most ``most`` of the numbers from 0 to ``count - 1``, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)) if count else np.arange(0)


def _worst(drives: BothDrives, cross: Edges, failing: Mask, tested: OutlierTest, options: GraphOptions) -> Mask:
    """The worst failing registration in each neighbourhood along the query's drive."""
    at = drives.travelled_m[cross.second]
    out = np.zeros(len(cross), dtype=bool)
    excess = tested.chi2 / np.maximum(tested.freedom, 1)
    for e in sorted(np.flatnonzero(failing).tolist(), key=lambda e: (-excess[e], e)):
        out[e] = not np.any(out & (np.abs(at - at[e]) < options.neighbourhood_m))
    return out


def noise_converged(before: tuple[OdometryNoise, float], after: tuple[OdometryNoise, float]) -> bool:
    """Whether no standard deviation changed by more than 5 % between two (noise, factor)."""
    ratios = np.append(after[0].sigma / before[0].sigma, np.sqrt(after[1] / before[1]))
    return bool(np.all(np.abs(np.log(ratios)) < 0.05))
