"""The time of ``gn-net`` for a pair on one core, from images to pose, beside ALIKED's network and other trackers.

The pairs are of a short drive through the procedural town, 512x512 pixels, with queries in ``WetNoon`` and
``SoftRainNoon`` against a ``WetNoon`` map. The keyframe is prepared beforehand. ``features given`` is what remains when
the query has been through the network: the search for the matched start and the alignment from all starts. Times are of
the processor. Methods take turns on every pair, so that what disturbs the machine disturbs all of them; their ratios
are to be trusted further than their times.

    python benchmarks/speed/gn_net_tracking.py [--pairs N] [--repeats N] [--weights FILE] [--set KEY=VALUE ...]

The last line is JSON. What needs a package or weights that are not there is left out.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

# One core and large tensors on huge pages, as `evaluate` has them; read when the libraries are imported.
for variable in (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "THP_MEM_ALLOC_ENABLE",
):  # fmt: skip
    os.environ[variable] = "1"

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from baselines.learned_pnp.images import network_input
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import MethodError
from relocbench.methods import parse_method
from relocbench.tracking import Query, Reference

Work = Callable[[], object]
NETWORK, GIVEN = "ALIKED's network", ", features given"


def views(root: Path) -> list[tuple[Reference, Query]]:
    """The keyframe and the query of every pair of a dataset."""
    dataset = Dataset(root)
    return [
        (dataset.reference(pair_set, pair), dataset.query(pair_set, pair))
        for pair_set in dataset.pair_sets("validation")
        for pair in pair_set.pairs
    ]


def installed(settings: list[str]) -> dict[str, Any]:
    """The trackers that can be made here, by what the table calls them."""
    trackers: dict[str, Any] = {}
    for name, method, more in (
        ("gn-net", "gn-net", settings),
        ("gn-net, engine=openvino", "gn-net", [*settings, "engine=openvino"]),
        (f"gn-net{GIVEN}", "gn-net", settings),
        (f"gn-net-from-prior{GIVEN}", "gn-net-from-prior", settings),
        ("aliked-pnp", "aliked-pnp", []),
        ("orb-pnp", "orb-pnp", []),
        ("dso", "dso", []),
    ):
        with suppress(MethodError):
            trackers[name] = parse_method(method, more).create()
    return trackers


def works(trackers: dict[str, Any], reference: Reference, query: Query) -> dict[str, Work]:
    """What is timed of one pair. A tracker has the features of the query that it saw last, but not those of a copy."""
    prepared = {name: tracker.prepare(reference) for name, tracker in trackers.items()}

    def tracked(name: str) -> Work:
        seen = name.endswith(GIVEN)
        return lambda: trackers[name].track(prepared[name], query if seen else replace(query))

    found = {name: tracked(name) for name in trackers}
    if "aliked-pnp" in trackers:
        network = trackers["aliked-pnp"].detector()
        image, _ = network_input(query.image, network.channels, max(query.image.shape), network.name, "cpu")
        found[NETWORK] = torch.inference_mode()(lambda: network.find(image))
    return found


def milliseconds(of_pair: dict[str, Work], repeats: int) -> dict[str, float]:
    """The median processor time of each over the repeats; the first call of each is not timed."""
    taken: dict[str, list[float]] = {name: [] for name in of_pair}
    for turn in range(repeats + 1):
        for name, work in of_pair.items():
            since = time.process_time()
            work()
            if turn:
                taken[name].append(1e3 * (time.process_time() - since))
    return {name: float(np.median(times)) for name, times in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--weights", type=Path, help="weights file; default: the weights that come with the package")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="parameter of gn-net")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "d"
        subprocess.run(
            [sys.executable, "-m", "relocbench", "build-dataset", "synthetic", "--conditions", "WetNoon,SoftRainNoon",
             "--size", "512x512", "--steps", "10", "--split", "validation", "--out", str(root), "-q"],
            check=True, stdout=sys.stderr,
        )  # fmt: skip
        pairs = views(root)
    pairs = pairs[:: max(1, len(pairs) // options.pairs)][: options.pairs]
    trackers = installed([*options.set, *([f"weights={options.weights}"] if options.weights else [])])
    times = [milliseconds(works(trackers, *pair), options.repeats) for pair in pairs]
    told: dict[str, Any] = {"benchmark": "gn_net_tracking", "pairs": len(pairs)}
    whole = float(np.median([each["gn-net"] for each in times]))
    for name in times[0]:
        of_all = [each[name] for each in times]
        median, most = float(np.median(of_all)), float(np.percentile(of_all, 95))
        told |= {f"{name}, ms": median, f"{name}, ms, 95 %": most, f"{name}, ratio to gn-net": median / whole}
        print(f"{name:34} {median:7.1f} ms a pair, 95 % below {most:7.1f} ms, {median / whole:6.2f} times gn-net")
    told["ratio_to_dso"] = told[f"gn-net{GIVEN}, ms"] / told["dso, ms"]
    print(json.dumps(told))


if __name__ == "__main__":
    main()
