"""``relocbench register`` on clouds with known poses: how many are trusted, how wrong they are, how honest their sigma.

Simulated: scans of streets in other weather (``street``), by a car that drives back in the other lane (``reverse``),
short submaps of opposite drives (``submaps``), the street of repeating facades (``periodic``); rooms of 4 to 6 m
scanned twice (``room``), put together without sensors (``merged``), seen by a depth camera (``depth``); an object of
1 m (``object``); and clouds of different places (``other streets``, ``other rooms``, ``other merged``,
``other depth``), all of which must be refused, as must shapes that leave motions open (``corridor``, ``floor``,
``tunnel``, ``sphere``, ``staircase``).

Real: all pairs of KITTI 07 and Newer College against their graph, which is itself off by centimetres, clouds of
different recordings, views of the TUM RGB-D depth camera against the motion capture, and the demo of small_gicp against
its own pose.

The spread of the surfaces of either cloud about the other's is printed at both poses: where it is larger at the known
one, that pose is off. NES is the squared error normalised by the stated information, divided by 6: about 1 if sigma is
honest. A registration within 0.3 m and 1 deg is right, in scenes smaller than a street within 3 cm and 1 deg.
``--from-truth`` starts at the true pose instead of a search, to measure NES on many seeds in less time.

    python benchmarks/lidar/register_clouds.py [--seeds 0,1,2] [--parts street,room,...] [--data DIR] [--from-truth]

Real clouds are read from --data, by default $RELOCBENCH_REAL_DATA or ../shared/data; missing ones are skipped.
Tables go to standard error; the last line of standard output is JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # so that the order of sums does not depend on the machine

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from register_real import real_pairs
from register_scenes import (
    Pair,
    depth_pair,
    merged_room_pair,
    room_pair,
    street_pair,
    submap_pair,
    thing_pair,
    unrelated_depth,
    unrelated_rooms,
    unrelated_streets,
)
from register_shapes import SHAPES, shape_pair

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.register import CloudRegistration, CloudRegistrationOptions, register_clouds
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, icp_result_at
from relocbench.datasets.groundtruth.registration.global_registration import pose_difference
from relocbench.errors import RelocbenchError
from relocbench.geometry import invert, se3_log

SIMULATED: dict[str, Callable[[int], Pair]] = {
    "street": lambda seed: street_pair(seed, opposite=False),
    "reverse": lambda seed: street_pair(seed, opposite=True),
    "submaps": submap_pair,
    "periodic": lambda seed: street_pair(seed, opposite=False, name="periodic"),
    "room": room_pair,
    "merged": merged_room_pair,
    "depth": depth_pair,
    "object": thing_pair,
    "other streets": unrelated_streets,
    "other rooms": unrelated_rooms,
    "other depth": unrelated_depth,
    "other merged": lambda seed: unrelated_rooms(seed, merged=True),
    **{name: partial(shape_pair, name) for name in SHAPES},
}
REAL = ("kitti 07", "newer college", "tum rgbd", "small gicp", "other real")
DATA = Path(os.environ.get("RELOCBENCH_REAL_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def right(found: CloudRegistration, pair: Pair) -> bool:
    if not np.isfinite(pair.T_a_b).all():
        return False
    metres, degrees = pose_difference(pair.T_a_b, found.T_a_b)
    return metres <= (0.3 if found.scale.factor <= 2 else 0.03) and degrees <= 1.0


def spread_m(found: CloudRegistration, T_a_b: Array) -> float:
    """The robust standard deviation of the distances between the clouds' surfaces at a pose (4, 4)."""
    if not found.sides or not np.isfinite(T_a_b).all():
        return float("nan")
    a, b = (side.prepared for side in found.sides)
    T = invert(a.T_cloud_node) @ found.scale.enlarged(T_a_b) @ b.T_cloud_node
    return icp_result_at(a.planes, b.planes, T, IcpOptions()).sigma_m / found.scale.factor


def tell(title: str, pairs: Iterator[tuple[str, Pair]], *, from_truth: bool) -> dict[str, Any]:
    """Register pairs, print a line for each, and return the statistics of the trusted ones."""
    count, wrong, metres, degrees, nes = 0, 0, [], [], []
    for name, pair in pairs:
        begin = time.process_time()
        start = pair.T_a_b if from_truth and np.isfinite(pair.T_a_b).all() else None
        found = register_clouds(pair.a, pair.b, CloudRegistrationOptions(initial=start))
        spent, count = time.process_time() - begin, count + 1
        known = bool(np.isfinite(pair.T_a_b).all() and np.isfinite(found.T_a_b).all())
        off = pose_difference(pair.T_a_b, found.T_a_b) if known else (np.nan, np.nan)
        xi: Array = se3_log(invert(found.T_a_b) @ pair.T_a_b) if known else np.full(6, np.nan)
        said = "trusted" if found.trusted else found.reason
        here, there = (100 * spread_m(found, T) for T in (found.T_a_b, pair.T_a_b))
        say(
            f"{title:14s} {name:8s} off {100 * off[0]:8.2f} cm {off[1]:7.3f} deg, "
            f"sigma {100 * float(found.sigma_m.max()):8.2g} cm, x{found.scale.factor:<5.3g} {spent:5.1f} s  {said}, "
            f"spread {here:.2f} cm, at the known pose {there:.2f} cm"
        )
        if found.trusted:
            wrong += not right(found, pair)
            metres.append(off[0])
            degrees.append(off[1])
            nes.append(float(xi @ found.information @ xi) / 6)
    return {
        "pairs": count,
        "trusted": len(metres),
        "wrong": wrong,
        "median_cm": rounded(100 * np.median(metres)) if metres else None,
        "median_deg": rounded(np.median(degrees)) if degrees else None,
        "max_cm": rounded(100 * np.max(metres)) if metres else None,
        "nes": rounded(np.mean(nes)) if nes else None,
    }


def rounded(value: float | np.floating[Any]) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    parser.add_argument("--seeds", default="0,1,2", help="seeds of the simulated scenes")
    parser.add_argument("--parts", default=",".join([*SIMULATED, *REAL]), help="parts to run")
    parser.add_argument("--from-truth", action="store_true", help="start at the true pose instead of a search")
    arguments = parser.parse_args()
    parts = arguments.parts.split(",")
    unknown = [part for part in parts if part not in SIMULATED and part not in REAL]
    if unknown:
        parser.error(f"no part '{unknown[0]}'; there are {', '.join([*SIMULATED, *REAL])}")
    seeds = [int(seed) for seed in arguments.seeds.split(",")]
    result: dict[str, Any] = {}
    try:
        for part in parts:
            if part in SIMULATED:
                make = SIMULATED[part]
                result[part] = tell(part, ((str(seed), make(seed)) for seed in seeds), from_truth=arguments.from_truth)
            else:
                pairs = real_pairs(part, arguments.data)
                if pairs is None:
                    say(f"skipped: nothing of '{part}' in {arguments.data}")
                else:
                    result[part] = tell(part, pairs, from_truth=arguments.from_truth)
    except RelocbenchError as error:
        say(str(error))
        sys.exit(2)
    say(f"\n{'':14s} {'pairs':>5s} {'trusted':>7s} {'wrong':>5s} {'median':>20s} {'largest':>10s} {'NES':>6s}")
    for part, row in result.items():
        cells = [
            ("-" if v is None else f"{v:.2f}") for v in (row["median_cm"], row["median_deg"], row["max_cm"], row["nes"])
        ]
        say(f"{part:14s} {row['pairs']:5d} {row['trusted']:7d} {row['wrong']:5d} {cells[0]:>9s} cm {cells[1]:>4s} deg "
            f"{cells[2]:>7s} cm {cells[3]:>6s}")  # fmt: skip
    print(json.dumps({"benchmark": "register_clouds", "seeds": seeds, **result}))


if __name__ == "__main__":
    main()
