"""Whether bags give the dataset that the layout they were made from gives, in all three formats.

Two drives of the town are recorded in the RobotCar layout (or taken from RECORDINGS), written as bags of ROS 1 and of
ROS 2 with SQLite and MCAP, and built from each. It prints a table of the bags' sizes, the pairs, and the largest
difference of an entry of a pose from the RobotCar layout's; the last line is JSON, and the exit status is 1 if a pose
differs by more than one in the last of the nine decimals that files hold.

    python benchmarks/truth/bags.py [RECORDINGS] [--steps N] [--bags FOLDER]

``--bags`` keeps the bags, to try ``relocbench inspect`` and ``relocbench build-dataset rosbag`` on them.
A drive of RECORDINGS has to fit into memory.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

from command_line import relocbench
from made_bags import Storage, write_bag

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives

_CAMERA = "stereo_left"
_COMMON = ("--keyframe-distance", 2, "--query-distance", 3, "--correspondences", 100, "-j", 1)
_AS_ROBOTCAR = (
    "--gnss",
    "/gnss/pose",
    "--min-range",
    0.1,
    "--max-range",
    50,
    "--lidar-sigma",
    0.012,
    "--max-pose-gap",
    0.5,
)
"""what the reader of the RobotCar layout takes for granted"""
_EXACT = 1.5e-9
"""files of pairs hold nine decimals, the last of which may be rounded up in one and down in the other"""


def recorded(out: Path, steps: int) -> list[Path]:
    """Two drives of the town along one route."""
    told = ("--conditions", "Sunny,Overcast", "--recording-cameras", "stereo/left", "--image-scale", 0.25)
    _run("build-dataset", "synthetic", "--recording", "robotcar", *told, "--steps", steps, "-j", 1, "--out", out)
    return sorted(out.glob("2*"))


def written(drives: Sequence[Path], folder: Path, storage: Storage) -> list[Path]:
    """The drives as bags, with the names of their traversals."""
    folder.mkdir(parents=True)
    out = []
    for recording in read_robotcar_drives(drives, cameras=[_CAMERA]):
        out.append(folder / f"{recording.name}{'.bag' if storage == 'rosbag1' else ''}")
        write_bag(recording, out[-1], storage)
    return out


def built(kind: str, sources: Sequence[Path], out: Path, *options: object) -> Dataset:
    _run("build-dataset", kind, *sources, "--out", out, "--cameras", _CAMERA, *_COMMON, *options)
    return Dataset(out)


def difference(there: Dataset, here: Dataset) -> tuple[int, float]:
    """The number of accepted pairs, and the largest difference of an entry of their poses; infinite if pairs differ."""
    pairs, largest = 0, 0.0
    for name in there.pair_set_names:
        a, b = ({(p.ref_timestamp_ns, p.query_timestamp_ns): p for p in d.pair_set(name).pairs} for d in (there, here))
        if a.keys() != b.keys() or any(a[key].accepted != b[key].accepted for key in a):
            return 0, float("inf")
        for key, pair in a.items():
            other = b[key].T_query_ref
            if pair.accepted and pair.T_query_ref is not None and other is not None:
                pairs += 1
                largest = max(largest, float(np.abs(pair.T_query_ref - other).max()))
    return pairs, largest


def _run(*words: object) -> None:
    outcome = relocbench(*words)
    if outcome.status:
        raise SystemExit(outcome.err)


def _megabytes(paths: Sequence[Path]) -> float:
    files = [p for path in paths for p in (path.rglob("*") if path.is_dir() else [path]) if p.is_file()]
    return sum(p.stat().st_size for p in files) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path, nargs="?", help="folder of two drives in the RobotCar layout")
    parser.add_argument("--steps", type=int, default=200, help="stereo images of each drive")
    parser.add_argument("--bags", type=Path, help="folder to keep the bags in")
    given = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory(prefix="relocbench-bags-") as scratch:
        here = Path(scratch)
        drives = sorted(given.recordings.glob("2*")) if given.recordings else recorded(here / "R", given.steps)
        print(f"building from {', '.join(d.name for d in drives)}", file=sys.stderr)
        there = built("robotcar", drives, here / "robotcar")
        for storage in get_args(Storage):
            print(f"building from {storage}", file=sys.stderr)
            bags = written(drives, (given.bags or here / "bags") / storage, storage)
            pairs, largest = difference(there, built("rosbag", bags, here / storage, *_AS_ROBOTCAR))
            found[storage] = {"megabytes": round(_megabytes(bags)), "pairs": pairs, "largest_difference": largest}
    for storage, row in found.items():
        told = f"{row['megabytes']} MB, {row['pairs']} pairs, largest difference {row['largest_difference']:.2g}"
        print(f"{storage:8} {told}")
    print(json.dumps({"benchmark": "bags", **found}))
    if any(not row["pairs"] or row["largest_difference"] > _EXACT for row in found.values()):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
