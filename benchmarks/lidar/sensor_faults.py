"""Ground truth from lidar where sensors are a little wrong: what is accepted, how far off it is, and what is said.

Drives of a district are recorded with exact truth, in the RobotCar layout (push-broom lidars, visual odometry) and with
a spinning lidar (odometry from its scans). Each case spoils what a recording says of its sensors, and builds from it as
from a real recording: a lidar whose clock is late, extrinsics that are off, GNSS that is off by 85 m, few rings, scans
that the motion distorts. A pair is wrong if it is off by more than 0.3 m or 1 degree; the normalised error squared is
the mean of ``e^T C^-1 e / 6``, which is 1 if covariances are correct.

    python benchmarks/lidar/sensor_faults.py [--split train] [--seed 0] [--work DIR] [--cases late,turned]

The error of extrinsics is drawn from the seed. The table goes to standard error; the last line of standard output is
JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # in each worker

import argparse
import json
import resource
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from case_figures import case_figures, off_truth
from ground_truth_drives import EXTENT_M, T_RIG_CAM, Leg, Spoken, Taken, read_legs, record_legs
from ground_truth_judging import WRONG_DEG, WRONG_M
from sensor_faults_spinning import record_spinning
from sensor_faults_spoils import (
    Spoil,
    bent,
    jumped,
    late,
    lost,
    mirrored,
    misplaced,
    mounted,
    mounted_as_stated,
    moved_back,
    part,
    repeated,
    same,
    stretched,
    turned,
    unlocated,
    upside_down,
    way_of,
)

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.jobs.aligning import align
from relocbench.datasets.groundtruth.jobs.inputs import driven_m, faults_of, motion_faults
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.odometry.jumps import interrupted
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames, PairingUnit, pair_up
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import invert, make_transform, so3_exp

T_RIG_BACK = make_transform(so3_exp([0.0, 0.0, np.pi]), [0.0, 0.0, 0.0]) @ T_RIG_CAM
"""a camera that looks back, which sees on the way back what the other one saw"""
RETURN, ELSEWHERE, OVERCAST_RETURN, REPEATING, OVERCAST_REPEATING, RAIN = 2, 3, 4, 5, 6, 7
"""numbers of drives: the other way, through another district, along repeating facades, and in rain"""
LEGS = {
    leg.number: leg
    for leg in (
        Leg(0, "Sunny", "common"),
        Leg(1, "Overcast", "common"),
        Leg(RETURN, "Sunny", "return"),
        Leg(ELSEWHERE, "Overcast", "common"),
        Leg(OVERCAST_RETURN, "Overcast", "return"),
        Leg(REPEATING, "Sunny", "periodic"),
        Leg(OVERCAST_REPEATING, "Overcast", "periodic"),
        Leg(RAIN, "Rain", "common"),
    )
}
_PART_M = 36.0
"""half of a street of repeating facades, whose middle is that of the drives along it"""


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    title: str
    query: int
    """number of the query's leg"""
    reference: Spoil = same
    spoil: Spoil = same
    ref: int = 0
    """number of the reference's leg"""
    ends_m: float = np.inf
    """only pairs so close to the beginning or the end of the query's drive are in the table"""

    @property
    def legs(self) -> tuple[int, int]:
        return self.ref, self.query


def cases(seed: int) -> dict[str, Case]:
    """The cases of drives with push-broom lidars, by name."""

    def off(recording: FieldRecording) -> FieldRecording:
        return misplaced(recording, seed)

    def as_stated(number: int) -> Spoil:
        return lambda recording: mounted_as_stated(recording, seed, number)

    def over(recording: FieldRecording) -> FieldRecording:
        return bent(mounted(recording, upside_down))

    def backwards(recording: FieldRecording) -> FieldRecording:
        return mounted(recording, lambda T: turned(T, np.array([0.0, 0.0, np.pi])))

    def one_backwards(recording: FieldRecording) -> FieldRecording:
        return mounted(recording, lambda T: turned(T, np.array([0.0, 0.0, np.pi])), ("lms_rear",))

    def one_over(recording: FieldRecording) -> FieldRecording:
        return mounted(recording, upside_down, ("lms_rear",))

    def first_half(recording: FieldRecording) -> FieldRecording:
        return part(recording, -_PART_M, 0.0)

    def second_half(recording: FieldRecording) -> FieldRecording:
        return part(recording, 0.0, _PART_M)

    def as_first(recording: FieldRecording) -> FieldRecording:
        return second_half(moved_back(recording, _PART_M))

    def with_crossing(recording: FieldRecording) -> FieldRecording:
        return part(moved_back(recording, _PART_M), 0.0, 60.0)

    def whole(recording: FieldRecording) -> FieldRecording:
        return part(recording, -_PART_M, _PART_M)

    def repeating(title: str, reference: Spoil, spoil: Spoil) -> Case:
        return Case(title, OVERCAST_REPEATING, reference, spoil, REPEATING)

    return {
        "right": Case("nothing wrong", 1),
        "rain": Case("nothing wrong, rain", RAIN),
        "rain-ends": Case("the same, the first and the last 4 m", RAIN, ends_m=4.0),
        "parts": repeating(
            "different parts of a street of repeating facades, GNSS as if they were one", first_half, as_first
        ),
        "parts-alone": repeating(
            "the same without GNSS", lambda r: unlocated(first_half(r)), lambda r: unlocated(second_half(r))
        ),
        "parts-crossing": repeating(
            "the same with GNSS, and the crossings at its ends", lambda r: part(r, -60.0, 0.0), with_crossing
        ),
        "same-part": repeating("one part of a street of repeating facades", whole, whole),
        "late": Case("both lidars of one drive 50 ms late", 1, spoil=lambda r: late(r, ("lms_front", "lms_rear"))),
        "late-10": Case("both lidars of one drive 10 ms late", 1, spoil=lambda r: late(r, late_ns=10_000_000)),
        "one-late": Case("one of two lidars 50 ms late", 1, spoil=lambda r: late(r, ("lms_rear",))),
        "return": Case("nothing wrong, driven opposite ways", RETURN),
        "return-overcast": Case("the same, overcast on the way back", OVERCAST_RETURN),
        "stated": Case("a rig off by what its calibration is taken for, the same way", 1, as_stated(0), as_stated(1)),
        "return-stated": Case("the same rig, opposite ways", RETURN, as_stated(0), as_stated(RETURN)),
        "turned": Case("extrinsics 1 deg and 5 cm off in both drives, driven opposite ways", 2, off, off),
        "turned-one": Case("extrinsics 1 deg and 5 cm off in one drive", 1, spoil=off),
        "doubled": Case("every second scan repeats the one before", 1, spoil=lambda r: repeated(r, 2)),
        "tripled": Case("every scan sent three times, in both drives", 1, *[lambda r: repeated(r, 3)] * 2),
        "over": Case("lidars upside down, odometry 2 % long and 3 deg a 100 m off", 1, spoil=over),
        "over-both": Case("the same in both drives", 1, over, over),
        "one-over": Case("one of two lidars upside down", 1, spoil=one_over),
        "one-backwards": Case("one of two lidars turned by 180 deg", 1, spoil=one_backwards),
        "backwards": Case("lidars turned by 180 deg", 1, spoil=backwards),
        "backwards-both": Case("the same in both drives", 1, backwards, backwards),
        "mirrored": Case("left and right of the lidars exchanged", 1, spoil=lambda r: mounted(r, mirrored)),
        "mirrored-both": Case("the same in both drives", 1, *[lambda r: mounted(r, mirrored)] * 2),
        "inverse": Case("inverse extrinsics of the lidars", 1, spoil=lambda r: mounted(r, invert)),
        "inverse-both": Case("the same in both drives", 1, *[lambda r: mounted(r, invert)] * 2),
        "elsewhere": Case("drives that do not meet, GNSS as if they did", ELSEWHERE),
        "elsewhere-alone": Case("drives that do not meet, no GNSS", ELSEWHERE, unlocated, unlocated),
        "gnss": Case("GNSS 85 m off", 1, spoil=lost),
        "jump": Case("one step of the odometry 32 cm and 1 deg off", 1, spoil=jumped),
        "drift": Case("odometry of one drive 8 % too long", 1, spoil=lambda r: stretched(r, 1.08)),
        "drift-alone": Case(
            "odometry of one drive 5 % too long, no GNSS", 1, unlocated, lambda r: unlocated(stretched(r, 1.05))
        ),
    }


SPINNING = {
    "rings-32": ("spinning lidar, 32 rings", 32, False),
    "rings-16": ("spinning lidar, 16 rings, distorted by motion", 16, True),
}


def outcomes(
    a: Taken, b: Taken, case: Case, folder: Path, spoken: Spoken, workers: int
) -> tuple[list[PairOutcome], Array, list[str]]:
    """The outcomes of a build, the pose (4, 4) of the query's camera on its rig, and what the build said."""
    options, T_rig_cam = FieldOptions(), T_RIG_BACK if LEGS[case.query].route == "return" else T_RIG_CAM
    told = _Listening(spoken)
    recordings = [case.reference(a.recording), case.spoil(b.recording)]
    faults = [fault for recording in recordings for fault in faults_of(recording, ())]
    if not faults:
        recordings = [interrupted(r, told) for r in recordings]
        faults = [fault for recording in recordings for fault in motion_faults(recording, options, told)]
    if faults:
        return [], T_rig_cam, [*told.notes, *(f"refused: {fault.expected}" for fault in faults)]
    try:
        aligned = align(recordings, folder, options.alignment, None, True, told, Run(workers))
    except DatasetError as fault:
        return [], T_rig_cam, [*told.notes, f"refused: {fault.expected}"]
    name = aligned.drives[1].name
    driven = [r.odometry.times_ns[[0, -1]] for r in (case.reference(a.recording), case.spoil(b.recording))]
    images = (
        tuple(time for time in taken.image_ns if first <= time <= last)
        for taken, (first, last) in zip((a, b), driven, strict=True)
    )
    frames = CameraFrames("camera", T_RIG_CAM, T_rig_cam, *images)
    registrations = tuple(aligned.registrations[name])
    limits = options.limits_at(1.0), options.max_angle
    drives = aligned.drives[0], aligned.drives[1]
    unit = PairingUnit(*drives, registrations, (frames,), *limits, aligned.shared.get(name))
    return pair_up(unit).outcomes["camera"], T_rig_cam, told.notes


class _Listening(Spoken):
    """Progress that keeps what is said."""

    def __init__(self, spoken: Spoken) -> None:
        self.begin = spoken.begin
        self.notes: list[str] = []

    def note(self, message: str) -> None:
        if message.startswith(("calibration", "nothing holds", "the drives were")) or ": " in message:
            self.notes.append(message)
        super().note(message)


def row(a: Taken, b: Taken, found: list[PairOutcome], T_rig_cam: Array) -> dict[str, Any]:
    """The figures of a case."""
    off, along = [], []
    for pair in found:
        if pair.accepted:
            T_world_ref = a.truth.at(np.array([pair.ref_timestamp_ns]))[0] @ T_RIG_CAM
            T_world_query = b.truth.at(np.array([pair.query_timestamp_ns]))[0] @ T_rig_cam
            T_query_ref = invert(T_world_query) @ T_world_ref
            off.append(off_truth(pair, T_query_ref))
            assert pair.T_query_ref is not None
            along.append(float((T_rig_cam @ invert(pair.T_query_ref @ invert(T_query_ref)))[0, 3]))
    figures = case_figures(found, off, sum(m > WRONG_M or d > WRONG_DEG for m, d, _ in off))
    return figures | {"along_m": round(float(np.mean(along)), 5) if along else None}


def at_ends(case: Case, b: Taken, found: list[PairOutcome]) -> list[PairOutcome]:
    """The pairs near the ends of the query's drive that the case is about."""
    way = way_of(b.truth.T_world_rig)
    first, last, at = (
        np.interp(np.array(times, dtype=np.float64) - b.truth.times_ns[0], b.truth.times_ns - b.truth.times_ns[0], way)
        for times in ([b.image_ns[0]], [b.image_ns[-1]], [p.query_timestamp_ns for p in found])
    )
    return [p for p, near in zip(found, np.minimum(at - first, last - at) <= case.ends_m, strict=True) if near]


def line(title: str, f: dict[str, Any]) -> str:
    """A row of the table in Markdown."""
    seconds = f"{f['processor_s_per_m']:.2f} s"
    if not f["pairs"]:
        because = f["refused_because"].removeprefix("refused: ")
        return f"| {title} | refused before any registration | | | | | {because} | {seconds} |"
    if not f["accepted"]:
        return f"| {title} | 0 of {f['pairs']} | | | | | {f['refused_because']} | {seconds} |"
    return (
        f"| {title} | {f['accepted']} of {f['pairs']} | {100 * float(f['median_m']):.1f} cm, {f['median_deg']:.3f}° | "
        f"{100 * float(f['max_m']):.1f} cm, {f['max_deg']:.3f}° | {100 * float(f['along_m']):+z.1f} cm | "
        f"{f['normalised']} | {f['refused_because']} | "
        f"{seconds} |"
    )


def _processor_s() -> float:
    """Seconds of processor time of this process and of those that it started and that have ended."""
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=Path("sensor-faults"), help="folder of all intermediate files")
    parser.add_argument("--split", choices=("train", "validation", "test"), default="test")
    parser.add_argument("--seed", type=int, default=0, help="seed of the district, the drives and the errors")
    parser.add_argument("--frames", type=int, default=240, help="images of each drive: twice as many as metres")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cases", default="", help="default: all")
    a = parser.parse_args()
    known = cases(a.seed)
    chosen = a.cases.split(",") if a.cases else [*known, *SPINNING]
    if unknown := set(chosen) - {*known, *SPINNING}:
        parser.error(f"no case {', '.join(sorted(unknown))}; there is {', '.join([*known, *SPINNING])}")
    spoken, work = Spoken(), a.work / f"{a.split}-{a.seed}-{a.frames}"
    legs = [LEGS[n] for n in sorted({n for name in chosen if name in known for n in known[name].legs})]
    folders: dict[int, Path] = {}
    for folder, seed in (("recording", a.seed), ("other", a.seed + 1)):
        here = [leg for leg in legs if (leg.number == ELSEWHERE) == (folder == "other")]
        if here:
            folders |= record_legs(here, work / folder, a.split, seed, a.frames, EXTENT_M, spoken, a.workers)
    result: dict[str, dict[str, Any]] = {}
    lines: list[str] = []
    for name in chosen:
        if name in known:
            case = known[name]
            taken = read_legs(legs, folders)
            pair = taken[case.ref], taken[case.query]
        else:
            title, rings, distorted = SPINNING[name]
            case = Case(title, 1)
            pair = record_spinning(work / name, a.split, a.seed, a.frames, rings, distorted, spoken, a.workers)
        spoken.note(f"case {name}: {case.title}")
        began = _processor_s()
        found, T_rig_cam, notes = outcomes(*pair, case, work / "built" / name, spoken, a.workers)
        found = at_ends(case, pair[1], found)
        spent = (_processor_s() - began) / driven_m(pair[1].recording)
        result[name] = row(*pair, found, T_rig_cam) | {"notes": notes, "processor_s_per_m": round(spent, 3)}
        if not found:
            result[name]["refused_because"] = notes[-1]
        lines.append(line(case.title, result[name]))
        spoken.note(lines[-1])
    head = "| situation | accepted | median | largest | mean along | normalised squared error "
    head += "| most frequent reason of refusal "
    head += "| processor time a metre |"
    print("\n".join(["", head, "|---" * 8 + "|", *lines, ""]), file=sys.stderr)
    print(json.dumps({"benchmark": "sensor_faults", "split": a.split, "seed": a.seed, "cases": result}))


if __name__ == "__main__":
    main()
