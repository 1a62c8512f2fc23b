"""Pairing of each image of a query drive with a keyframe of the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.alignment.two_drives import map_prior, solve_drive
from relocbench.datasets.groundtruth.odometry.jitter import white_noise
from relocbench.datasets.groundtruth.pairs.outcome import (
    OutcomeLimits,
    Outcomes,
    PairOutcome,
    SolvedDrive,
    nearest_keyframe,
)
from relocbench.datasets.groundtruth.pose_graph.files import PlacedDrive
from relocbench.datasets.groundtruth.pose_graph.graph import SharedErrors, Solution
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration


@dataclass(frozen=True, eq=False)
class CameraFrames:
    """The images of one camera that are paired, of both drives."""

    camera: str
    T_rig_refcam: Array
    T_rig_querycam: Array
    ref_ns: tuple[int, ...]
    query_ns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PairingUnit:
    """One query drive with its registrations and the images to pair: a unit of work."""

    reference: Drive
    query: Drive
    registrations: tuple[Registration, ...]
    cameras: tuple[CameraFrames, ...]
    limits: OutcomeLimits
    max_angle_deg: float
    shared: SharedErrors | None = None
    """uncertainty of the lidars' calibration"""

    def __str__(self) -> str:
        return f"pairs of {self.query.name} with {self.reference.name}"


@dataclass(frozen=True, eq=False)
class Paired:
    """The pairs of one query drive, and the solved graph."""

    outcomes: dict[str, list[PairOutcome]]
    """camera -> the outcome of each query image"""
    reference: PlacedDrive
    query: PlacedDrive


def pair_up(unit: PairingUnit) -> Paired:
    """Solve the pose graph of two drives and compute the outcome of every pair."""
    solution = solve_drive(unit.reference, unit.query, unit.registrations)
    solution = replace(solution, shared=unit.shared)
    outcomes = Outcomes(
        solution,
        (unit.reference.nodes, unit.reference.recording.odometry),
        (unit.query.nodes, unit.query.recording.odometry),
        unit.registrations,
        unit.limits,
        (_white_noise(unit.reference), _white_noise(unit.query)),
    )
    by_camera = {frames.camera: _of_camera(unit, frames, solution, outcomes) for frames in unit.cameras}
    count = len(unit.reference.nodes)
    before, after = solution.arc_length_to_trusted[:count], solution.arc_length_to_trusted[count:]
    verdicts = {r.query: verdict for r, verdict in zip(unit.registrations, solution.verdicts, strict=True)}
    return Paired(
        by_camera,
        PlacedDrive(unit.reference.name, unit.reference.nodes.times_ns, solution.T_world_ref, before, {}),
        PlacedDrive(unit.query.name, unit.query.nodes.times_ns, solution.T_world_query, after, verdicts),
    )


def _white_noise(drive: Drive) -> Array:
    """(6,) of odometry from scans; that of other sensors is a random walk, which the pose graph estimates."""
    return white_noise(drive.recording.odometry) if drive.recording.odometry_lidar else np.zeros(6)


def _of_camera(unit: PairingUnit, frames: CameraFrames, solution: Solution, outcomes: Outcomes) -> list[PairOutcome]:
    keyframes = _Keyframes.of(outcomes.reference, solution, frames.ref_ns, frames.T_rig_refcam)
    prior = map_prior(unit.reference, unit.query)
    out = []
    for time in frames.query_ns:
        place = outcomes.query.place(time)
        node = place.node if place is not None else int(np.argmin(np.abs(unit.query.nodes.times_ns - time)))
        nearest, reason = None, ""
        if place is not None:
            part = int(solution.part[solution.drives.reference_count + node])
            T_world_cam = place.T_world_rig @ frames.T_rig_querycam
            nearest, reason = keyframes.nearest(T_world_cam, part, unit.max_angle_deg)
        if nearest is None and prior is not None and prior.nearest(node) >= 0:
            # Where nothing is registered, the rejected pair has the nearest keyframe by GNSS.
            ref_time_ns = unit.reference.nodes.times_ns[prior.nearest(node)]
            nearest = frames.ref_ns[int(np.argmin(np.abs(np.array(frames.ref_ns) - ref_time_ns)))]
        outcome = outcomes.of(
            frames.ref_ns[0] if nearest is None else nearest, time, frames.T_rig_refcam, frames.T_rig_querycam
        )
        out.append(outcome.rejected(reason) if reason and outcome.accepted else outcome)
    return out


@dataclass(frozen=True, eq=False)
class _Keyframes:
    """Keyframes with their poses by the graph."""

    times: tuple[int, ...]
    T_world_cam: Array
    part: Indices
    """(M,) the connected part of the graph that each keyframe is in"""

    @classmethod
    def of(cls, side: SolvedDrive, solution: Solution, times: Sequence[int], T_rig_cam: Array) -> _Keyframes:
        places = [(time, place) for time in times if (place := side.place(time)) is not None]
        poses = np.array([place.T_world_rig @ T_rig_cam for _, place in places], dtype=np.float64)
        nodes = np.array([place.node for _, place in places], dtype=np.int64)
        return cls(tuple(time for time, _ in places), poses.reshape(-1, 4, 4), solution.part[nodes])

    def nearest(self, T_world_cam: Array, part: int, max_angle_deg: float) -> tuple[int | None, str]:
        """Time of the :func:`nearest_keyframe` in a part of the graph, None if it has none; and why it is rejected."""
        connected = self.part == part
        if not connected.any():
            return None, ""
        best, reason = nearest_keyframe(self.T_world_cam, T_world_cam, max_angle_deg, connected)
        return self.times[best], reason
