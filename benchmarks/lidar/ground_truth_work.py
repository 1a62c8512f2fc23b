"""Units of work of ``ground_truth.py``: timed stages of the builder, given priors, and variants for comparison."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from ground_truth_drives import T_RIG_CAM

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.alignment.two_drives import (
    AlignmentOptions,
    FirstPose,
    RegistrationUnit,
    register_query,
)
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.pairs.outcome import OutcomeLimits, Outcomes, PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames, PairingUnit, pair_up
from relocbench.datasets.groundtruth.pose_graph.graph import optimise
from relocbench.datasets.groundtruth.registration import files as track_files
from relocbench.datasets.groundtruth.submaps.drive import Drive, make_drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.datasets.groundtruth.verification.verification import Thresholds
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.execution import Run
from relocbench.files import write_text
from relocbench.geometry import invert
from relocbench.progress import Silent

Result = TypeVar("Result")

NO_THRESHOLDS = Thresholds(-1.0, -1.0, 2.0, -1.0, 1e9, 1e9, 1e9)
"""every registration is trusted for which there is any evidence"""


@dataclass(frozen=True)
class Spent:
    """The time and memory of a stage in its worker."""

    cpu_s: float
    wall_s: float
    peak_mib: float
    """peak of the worker up to the end of the stage"""


def peak_mib() -> float:
    """The peak memory of this program. ru_maxrss would include what the parent held when it forked."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def timed(work: Callable[[], Result]) -> tuple[Result, Spent]:
    """A result with its time and memory."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = work()
    return result, Spent(time.process_time() - cpu, time.perf_counter() - wall, peak_mib())


def _kept(path: Path) -> Spent | None:
    return Spent(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None


def _keep(path: Path, spent: Spent) -> Spent:
    write_text(path, json.dumps(vars(spent)) + "\n")
    return spent


@dataclass(frozen=True, eq=False)
class CutUnit:
    """A recording to be cut into blocks."""

    recording: FieldRecording
    folder: Path
    options: AlignmentOptions


def cut(unit: CutUnit) -> tuple[Drive, Spent]:
    """The blocks; those of a run that was killed are made anew, so that their cost is known."""
    path = unit.folder.parent / f"{unit.folder.name}.json"
    before = _kept(path)
    if before is None and unit.folder.exists():
        shutil.rmtree(unit.folder)
    drive, spent = timed(lambda: make_drive(unit.recording, unit.folder, unit.options.block_m, Silent(), Run(1)))
    return drive, before or _keep(path, spent)


@dataclass(frozen=True, eq=False)
class RegisterUnit:
    """One query drive against a reference."""

    track: RegistrationUnit
    path: Path


@dataclass(frozen=True, eq=False)
class Registered:
    """The result."""

    registrations: tuple[Registration, ...]
    messages: tuple[str, ...]
    spent: Spent


def register_drive(unit: RegisterUnit) -> Registered:
    """The registrations; those of an earlier run are read."""
    costs, said = unit.path.with_suffix(".json"), unit.path.with_suffix(".txt")
    before = _kept(costs)
    if before is None:
        messages: list[str] = []
        found, spent = timed(lambda: register_query(unit.track, messages.append))
        track_files.write_registrations(unit.path, found, unit.track.reference.nodes, unit.track.query.nodes)
        write_text(said, "".join(f"{message}\n" for message in messages))
        before = _keep(costs, spent)
    return Registered(
        tuple(track_files.read_registrations(unit.path)),
        tuple(said.read_text(encoding="utf-8").splitlines()),
        before,
    )


def unverified(options: AlignmentOptions) -> AlignmentOptions:
    """Options that accept every registration: without tests of the evidence or the odometry, and with the best fitting
    of several hypotheses for the start of a drive, without following them."""
    register = replace(options.registration.register, thresholds=NO_THRESHOLDS)
    registration = replace(
        options.registration,
        register=register,
        hypotheses=replace(options.registration.hypotheses, most_tried=1, most_followed=1, share=0.0),
        slack_m=1e9,
        slack_deg=1e9,
    )
    return replace(options, registration=registration)


@dataclass(frozen=True, eq=False)
class DecideUnit:
    """Registered drives, and the images to pair."""

    reference: Drive
    query: Drive
    registrations: tuple[Registration, ...]
    ref_ns: tuple[int, ...]
    query_ns: tuple[int, ...]
    options: AlignmentOptions
    limits: OutcomeLimits
    max_angle_deg: float


@dataclass(frozen=True, eq=False)
class Decided:
    """The builder's answers, and those without local edges."""

    outcomes: list[PairOutcome]
    spent: Spent
    without_local: list[PairOutcome]
    """for the same pairs"""


def decide(unit: DecideUnit) -> Decided:
    """Solve the graph with local edges, then the graph alone."""
    frames = CameraFrames("front", T_RIG_CAM, T_RIG_CAM, unit.ref_ns, unit.query_ns)
    pairing = PairingUnit(unit.reference, unit.query, unit.registrations, (frames,), unit.limits, unit.max_angle_deg)
    paired, spent = timed(lambda: pair_up(pairing))
    outcomes = paired.outcomes["front"]
    solution = optimise(unit.reference.nodes, unit.query.nodes, unit.registrations)
    answers = Outcomes(
        solution,
        (unit.reference.nodes, unit.reference.recording.odometry),
        (unit.query.nodes, unit.query.recording.odometry),
        unit.registrations,
        unit.limits,
    )
    alone = [answers.of(o.ref_timestamp_ns, o.query_timestamp_ns, T_RIG_CAM, T_RIG_CAM) for o in outcomes]
    return Decided(outcomes, spent, alone)


def by_registrations_alone(
    reference: Drive, query: Drive, registrations: Sequence[Registration], pairs: Sequence[tuple[int, int]],
    limits: OutcomeLimits, within_m: float = 4.0,
) -> list[PairOutcome]:  # fmt: skip
    """Pairs from the nearest trusted registration, transferred by both odometries, without covariances."""
    trusted = [r for r in registrations if r.trusted and r.ref >= 0]
    ways = np.array([query.nodes.travelled_m[r.query] for r in trusted])
    out = []
    for ref_ns, query_ns in pairs:
        way = float(np.interp(query_ns - query.nodes.times_ns[0], query.nodes.times_ns - query.nodes.times_ns[0],
                              query.nodes.travelled_m))  # fmt: skip
        near = int(np.argmin(np.abs(ways - way))) if len(ways) else -1
        if near < 0 or abs(ways[near] - way) > within_m:
            out.append(PairOutcome(ref_ns, query_ns, None, None, None, None, None, None, "not registered"))
            continue
        found = trusted[near]
        T_refnode_ref = _from_node(reference, found.ref, ref_ns)
        T_querynode_query = _from_node(query, found.query, query_ns)
        T_query_ref = invert(found.T_ref_query @ T_querynode_query @ T_RIG_CAM) @ T_refnode_ref @ T_RIG_CAM
        far = float(np.linalg.norm(T_query_ref[:3, 3])) > limits.distance_m
        reason = "no keyframe near" if far else ""
        out.append(PairOutcome(ref_ns, query_ns, T_query_ref, None, None, None, None, None, reason))
    return out


def _from_node(drive: Drive, node: int, time_ns: int) -> Array:
    T_odom_rig = drive.recording.odometry.at(np.array([time_ns], dtype=np.int64))[0]
    return np.asarray(invert(drive.nodes.T_odom_node[node]) @ T_odom_rig)


class _Shifted(BlockStore):
    """Blocks numbered from the first one of a part of the drive."""

    def __init__(self, folder: Path, first: int) -> None:
        super().__init__(folder)
        self._first = first

    def get(self, node: int) -> Block:
        return super().get(node + self._first)


@dataclass(frozen=True, eq=False)
class PartOfDrive(Drive):
    """A part of a drive, as if nothing else had been recorded."""

    first: int = 0

    def store(self) -> BlockStore:
        return _Shifted(self.blocks, self.first)


def part_of(drive: Drive, first: int, last: int) -> PartOfDrive:
    """The nodes from ``first`` to ``last``, excluding it."""
    n = drive.nodes
    begin, end = n.begins_and_ends()
    here = slice(first, last)
    nodes = Nodes(
        n.times_ns[here], n.T_odom_node[here], n.travelled_m[here], n.segments()[here], begin[here], end[here]
    )
    return PartOfDrive(drive.recording, nodes, drive.blocks, first)


def without_gnss(drive: Drive) -> Drive:
    """The same drive without a prior."""
    return replace(drive, recording=replace(drive.recording, prior=None))


@dataclass(frozen=True, eq=False)
class StartUnit:
    """The beginning of a registration, with or without a given pose."""

    title: str
    reference: Drive
    query: PartOfDrive
    first: FirstPose | None
    options: AlignmentOptions


def start(unit: StartUnit) -> tuple[list[Registration], list[str], Spent]:
    """The registrations of a short stretch of road, and the messages."""
    messages: list[str] = []
    track = RegistrationUnit(unit.reference, unit.query, unit.options, unit.first)
    found, spent = timed(lambda: register_query(track, messages.append))
    return found, messages, spent
