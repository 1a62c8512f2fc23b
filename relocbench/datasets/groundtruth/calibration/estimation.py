"""Estimation of the calibration of two drives' lidars from a solved pose graph.

Blocks are registered lidar by lidar: those of the two drives with each other, and those of different lidars of one
drive. A calibration that is right makes all of this agree with both odometries; :mod:`.unknowns` says what errors do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.calibration.adjustment import Adjustment, CalibrationEdges, Reduced
from relocbench.datasets.groundtruth.calibration.lidar_fits import LidarFits, Reach, corrections_of
from relocbench.datasets.groundtruth.calibration.pairs import Measured, measured_in_common
from relocbench.datasets.groundtruth.calibration.unknowns import SIZE, Sensors, moves
from relocbench.datasets.groundtruth.pose_graph.edge_information import minimum
from relocbench.datasets.groundtruth.pose_graph.edges import Edges
from relocbench.datasets.groundtruth.pose_graph.graph import Solution
from relocbench.datasets.groundtruth.pose_graph.local_edges import LocalOptions, information_of
from relocbench.datasets.groundtruth.pose_graph.odometry_scale import scales_of
from relocbench.datasets.groundtruth.pose_graph.selection import MEDIAN_CHI2
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import adjoint, hat, invert, se3_exp, se3_log

_REACHES = (Reach(0, 0.3), Reach(0, 0.15), Reach(1, 0.08), *[Reach(1, 0.05)] * 3)
"""how far points may be from planes, iteration after iteration"""
_SETTLED = 0.5
"""at the last reach, iterations end when no unknown changes by more than so many standard deviations"""
_LEAST_COUNT = 20
"""least number of matched points of a fit"""
_LEAST_FITS = 30
"""with fewer fits, no calibration is reported"""
_CONNECTED_M = 20.0
"""largest distance along the road to a trusted registration: further away matches may be wrong"""
_OUTLIER = 5.6
"""fits whose squared residual is more than so many times the median are left out"""
_ROUNDS = 3
"""largest number of times that outliers are looked for"""
_TWIST_NS = 150_000_000
"""the rig's twist at a node is the mean over so long before and after it"""


@dataclass(frozen=True, eq=False)
class CalibrationEvidence:
    """What two drives say of the calibration of their lidars."""

    reduced: Reduced
    """normal equations of the calibration"""
    by_calibration: Array
    """(N, 6, K) how the poses of the nodes move, ``T_world_node @ se3_exp(twist)``, with the calibration"""
    count: int
    """number of fits"""


def calibration_evidence(solution: Solution, drives: tuple[Drive, Drive], sensors: Sensors) -> CalibrationEvidence:
    """The normal equations of the calibration of two drives' lidars, with their poses eliminated.

    Args:
        solution: poses of the nodes of ``drives`` to start from, right to decimetres near trusted registrations.
        sensors: lidars of these drives, and maybe others.

    Raises:
        DatasetError: a block is missing or damaged.
    """
    problem = _Problem.of(solution, drives, sensors)
    assumed = sensors.prior(sensors.causes())
    odometry = solution.drives.odometry(solution.noise)
    scales = scales_of(solution.drives, odometry)
    T, calibration = solution.T_world_node, np.zeros(sensors.unknowns)
    nothing = CalibrationEvidence(
        Reduced(np.zeros((sensors.unknowns,) * 2), np.zeros(sensors.unknowns)),
        np.zeros((len(T), 6, sensors.unknowns)), 0,
    )  # fmt: skip
    evidence = nothing
    for reach in _REACHES:
        measured = problem.edges(T, calibration, reach)
        if len(measured) < _LEAST_FITS:
            return nothing
        kept = np.ones(len(measured), dtype=np.bool_)
        for _ in range(_ROUNDS):
            adjustment = Adjustment(T, odometry, scales, measured[kept])
            change = adjustment.reduced.about(calibration).estimate(assumed)[0] - calibration
            chi2 = measured.chi2(T @ se3_exp(adjustment.step(change)), change)
            typical = max(1.0, float(np.median(chi2[kept])) / MEDIAN_CHI2)
            before, kept = kept, chi2 <= _OUTLIER * MEDIAN_CHI2 * typical
            if (before == kept).all():
                break
        used = measured[kept].downweighted(typical)
        adjustment = Adjustment(T, odometry, scales, used)
        # The adjustment is of a change of the calibration; the prior's mean is 0 for its value.
        reduced = adjustment.reduced.about(calibration)
        estimate, covariance = reduced.estimate(assumed)
        change = estimate - calibration
        T, calibration = T @ se3_exp(adjustment.step(change)), estimate
        evidence = CalibrationEvidence(reduced, adjustment.by_calibration, len(used))
        if reach == _REACHES[-1] and (np.abs(change) <= _SETTLED * np.sqrt(np.diagonal(covariance)) + 1e-12).all():
            break
    return evidence


def node_twists(odometry: Trajectory, nodes: Nodes) -> Array:
    """(K, 6) the rig's twist a second at each node, in its frame; what is across a gap or a break is no motion."""
    before = np.maximum(nodes.times_ns - _TWIST_NS, odometry.times_ns[0])
    after = np.minimum(nodes.times_ns + _TWIST_NS, odometry.times_ns[-1])
    piece = odometry.pieces(nodes.times_ns)
    before = np.where(odometry.pieces(before) == piece, before, nodes.times_ns)
    after = np.where(odometry.pieces(after) == piece, after, nodes.times_ns)
    # Between two breaks that are close together there is no motion to measure.
    after = np.where(after == before, before + 1, after)
    motion = se3_log(invert(odometry.at(before)) @ odometry.at(after))
    return np.asarray(motion / ((after - before) / 1e9)[:, None])


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is compared, and how calibration enters."""

    solution: Solution
    fits: LidarFits
    pairs: Sequence[tuple[Measured, Measured]]
    columns: tuple[tuple[int, ...], tuple[int, ...]]
    """of each drive, first unknown of each lidar"""
    moves: Array
    """(N, 6, 7) see :func:`.unknowns.moves`"""
    unknowns: int

    @classmethod
    def of(cls, solution: Solution, drives: tuple[Drive, Drive], sensors: Sensors) -> _Problem:
        lidars = [drive.recording.lidars for drive in drives]
        fits = LidarFits((drives[0].store(), drives[1].store()), [[s.T_rig_lidar for s in own] for own in lidars])
        known: Mask = solution.arc_length_to_trusted.min(axis=1) <= _CONNECTED_M
        first = [
            tuple(SIZE * sensors.number(drive.name, k) for k in range(len(own)))
            for drive, own in zip(drives, lidars, strict=True)
        ]
        twists = np.concatenate([node_twists(drive.recording.odometry, drive.nodes) for drive in drives])
        pairs = measured_in_common(solution, drives, known)
        return cls(solution, fits, pairs, (first[0], first[1]), moves(twists), sensors.unknowns)

    def _moves_of(self, drive: int) -> Array:
        count = self.solution.drives.reference_count
        return self.moves[count:] if drive else self.moves[:count]

    def edges(self, T_world_node: Array, calibration: Array, reach: Reach) -> CalibrationEdges:
        """Edges at the minimum of the fits, at poses (N, 4, 4) and for a calibration (K,)."""
        nodes, poses, fits, derivatives = [], [], [], []
        corrections = {
            (drive, lidar): corrections_of(self._moves_of(drive) @ calibration[first : first + SIZE])
            for drive in range(2)
            for lidar, first in enumerate(self.columns[drive])
        }
        T_node_world = invert(T_world_node)
        for a, b in self.pairs:
            at_a, at_b = (m.node + (self.solution.drives.reference_count if m.drive else 0) for m in (a, b))
            columns = [
                slice(start, start + SIZE) for start in (self.columns[a.drive][a.lidar], self.columns[b.drive][b.lidar])
            ]
            of_a, of_b = (corrections[m.drive, m.lidar][m.node] for m in (a, b))
            T = T_node_world[at_a] @ T_world_node[at_b]
            fit = self.fits.fit(a, b, T, (of_a, of_b), reach)
            if fit.count < _LEAST_COUNT:
                continue
            nodes.append((at_a, at_b))
            poses.append(T)
            fits.append(fit)
            # T_measured = se3_exp(u_a) @ T @ se3_exp(-u_b), each correction about the rig's place.
            by = np.zeros((6, self.unknowns))
            by[:, columns[1]] += about(fit.rig_b) @ self.moves[at_b]
            by[:, columns[0]] -= adjoint(invert(T)) @ about(fit.rig_a) @ self.moves[at_a]
            derivatives.append(by)
        steps = np.array([minimum(fit.H, fit.g) for fit in fits]).reshape(-1, 6)
        measured = np.array(poses).reshape(-1, 4, 4) @ se3_exp(steps)
        information = information_of(fits, self.solution.noise, LocalOptions())
        edges = Edges.of_registrations([a for a, _ in nodes], [b for _, b in nodes], measured, information)
        return CalibrationEdges(edges, np.array(derivatives).reshape(-1, 6, self.unknowns))


def about(place: Array) -> Array:
    """(6, 6) the twist about the origin that is a given twist about a place (3,): ``rho - phi x place``."""
    out = np.eye(6)
    out[:3, 3:] = hat(place)
    return out
