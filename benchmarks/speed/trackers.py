"""The time of every tracker for a pair, keyframe and query both new, on all cores, as ratios to orb-pnp.

Each tracker is made anew and answers the first pairs of a dataset in turn; the first pair is asked once before,
untimed. Timed is the wall clock of preparing the keyframe and of tracking the query, with as many threads as the
libraries take by themselves. Without a dataset a short drive through the procedural town is rendered, 512x512 pixels.

Trackers whose weights the user has to fetch, such as aliked-pnp, are named by ``-m``.

    python benchmarks/speed/trackers.py [DATASET] [--pairs N] [-m METHOD ...] [--set METHOD.key=value ...]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import RelocbenchError
from relocbench.methods import TRACKERS, MethodSpec, parse_methods
from relocbench.tracking import Query, Reference

REFERENCE = "orb-pnp"
METHODS = (
    "identity",
    "dso",
    "dso-multistart",
    "gn-net-from-prior",
    "gn-net-pnp",
    "gn-net",
    "lm-net",
    REFERENCE,
    "sift-pnp",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?", help="default: a short rendered drive")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("-m", dest="methods", action="append", help=f"default: {', '.join(METHODS)}")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="method.key=value")
    options = parser.parse_args()
    names = list(dict.fromkeys([REFERENCE, *(options.methods or METHODS)]))
    if options.pairs < 1:
        parser.error(f"--pairs is {options.pairs}, expected 1 or more")
    try:
        specs = parse_methods(names, options.settings, 0, TRACKERS)
        with tempfile.TemporaryDirectory() as folder:
            pairs = first_pairs(options.dataset or rendered(Path(folder) / "drive"), options.pairs)
            seconds = {spec.label: taken(spec, pairs) for spec in specs}
    except RelocbenchError as bad:
        sys.exit(str(bad))
    print(f"| tracker | median seconds a pair | times {REFERENCE} |\n|---|---:|---:|")
    for name, of in sorted(seconds.items(), key=lambda item: item[1]):
        print(f"| {name} | {of:.3f} | {of / seconds[REFERENCE]:.2f} |")
    ratios = {name: of / seconds[REFERENCE] for name, of in seconds.items()}
    about = {"cores": os.cpu_count(), "pairs": len(pairs), "seconds": seconds}
    print(json.dumps({"benchmark": "trackers", **about, f"ratio_to_{REFERENCE}": ratios}))


def rendered(out: Path) -> Path:
    words = ["--conditions", "WetNoon,SoftRainNoon", "--size", "512x512", "--steps", "10", "--split", "validation"]
    asked = [sys.executable, "-m", "relocbench", "build-dataset", "synthetic", *words, "--out", str(out), "-q"]
    subprocess.run(asked, check=True, stdout=sys.stderr)
    return out


def first_pairs(root: Path, count: int) -> list[tuple[Reference, Query]]:
    """Keyframe and query of the first pairs of a dataset, from its pair sets in turn."""
    dataset = Dataset(root)
    of_sets = [[(pair_set, pair) for pair in pair_set.pairs] for pair_set in dataset.pair_sets()]
    in_turn = [each for row in itertools.zip_longest(*of_sets) for each in row if each is not None]
    return [(dataset.reference(pair_set, pair), dataset.query(pair_set, pair)) for pair_set, pair in in_turn[:count]]


def taken(spec: MethodSpec, pairs: list[tuple[Reference, Query]]) -> float:
    """The median time of a tracker for a pair, seconds."""
    tracker = spec.create()
    prepare = getattr(tracker, "prepare", lambda reference: reference)
    tracker.track(prepare(pairs[0][0]), pairs[0][1])
    times = []
    for reference, query in pairs:
        since = time.perf_counter()
        tracker.track(prepare(reference), query)
        times.append(time.perf_counter() - since)
    return float(np.median(times))


if __name__ == "__main__":
    main()
