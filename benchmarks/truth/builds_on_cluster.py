"""Kill a worker of a Dask cluster in the middle of each kind of build: the files must equal those of local workers.

Two lidar drives of the town are recorded without cameras; their ground truth is built, and images are rendered, first
by local worker processes and then on a cluster of two workers. One worker is ended by SIGKILL at a point of its work
that it reports: as it writes the points of a block, a line of the journal of registration, the evidence of
calibration, or an image. It is not replaced, so that the other worker does the rest. All files of both folders are
compared byte by byte. It prints a table, and JSON on the last line; the exit status is 1 if files differ or a kill did
not land.

    python benchmarks/truth/builds_on_cluster.py [--steps N]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

from cluster_kills import differing, on_a_cluster
from command_line import relocbench


@dataclass(frozen=True)
class Kill:
    """Where a worker dies."""

    job: str
    what: str
    path: str
    """regular expression of the files that count"""
    count: int
    event: str


KILLS = (
    Kill(
        "ground truth", "the points of its 20th block are on the disk, under a temporary name", r"\.npz$", 20, "rename"
    ),
    Kill("ground truth", "the 6th line of the journal of registration is written", r"\.journal$", 6, "append"),
    Kill("ground truth", "the evidence of calibration is about to be written", r"/calibration/.*\.npz$", 1, "write"),
    Kill("images", "the 3rd image is on the disk, under a temporary name", r"/images/.*\.png$", 3, "rename"),
)


def commands(folder: Path, steps: int) -> dict[str, list[object]]:
    """The jobs by name; the recording is made in ``folder``."""
    road = ("build-dataset", "synthetic", "--preset", "smoke", "--conditions", "Sunny,Overcast", "--quiet")
    recorded = folder / "recording"
    made = relocbench(*road, "--recording", "robotcar", "--recording-cameras", "none", "--steps", steps, "-o", recorded)
    if made.status:
        sys.exit(made.err)
    drives = sorted(path for path in recorded.iterdir() if path.name.startswith("2024-"))
    return {
        "ground truth": ["build-dataset", "robotcar", *drives, "--quiet"],
        "images": [*road, "--size", "96x72"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100, help="frames of the recorded drives, half a metre apart")
    parser.add_argument("--scratch", type=Path, help="folder that is kept; default: a temporary one")
    chosen = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    start = time.monotonic()
    rows, right = [], True
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.scratch or Path(temporary)
        jobs = commands(folder, chosen.steps)
        for name, command in jobs.items():
            local = relocbench(*command, "-j", 2, "-o", folder / f"{name}-local")
            if local.status:
                sys.exit(local.err)
        for number, kill in enumerate(KILLS):
            out = folder / f"{kill.job}-{number}"
            pattern = rf"^{out.resolve()}/.*{kill.path}"
            ended = on_a_cluster(
                [*jobs[kill.job], "-o", out], pattern, kill.count, kill.event, folder / f"cluster-{number}"
            )
            if ended.outcome.status:
                sys.exit(ended.outcome.err)
            expected = folder / f"{kill.job}-local"
            files = sum(path.is_file() for path in expected.rglob("*"))
            differ = differing(expected, out)
            right &= not differ and ended.landed is not None and ended.left == 1
            rows.append((kill, files, differ, ended.landed is not None, ended.left))
    print(f"{'job':14}{'killed when':72}{'landed':>7}{'workers left':>14}{'files':>7}{'differing':>11}")
    for kill, files, differ, landed, left in rows:
        print(f"{kill.job:14}{kill.what:72}{'yes' if landed else 'no':>7}{left:14}{files:7}{len(differ):11}")
        for name in differ:
            print(f"  differs: {name}")
    record = {
        "benchmark": "builds_on_cluster",
        "kills": sum(landed for *_, landed, _ in rows),
        "files": sum(files for _, files, *_ in rows),
        "differing_files": sum(len(differ) for _, _, differ, *_ in rows),
        "seconds": round(time.monotonic() - start, 1),
    }
    print(json.dumps(record))
    sys.exit(not right)


if __name__ == "__main__":
    main()
