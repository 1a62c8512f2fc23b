"""The time of ``gn-net`` to track a pair on one core, given the features of both images, compared with ``dso``.

The pairs are of a short drive through the procedural town, 512x512 pixels, with queries in ``WetNoon`` and
``SoftRainNoon`` against a ``WetNoon`` map. The keyframe is prepared and the query's features are computed beforehand.
Timed are the search for the matched start and the alignment from all starts; the time of ``dso`` includes the query's
pyramid.

    python benchmarks/speed/gn_net_tracking.py [--repeats N] [--weights FILE] [--set KEY=VALUE ...]

The last line is JSON.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # one core; read when numpy is imported

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baselines.dso import Dso
from relocbench.datasets.core.dataset import Dataset
from relocbench.methods import parse_method
from relocbench.tracking import Query, Reference


def views(root: Path) -> list[tuple[Reference, Query]]:
    """The keyframe and the query of every pair of a dataset."""
    dataset = Dataset(root)
    return [
        (dataset.reference(pair_set, pair), dataset.query(pair_set, pair))
        for pair_set in dataset.pair_sets("validation")
        for pair in pair_set.pairs
    ]


def milliseconds(tracker: Any, pairs: list[tuple[Reference, Query]], repeats: int) -> list[float]:
    """The median processor time of each pair over the repeats; the first call is not timed."""
    times = []
    for reference, query in pairs:
        prepared = tracker.prepare(reference)
        tracker.track(prepared, query)
        taken = []
        for _ in range(repeats):
            since = time.process_time()
            tracker.track(prepared, query)
            taken.append(1e3 * (time.process_time() - since))
        times.append(float(np.median(taken)))
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--weights", type=Path, help="weights file; default: the weights that come with the package")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="parameter of gn-net")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "d"
        subprocess.run(
            [sys.executable, "-m", "relocbench", "build-dataset", "synthetic", "--conditions", "WetNoon,SoftRainNoon",
             "--size", "512x512", "--steps", "10", "--split", "validation", "--out", str(root), "-q"],
            check=True, stdout=sys.stderr,
        )  # fmt: skip
        pairs = views(root)
    settings = [*options.set, *([f"weights={options.weights}"] if options.weights else [])]
    trackers: dict[str, Any] = {
        "gn-net": parse_method("gn-net", settings).create(),
        "gn-net, matched_start=false": parse_method("gn-net", [*settings, "matched_start=false"]).create(),
        "dso": Dso(),
    }
    told: dict[str, Any] = {"benchmark": "gn_net_tracking", "pairs": len(pairs)}
    for name, tracker in trackers.items():
        times = milliseconds(tracker, pairs, options.repeats)
        told[f"{name}, ms"] = float(np.median(times))
        told[f"{name}, ms, 95 %"] = float(np.percentile(times, 95))
        print(f"{name:30} {np.median(times):6.1f} ms a pair, 95 % below {np.percentile(times, 95):6.1f} ms")
    told["ratio_to_dso"] = told["gn-net, ms"] / told["dso, ms"]
    print(json.dumps(told))


if __name__ == "__main__":
    main()
