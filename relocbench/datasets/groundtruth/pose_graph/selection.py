"""Which registrations to believe, and how noisy odometry is: solve, test each against the rest, again until it holds.

Filters of growing sharpness. Runs are told apart by odometry alone (:mod:`consensus`); a robust kernel, starting from
there, finds what is off by more than its own information allows; Baarda's test then takes the last wrong ones out, one
at a time in each neighbourhood, since a wrong edge makes its right neighbours look bad, and lets back in what the
finished solution agrees with. Along the way the noise of odometry is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.pose_graph.both_drives import BothDrives
from relocbench.datasets.groundtruth.pose_graph.consensus import RunOptions
from relocbench.datasets.groundtruth.pose_graph.edges import Edges, Kind, components
from relocbench.datasets.groundtruth.pose_graph.least_squares import Covariances, solve
from relocbench.datasets.groundtruth.pose_graph.odometry_noise import OdometryNoise, estimate, variance_factor
from relocbench.datasets.groundtruth.pose_graph.outlier_test import OutlierTest, check_left_out, check_used
from relocbench.errors import ConfigError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MEDIAN_CHI2 = 5.348
"""of six degrees of freedom"""


@dataclass(frozen=True)
class GraphOptions:
    """How registrations are judged."""

    runs: RunOptions = field(default_factory=RunOptions)
    kernel: float = 3.0
    """residual, in standard deviations, that counts a quarter in the robust solution"""
    significance: float = 1e-5
    """probability with which a right registration is taken for wrong"""
    readmission: float = 1e-2
    """a registration that was left out comes back if so much or more speaks for it"""
    neighbourhood_m: float = 20.0
    """of several registrations within this way that fail the test, only the worst goes in a round"""
    rounds: int = 10
    estimate_noise: bool = True
    """of odometry, and of registrations where they are worse than they say"""
    shared_points: bool = True
    """registrations of submaps that overlap err alike and make odometry look too good: its noise is never estimated to
    less than was assumed"""
    noise_edges: int = 600
    """odometry edges, evenly spread, that noise is estimated from"""

    def __post_init__(self) -> None:
        if min(self.kernel, self.neighbourhood_m) <= 0 or self.rounds < 1 or self.noise_edges < 1:
            raise ConfigError("kernel, neighbourhood_m, rounds and noise_edges of the graph must be positive")
        if not 0 < self.significance < self.readmission < 1:
            raise ConfigError("expected 0 < significance < readmission < 1")


@dataclass(frozen=True, eq=False)
class Selected:
    """A solved graph and what it believes."""

    T_world_node: Array
    """(N, 4, 4)"""
    edges: Edges
    """all that took part, with the weights it had"""
    used: Mask
    """(E,) registrations that took part"""
    tested: OutlierTest
    """(E,) registrations against all else"""
    odometry_tested: OutlierTest
    """odometry edges against all else"""
    noise: OdometryNoise
    information_factor: float
    """the registrations' information was divided by this"""


def downweighted(edges: Edges, factor: float) -> Edges:
    """With information divided by a factor."""
    return replace(edges, information=edges.information / factor)


def select(
    drives: BothDrives, cross: Edges, candidates: Mask, start: Array, noise: OdometryNoise, options: GraphOptions
) -> Selected:
    """Solve the graph of odometry and registrations.

    Args:
        cross: E registrations.
        candidates: (E,) those that may take part at all.
        start: (N, 4, 4) first poses.
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
            some = odometry[spread(len(odometry), options.noise_edges)]
            posterior = np.diagonal(covariances.relative(some.first, some.second), axis1=1, axis2=2)
            noise = estimate(noise, drives.arc_length(some.first, some.second), some.residuals(T), posterior)
            noise = noise.at_least(assumed) if options.shared_points else noise
            more = variance_factor(tested.squares[used].ravel(), tested.redundancy_numbers[used].ravel())
            # Registrations that share points err alike, and look better among themselves than they are.
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
    """The odometry edges of a solved graph against all else."""
    odometry = edges[edges.kind != Kind.REGISTRATION]
    posterior = Covariances(T_world_node, edges).relative(odometry.first, odometry.second)
    return check_used(odometry.residuals(T_world_node), odometry.information, posterior)


def _robust(
    drives: BothDrives, cross: Edges, used: Mask, start: Array, noise: OdometryNoise, options: GraphOptions
) -> tuple[Array, Mask, float]:
    """Poses by a robust kernel, the registrations that fit them, and by how much these overstate themselves.

    All count at first, so that drives which pass a place twice are drawn together before anything is doubted.
    """
    from scipy.special import chdtri

    edges = Edges.join([drives.odometry(noise), cross[used]])
    T = solve(start, edges)
    T = solve(T, edges, options.kernel, np.arange(len(edges)) >= len(edges) - int(used.sum()))
    found = cross.chi2(T)
    factor = max(1.0, float(np.median(found[used])) / _MEDIAN_CHI2) if used.any() else 1.0
    return T, used & (found <= factor * chdtri(6, options.significance)), factor


def _test_registrations(covariances: Covariances, T: Array, cross: Edges, used: Mask, edges: Edges) -> OutlierTest:
    """Every registration whose nodes are connected; of others nothing is known."""
    part = components(len(T), edges.first, edges.second)
    connected = np.flatnonzero(part[cross.first] == part[cross.second])
    squares, redundancy_numbers = np.zeros((len(cross), 6)), np.zeros((len(cross), 6))
    residuals, posterior = cross.residuals(T), np.zeros((len(cross), 6, 6))
    posterior[connected] = covariances.relative(cross.first[connected], cross.second[connected])
    for which, check in ((used, check_used), (~used, check_left_out)):
        some = connected[which[connected]]
        out = check(residuals[some], cross.information[some], posterior[some])
        squares[some], redundancy_numbers[some] = out.squares, out.redundancy_numbers
    return OutlierTest(squares, redundancy_numbers)


def spread(count: int, most: int) -> NDArray[np.int64]:
    """At most so many of the numbers up to ``count``, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)) if count else np.arange(0)


def _worst(drives: BothDrives, cross: Edges, failing: Mask, tested: OutlierTest, options: GraphOptions) -> Mask:
    """The worst of the failing registrations in each neighbourhood along the query's drive."""
    at = drives.travelled_m[cross.second]
    out = np.zeros(len(cross), dtype=bool)
    excess = tested.chi2 / np.maximum(tested.freedom, 1)
    for e in sorted(np.flatnonzero(failing).tolist(), key=lambda e: (-excess[e], e)):
        out[e] = not np.any(out & (np.abs(at - at[e]) < options.neighbourhood_m))
    return out


def noise_converged(before: tuple[OdometryNoise, float], after: tuple[OdometryNoise, float]) -> bool:
    """Whether no standard deviation changed by more than 5 %."""
    ratios = np.append(after[0].sigma / before[0].sigma, np.sqrt(after[1] / before[1]))
    return bool(np.all(np.abs(np.log(ratios)) < 0.05))
