"""Errors and calibration of the ground truth from a spinning lidar with deskewed scans, on drives in the Boreas layout.

Drives through one district are recorded as ``build-dataset synthetic --recording boreas`` records them: scans with a
time for each point, and post-processed GNSS/INS. They are read by the importer, registered and judged as
``ground_truth.py`` does it, which explains the columns: a Sunny reference against Overcast and Snow, with odometry by
the poses of the recording, and against Snow with odometry computed from the scans.

    python benchmarks/lidar/boreas_layout.py [--split train] [--seed N] [--work DIR] [--workers N]

Recordings, odometry, blocks and registrations are kept in ``--work`` and reused. Tables go to standard error; the last
line of standard output is JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # in each worker

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict

from ground_truth_drives import Leg, Spoken, Taken, taken_from
from ground_truth_judging import figures, reasons, table, worst, write_rows
from ground_truth_work import decide, register_drive
from ground_truth_world import DrivePair, World, judge, rounded, say

from relocbench.datasets.groundtruth.odometry.deferred import kept_in
from relocbench.datasets.importers.boreas.recording import read_boreas
from relocbench.datasets.importers.lidar_drives.drives import on_one_map
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.routes import route
from relocbench.datasets.synthetic.jobs.recording import DriveOptions, prepare
from relocbench.datasets.synthetic.jobs.recording_jobs import carry_out
from relocbench.datasets.synthetic.town.town import make_district
from relocbench.execution import Run

EXTENT_M = 400.0
LEGS = (Leg(0, "Sunny", "common"), Leg(1, "Overcast", "common"), Leg(2, "Snow", "common"))
PAIRS = ((0, 1), (0, 2))


class Shape(TypedDict):
    """Options of each drive."""

    frames: int
    rings: int
    azimuths: int


def record_legs(out: Path, split: str, seed: int, shape: Shape, spoken: Spoken, workers: int) -> list[Path]:
    """The folders of the drives; what is there already is kept."""
    town = make_district(seed, split, EXTENT_M)
    folders, jobs = [], []
    for leg in LEGS:
        options = DriveOptions("boreas", seed, leg.number, **shape, cameras=())
        path = route(town.network, town.periodic.street, leg.route, options.path_length_m, seed)
        found, job = prepare(town, path, condition_named(leg.condition).factors, out, options)
        folders.append(found.folder)
        jobs.append(job)
    carry_out(jobs, spoken, Run(workers))
    return folders


def read_legs(folders: Sequence[Path], from_lidar: bool, out: Path, spoken: Spoken) -> dict[int, Taken]:
    """The drives by number, with odometry by their poses or computed from their scans."""
    wanted = [
        (leg, folder) for leg, folder in zip(LEGS, folders, strict=True) if not from_lidar or leg.number in PAIRS[-1]
    ]
    drives = [read_boreas(folder, folder.name, "lidar" if from_lidar else "auto") for _, folder in wanted]
    kept = out / "groundtruth" / "odometry"
    recordings = [d.recording(kept_in(kept / f"{d.name}.csv"), spoken) for d in on_one_map(drives, spoken)]
    return {leg.number: taken_from(leg, found) for (leg, _), found in zip(wanted, recordings, strict=True)}


def measure(
    taken: dict[int, Taken], pairs: Sequence[DrivePair], work: Path, title: str, workers: int, spoken: Spoken
) -> dict[str, Any]:
    """Judge pairs of drives, and print the tables."""
    world = World(taken, work, workers, spoken)
    registered = world.all_of(register_drive, [world.register_unit(*p) for p in pairs], "drives to register")
    units = [world.decide_unit(*p, r.registrations) for p, r in zip(pairs, registered, strict=True)]
    decided = world.all_of(decide, units, "graphs to solve")
    rows = {p: judge(world, p, d.outcomes) for p, d in zip(pairs, decided, strict=True)}
    everything = [row for judged in rows.values() for row in judged]
    groups = [(judged[0].query, figures(judged)) for judged in rows.values()]
    say(f"\n{title}\n\n{table('Sunny against', [*groups, ('all', figures(everything))])}\n\n{reasons(everything)}")
    say(f"\nThe accepted pairs furthest off:\n\n{worst(everything)}\n")
    for pair, judged in rows.items():
        write_rows(work / "pairs" / f"{pair[0]}__{pair[1]}.csv", judged)
    return {name: rounded(found) for name, found in (*groups, ("all", figures(everything)))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=Path("boreas-benchmark"), help="folder that keeps all files")
    parser.add_argument("--split", choices=("train", "validation", "test"), default="test")
    parser.add_argument("--seed", type=int, default=0, help="seed of the district and the drives")
    parser.add_argument("--frames", type=int, default=200, help="images of a drive, 10 a second at 8 m/s")
    parser.add_argument("--rings", type=int, default=64)
    parser.add_argument("--azimuths", type=int, default=1024)
    parser.add_argument("--workers", type=int, default=2)
    a = parser.parse_args()
    shape: Shape = {"frames": a.frames, "rings": a.rings, "azimuths": a.azimuths}
    spoken, work = Spoken(), a.work / f"{a.split}-{a.seed}-{a.frames}-{a.rings}-{a.azimuths}"
    folders = record_legs(work / "recording", a.split, a.seed, shape, spoken, a.workers)
    run = a.workers, spoken
    poses = read_legs(folders, False, work, spoken)
    result: dict[str, Any] = {"benchmark": "boreas_layout", "split": a.split, "seed": a.seed, **shape}
    result["poses"] = measure(poses, PAIRS, work / "poses", "Odometry by the poses of the recording", *run)
    scans = read_legs(folders, True, work, spoken)
    result["scans"] = measure(scans, PAIRS[-1:], work / "scans", "Odometry computed from the scans", *run)
    result["load_average"] = [round(x, 1) for x in os.getloadavg()]
    print(json.dumps(result))


if __name__ == "__main__":
    main()
