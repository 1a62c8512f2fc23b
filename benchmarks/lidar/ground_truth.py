"""Errors, calibration and speed of the ground truth from lidar, measured on simulated drives with exact truth.

Lidar drives through one district are recorded in the layout of the RobotCar dataset, with odometry that drifts and GNSS
that is off by metres, differently for each drive. They are read and registered like real ones: a Sunny reference
against Overcast, Rain, Snow and Night on the same route, along a street of repeating facades, through a crossing in
another direction, and on a route that leaves the reference and returns. Each query image (one per metre, of a camera
that looks ahead) is paired with the nearest keyframe. A pair is ``overlapping`` if in truth a keyframe is within
``max_distance`` and ``max_angle``, ``elsewhere`` if none is, and neither within 5 cm or half a degree of a limit. An
accepted pair is ``wrong`` if its error exceeds 0.3 m or 1 deg. The normalised error squared is the mean of ``e^T C^-1 e
/ 6`` over accepted pairs, which is 1 if covariances are correct.

    python benchmarks/lidar/ground_truth.py [--split train] [--work DIR] [--parts pairs,starts,ablation,speed] [--long]

The parts are ``pairs``, the tables above; ``starts``, the beginning of a registration without a prior, and with correct
and wrong ones given by hand; ``ablation``, single pairs, then with one stage of the builder after the other; and
``speed``, processor seconds for each pair, compared with the plain recipe with Open3D on the same road. ``--long``
measures only time and memory on 1 km and 4 km of road. Recordings, blocks and registrations are kept in ``--work`` and
reused; remove ``blocks`` or ``registrations`` there after changing the code that makes them. Tables go to standard
error; the last line of standard output is JSON.
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
from typing import Any

from ground_truth_drives import (
    EXTENT_M,
    FRAMES,
    LEGS,
    PAIRS,
    Spoken,
    facade_period_m,
    read_legs,
    record_legs,
)
from ground_truth_judging import Judged, figures, reasons, table, worst, write_rows
from ground_truth_stages import START_PAIRS, ablation, long_road, speed, starts
from ground_truth_work import Decided, Registered, decide, register_drive
from ground_truth_world import DrivePair, World, judge, rounded, say

PARTS = ("pairs", "starts", "ablation", "speed")


def all_pairs(world: World, pairs: Sequence[DrivePair]) -> tuple[dict[DrivePair, Registered], dict[DrivePair, Decided]]:
    """Run the builder on every pair of drives."""
    found = world.all_of(register_drive, [world.register_unit(*p) for p in pairs], "drives to register")
    registered = dict(zip(pairs, found, strict=True))
    units = [world.decide_unit(*p, registered[p].registrations) for p in pairs]
    return registered, dict(zip(pairs, world.all_of(decide, units, "graphs to solve"), strict=True))


def tell_pairs(
    world: World, registered: dict[DrivePair, Registered], rows: dict[DrivePair, list[Judged]]
) -> dict[str, Any]:
    """Print tables of all pairs, and whether the promises about them hold."""
    groups = [(judged[0].query, figures(judged)) for judged in rows.values()]
    everything = [row for judged in rows.values() for row in judged]
    total = figures(everything)
    say(f"\n{table('Sunny against', [*groups, ('all', total)])}")
    say(f"\n{reasons(everything)}")
    say(f"\nThe accepted pairs furthest off:\n\n{worst(everything)}\n")
    missed = [r for r in everything if r.kind == "overlapping" and not r.accepted]
    say(
        f"Overlapping pairs rejected: {len(missed)}, of which within 15 m of an end of a drive "
        f"{sum(r.to_end_m < 15 for r in missed)}, at turns of more than 30 deg {sum(r.turn_deg > 30 for r in missed)}"
    )
    for pair, found in registered.items():
        for message in found.messages:
            say(f"{world.taken[pair[1]].leg.title}: {message}")
    for pair, judged in rows.items():
        a, b = (world.drives[n].name for n in pair)
        write_rows(world.work / "pairs" / f"{a}__{b}.csv", judged)
    targets = {
        "median": total["median_m"] <= 0.02 and total["median_deg"] <= 0.05,
        "p95": total["p95_m"] <= 0.05 and total["p95_deg"] <= 0.15,
        "none wrong": total["wrong"] == 0,
        "accepted of overlapping": total["accepted_of_overlapping"] >= 95,
        "rejected of elsewhere": not total["rejected_of_elsewhere"] < 100,
        "calibrated": 0.5 <= total["normalised"] <= 2,
        "pairs": total["pairs"] >= 500,
    }
    return {"all": rounded(total), "drives": {n: rounded(f) for n, f in groups}, "targets": targets}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--work", type=Path, default=Path("ground-truth-benchmark"), help="folder that keeps all intermediate files"
    )
    parser.add_argument("--split", choices=("train", "validation", "test"), default="test")
    parser.add_argument("--seed", type=int, default=0, help="seed of the district and the drives")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--parts", default=",".join(PARTS), help="which tables to make")
    numbers = ",".join(str(query) for _, query in PAIRS)
    parser.add_argument("--queries", default=numbers, help="numbers of the query drives in the tables, for development")
    parser.add_argument("--long", action="store_true", help="measure 1 km and 4 km of road instead")
    a = parser.parse_args()
    parts = a.parts.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"no part {', '.join(sorted(unknown))}; there is {', '.join(PARTS)}")
    spoken, work = Spoken(), a.work / f"{a.split}-{a.seed}"
    result: dict[str, Any] = {"benchmark": "ground_truth", "split": a.split, "seed": a.seed}
    if a.long:
        result["long"] = long_road(work, a.split, a.seed, a.workers, spoken)
    else:
        pairs = [p for p in PAIRS if str(p[1]) in a.queries.split(",")] if parts != ["starts"] else []
        if not pairs and parts != ["starts"]:
            parser.error(f"--queries: none of {numbers}")
        used = {n for p in pairs for n in p} | ({n for p in START_PAIRS for n in p} if "starts" in parts else set())
        legs = [leg for leg in LEGS if leg.number in used]
        folders = record_legs(legs, work / "recording", a.split, a.seed, FRAMES, EXTENT_M, spoken, a.workers)
        world = World(read_legs(legs, folders), work, a.workers, spoken)
        registered, decided = all_pairs(world, pairs)
        rows = {p: judge(world, p, d.outcomes) for p, d in decided.items()}
        plain: list[Judged] = []
        if "pairs" in parts:
            result |= tell_pairs(world, registered, rows)
        if "starts" in parts:
            result["starts"] = starts(world, facade_period_m(work / "recording", a.split, a.seed, EXTENT_M))
        if "speed" in parts:
            result["speed"], plain = speed(world, registered, decided, rows)
        if "ablation" in parts:
            result["ablation"] = ablation(world, registered, decided, plain)
    result["load_average"] = [round(x, 1) for x in os.getloadavg()]
    print(json.dumps(result))


if __name__ == "__main__":
    main()
