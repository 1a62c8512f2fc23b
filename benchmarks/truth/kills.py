"""Kill jobs at work and resume them: their files must equal those of an undisturbed run, byte for byte.

Five kinds of job (a dataset of a recording, rendered drives, a training after its first checkpoint, an evaluation, a
leaderboard) are each killed ``--kills`` times, at points that the jobs report to have reached: the whole job with its
workers, its main process alone, or a worker. Each is run again until it is done. The comparison leaves out the times
that the documentation names. It prints a table, and JSON on the last line; the exit status is 1 if files differ.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

from kill_campaign import Job, Outcome, campaign
from kitti_wall import write_kitti_recording
from made_pairs import TINY
from small_dataset import ACROSS, WITHIN, make_small_dataset

from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.progress import Silent

SETTINGS = {**TINY, "steps": 10, "validate_every": 5, "checkpoint_every": 2, "log_every": 1}


def jobs(folder: Path) -> list[Job]:
    """The jobs; their input is made in ``folder``."""
    recording = write_kitti_recording(folder / "recording", range(14), 13)
    splits = {"train": [ACROSS, WITHIN], "validation": [ACROSS]}
    pairs = make_small_dataset(folder / "pairs", frames=5, correspondences=300, splits=splits, rejected=1).root
    results = folder / "results"
    methods = ("shift=trackers_for_tests:Shift", "identity")
    evaluate_methods(EvaluateOptions(dataset=pairs, methods=methods, out=results, workers=1), Silent())

    def relocbench(*words: object) -> list[object]:
        return ["python", "-m", "relocbench", *words, "-q"]

    build = ("build-dataset", "kitti", recording, "--pair-step", "1,2", "--correspondences", 100, "--max-disparity", 64)
    render = ("build-dataset", "synthetic", "--preset", "smoke", "--conditions", "Neutral,Rain", "--size", "96x72")
    train = ("train", "gn-net", "-d", pairs, "-j", 0, "--device", "cpu", "--validation-pairs", 4)
    evaluate = ("evaluate", "-d", pairs, "-m", "a=trackers_for_tests:Shift", "-m", "b=trackers_for_tests:Batched")
    return [
        Job("build", lambda out: relocbench(*build, "-j", 2, "-o", out)),
        Job("render", lambda out: relocbench(*render, "-j", 2, "-o", out)),
        Job("train", lambda out: relocbench(*train, *_set(SETTINGS), "-o", out), False, after="checkpoint.pt"),
        Job("evaluate", lambda out: relocbench(*evaluate, "--split", "train", "-j", 2, "-o", out)),
        Job("leaderboard", lambda out: relocbench("leaderboard", results, "-o", out), False),
    ]


def _set(options: dict[str, object], group: str = "") -> list[str]:
    out = []
    for key, value in options.items():
        if isinstance(value, dict):
            out += _set(value, f"{group}{key}.")
        else:
            out += ["--set", f"{group}{key}={value}"]
    return out


def table(outcomes: Sequence[Outcome]) -> str:
    lines = [f"{'job':12}{'kills':>6}{'all/main/worker':>17}{'resumed':>9}{'trees':>7}{'differing':>11}  at"]
    for each in outcomes:
        died = "/".join(str(each.died[who]) for who in ("all", "main", "worker"))
        at = ", ".join(f"{event} {count}" for event, count in sorted(each.at.items()))
        lines.append(
            f"{each.job:12}{each.landed:6}{died:>17}{each.resumptions:9}{each.trees:7}{len(each.differing):11}  {at}"
        )
        lines += [f"  differs: {name}" for name in each.differing] + [f"  broke: {what}" for what in each.broken]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20, help="kills of each job")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", default="", help="names of jobs, separated by commas; default: all")
    parser.add_argument("--scratch", type=Path, help="folder that is kept; default: a temporary one")
    chosen = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.scratch or Path(temporary)
        wanted = [job for job in jobs(folder / "inputs") if not chosen.jobs or job.name in chosen.jobs.split(",")]
        outcomes = []
        for job in wanted:
            outcomes.append(campaign(job, chosen.kills, folder / job.name, chosen.seed))
            print(table(outcomes[-1:]).splitlines()[-1] if outcomes[-1].right else table(outcomes[-1:]), flush=True)
    print(table(outcomes))
    record = {
        "benchmark": "kills",
        "landed": sum(each.landed for each in outcomes),
        "resumptions": sum(each.resumptions for each in outcomes),
        "differing_files": sum(len(each.differing) for each in outcomes),
        "broken_runs": sum(len(each.broken) for each in outcomes),
        "jobs": {each.job: each.landed for each in outcomes},
        "seconds": round(time.monotonic() - start, 1),
    }
    print(json.dumps(record))
    sys.exit(not all(each.right for each in outcomes))


if __name__ == "__main__":
    main()
