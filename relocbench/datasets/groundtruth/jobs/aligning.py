"""Recordings to registered drives: blocks, registrations and calibration, in rounds until the calibration is right.

The first round takes the calibration as it is given. If the drives contradict it, the recordings are corrected, and the
drives concerned are cut into blocks and registered anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.build import work
from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions, FirstPose, register_drives
from relocbench.datasets.groundtruth.calibration.correction import corrected
from relocbench.datasets.groundtruth.calibration.estimation import CalibrationEvidence, calibration_evidence
from relocbench.datasets.groundtruth.calibration.faults import Calibration, calibrate
from relocbench.datasets.groundtruth.calibration.files import (
    RoundFolders,
    read_evidence,
    write_calibration,
    write_evidence,
)
from relocbench.datasets.groundtruth.calibration.messages import open_kinds, report_lines
from relocbench.datasets.groundtruth.calibration.unknowns import (
    EVERY,
    RIG,
    DriveLidars,
    Sensors,
    unknowns_reduced,
)
from relocbench.datasets.groundtruth.jobs.scaling import ReducedReporter
from relocbench.datasets.groundtruth.pose_graph.graph import SharedErrors, optimise
from relocbench.datasets.groundtruth.registration.rig_mounts import contradicting_mount
from relocbench.datasets.groundtruth.submaps.drive import Drive, make_drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import DatasetError, raise_all
from relocbench.execution import Run
from relocbench.progress import Reporter

_MOST_CORRECTIONS = 3
_SETTLED = 1.0
"""corrections end when no error that was found differs from what was corrected by more standard deviations"""
_REMAINS = 3.0
"""an error remains if it differs by more standard deviations after the last correction"""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Drives, the reference first, and what the next steps need of them."""

    drives: list[Drive]
    registrations: dict[str, list[Registration]]
    """query drive -> its registrations"""
    shared: dict[str, SharedErrors]
    """query drive -> uncertainty of the calibration, where it was estimated"""


@dataclass(frozen=True, eq=False)
class _EvidenceUnit:
    reference: Drive
    query: Drive
    registrations: tuple[Registration, ...]
    sensors: Sensors
    path: Path

    def __str__(self) -> str:
        return f"calibration of {self.query.name} and {self.reference.name}"


def align(
    recordings: Sequence[FieldRecording],
    folder: Path,
    options: AlignmentOptions,
    first: FirstPose | None,
    estimate: bool,
    reporter: Reporter,
    run: Run,
    enlarged: float = 1.0,
) -> Aligned:
    """Cut recordings into blocks, register them, and estimate their calibration.

    Args:
        recordings: the reference first.
        folder: of all intermediate results; those of an earlier run are used.
        first: a pose given by hand.
        estimate: whether to estimate the calibration, or to take it as it is given.
        enlarged: how many times the recordings' metres are enlarged; notes and ``calibration.yaml`` are in metres.

    Raises:
        DatasetError: a recording or an intermediate file is damaged, or the lidars of a drive contradict each other so
            much that their extrinsics must be wrong.
    """
    sensors = Sensors(tuple(DriveLidars.of(r) for r in recordings), enlarged)
    in_metres = ReducedReporter(reporter, enlarged)
    total, wrong, corrections = np.zeros(sensors.unknowns), set[str](), 0
    while True:
        now = [corrected(r, sensors, total) if r.name in wrong else r for r in recordings]
        at = _places(recordings, wrong, folder, corrections)
        drives = [make_drive(r, at.blocks[r.name], options.block_m, in_metres, run) for r in now]
        if not corrections:
            raise_all([DatasetError(fault, d.recording.folder) for d in drives if (fault := contradicting_mount(d))])
        registrations = _register(drives, at, options, first, in_metres, run)
        if not estimate or not sensors.causes():
            return Aligned(drives, registrations, {})
        evidence = _evidence(drives, registrations, sensors, at, reporter, run)
        reduced = sum((e.reduced for e in evidence[1:]), evidence[0].reduced).about(total)
        calibration = calibrate(reduced, sensors)
        open_to = open_kinds(reduced, sensors)
        if corrections < _MOST_CORRECTIONS and _differ(calibration, total, _SETTLED):
            corrections, wrong = corrections + 1, _concerned(calibration, recordings)
            total = calibration.correction
            message = "; ".join(map(str, calibration.causes)) or "nothing"
            reporter.note(f"calibration: {message} in error; corrected, and registered again")
            continue
        reduced_calibration, removed = calibration.reduced(), total * unknowns_reduced(len(sensors), enlarged)
        file = write_calibration(folder, reduced_calibration, removed, open_to, corrections, at)
        for line in report_lines(file, reduced_calibration, sum(e.count for e in evidence)):
            reporter.note(line)
        if corrections and _differ(calibration, total, _REMAINS):
            after = "a correction" if corrections == 1 else f"{corrections} corrections"
            reporter.note(f"calibration: errors remain after {after}; they are part of the sigma of each pair")
        shared = {
            d.name: SharedErrors(e.by_calibration, calibration.uncorrected(total))
            for d, e in zip(drives[1:], evidence, strict=True)
            if e.count
        }
        return Aligned(drives, registrations, shared)


def _differ(calibration: Calibration, corrected: Array, sigmas: float) -> bool:
    """Whether an error that was found or corrected (K,) differs by more standard deviations from what was corrected."""
    concerned = (corrected != 0) | calibration.in_error
    return bool((concerned & (np.abs(calibration.errors - corrected) > sigmas * calibration.sigmas.ravel())).any())


def _concerned(calibration: Calibration, recordings: Sequence[FieldRecording]) -> set[str]:
    """Names of the drives whose lidars are in error."""
    of = {cause.of for cause in calibration.causes}
    if any(o == RIG or o.startswith(EVERY) for o in of):
        return {r.name for r in recordings}
    return {r.name for r in recordings if any(o == r.name or o.startswith(f"{r.name}/") for o in of)}


def _places(recordings: Sequence[FieldRecording], wrong: set[str], folder: Path, corrections: int) -> RoundFolders:
    """Where a round's files are: those of drives that are not concerned stay where they were from the beginning."""
    anew = folder / f"corrected-{corrections}" if corrections else folder
    both = recordings[0].name in wrong
    return RoundFolders(
        {r.name: (anew if r.name in wrong else folder) / "blocks" / r.name for r in recordings},
        {r.name: (anew if both or r.name in wrong else folder) / "registrations" for r in recordings[1:]},
    )


def _register(
    drives: Sequence[Drive],
    at: RoundFolders,
    options: AlignmentOptions,
    first: FirstPose | None,
    reporter: Reporter,
    run: Run,
) -> dict[str, list[Registration]]:
    registrations: dict[str, list[Registration]] = {}
    for folder in dict.fromkeys(at.registrations.values()):
        queries = [d for d in drives[1:] if at.registrations[d.name] == folder]
        registrations |= register_drives(drives[0], queries, folder, options, first, reporter, run)
    return registrations


def _evidence(
    drives: Sequence[Drive],
    registrations: dict[str, list[Registration]],
    sensors: Sensors,
    at: RoundFolders,
    reporter: Reporter,
    run: Run,
) -> list[CalibrationEvidence]:
    """The evidence of each query drive; that of an earlier run is read from disk."""
    units = []
    for query in drives[1:]:
        path = at.registrations[query.name].parent / "calibration" / f"{drives[0].name}__{query.name}.npz"
        units.append(_EvidenceUnit(drives[0], query, tuple(registrations[query.name]), sensors, path.resolve()))
    missing = [unit for unit in units if not unit.path.exists()]
    work("calibration of lidars", _gather, missing, run, reporter)
    # Always use the file, so that a fresh build and a resumed one use the same numbers.
    return [
        read_evidence(unit.path, sensors.unknowns, len(unit.reference.nodes) + len(unit.query.nodes)) for unit in units
    ]


def _gather(unit: _EvidenceUnit) -> None:
    solution = optimise(unit.reference.nodes, unit.query.nodes, unit.registrations)
    write_evidence(unit.path, calibration_evidence(solution, (unit.reference, unit.query), unit.sensors))
